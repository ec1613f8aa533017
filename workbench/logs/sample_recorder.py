"""Writes what sensors show at the instant of each row, for plants that move continuously."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, OutputPort

from aerodima.workbench.logs.log_sink import LogSink
from aerodima.workbench.logs.recorder import recorded_columns


class SampleRecorder(LeafSystem):
    """Appends one row per period to a journal or to memory, within the discrete update of that instant.

    Drake publishes before it updates, so a publish event sees the samples of the period before. The update sees those
    of its own instant, since sensors sample in unrestricted updates, which come first. The row of the time at which a
    simulation ends is written when it runs a little longer.

    Input ports:
        one vector per recorded port, in the order they are given.

    Args:
        journal: open journal, or other sink, whose columns are `time_s` and then those of the ports, in order.
        sizes: of the recorded ports.
        rate: rows per second, Hz.
    """

    def __init__(self, journal: LogSink, sizes: Sequence[int], rate: float):
        super().__init__()
        self.set_name("sample_recorder")
        self._journal, self._rate = journal, rate
        self._row = np.zeros(1 + sum(sizes))
        ends = (1 + np.cumsum([0, *sizes])).tolist()
        self._ports = [
            (self.DeclareVectorInputPort(f"signal_{index}", size), ends[index], ends[index + 1])
            for index, size in enumerate(sizes)
        ]
        self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, self._record)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        journal: LogSink,
        signals: Sequence[tuple[OutputPort, Sequence[str]]],
        rate: float,
    ) -> "SampleRecorder":
        """Records each output port under the given column names."""
        recorded_columns(signals)
        recorder = cls(journal, [port.size() for port, _ in signals], rate)
        builder.AddSystem(recorder)
        for index, (port, _) in enumerate(signals):
            builder.Connect(port, recorder.get_input_port(index))
        return recorder

    def _record(self, context: Context, values: DiscreteValues) -> None:
        row = self._row
        row[0] = round(context.get_time() * self._rate) / self._rate
        for port, start, end in self._ports:
            signal: Any = port.Eval(context)
            row[start:end] = signal
        self._journal.append(row)
