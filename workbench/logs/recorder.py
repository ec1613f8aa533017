"""Writes the signals of a diagram into a run log while it runs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, OutputPort

from aerodima.workbench.config.log_columns import TIME
from aerodima.workbench.logs.log_sink import LogSink
from aerodima.workbench.logs.unwrapping import RowUnwrapper
from aerodima.workbench.systems.event_order import Stage, nominal_time, period_of


class RunRecorder(LeafSystem):
    """Appends one row per period to a journal or list; costs nothing between rows.

    Input ports:
        one vector per recorded port, in the order they are given.

    Args:
        journal: open journal, or other sink, whose columns are `time_s` and then those of the ports, in order.
        sources: size of each recorded port.
        rate: rows per second, Hz.
        stage: `Stage.RECORD` beside a simulated car (`aerodima.workbench.systems.event_order`), whose row then has what
            sensors and controllers did at its instant; without, a row has what stood on the ports before its instant.
    """

    def __init__(
        self,
        journal: LogSink,
        columns: Sequence[str],
        sizes: Sequence[int],
        rate: float,
        stage: Stage | None = None,
    ):
        super().__init__()
        self.set_name("run_recorder")
        self._journal, self._rate = journal, rate
        self._row = np.zeros(1 + sum(sizes))
        self._ports = []
        start = 1
        for index, size in enumerate(sizes):
            self._ports.append((self.DeclareVectorInputPort(f"signal_{index}", size), start, start + size))
            start += size
        self._unwrapper = RowUnwrapper(columns)
        period = 1.0 / rate if stage is None else period_of(rate, stage)
        self.DeclarePeriodicPublishEvent(period, 0.0, self._record)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        journal: LogSink,
        signals: Sequence[tuple[OutputPort, Sequence[str]]],
        rate: float,
        stage: Stage | None = None,
    ) -> "RunRecorder":
        """Records each output port under the given column names."""
        columns = recorded_columns(signals)
        recorder = cls(journal, columns, [port.size() for port, _ in signals], rate, stage)
        builder.AddSystem(recorder)
        for index, (port, _) in enumerate(signals):
            builder.Connect(port, recorder.get_input_port(index))
        return recorder

    def _record(self, context: Context) -> EventStatus:
        row = self._row
        row[0] = nominal_time(context.get_time(), self._rate)
        for port, start, end in self._ports:
            values: Any = port.Eval(context)
            row[start:end] = values
        self._journal.append(self._unwrapper.apply(row))
        return EventStatus.Succeeded()


def recorded_columns(signals: Sequence[tuple[OutputPort, Sequence[str]]]) -> list[str]:
    """Column names of a recording, time first.

    Raises:
        ValueError: a port and its names differ in number.
    """
    columns = [TIME]
    for port, names in signals:
        if port.size() != len(names):
            raise ValueError(f"port {port.get_name()!r} has {port.size()} elements for {len(names)} columns")
        columns += names
    return columns
