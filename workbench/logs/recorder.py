"""Writes the signals of a running diagram into a run log: through a journal, or in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
import pandas as pd
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    EventStatus,
    LeafSystem,
    OutputPort,
    System,
    UseDefaultName,
    kUseDefaultName,
)
from pydrake.systems.primitives import VectorLogSink

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.event_order import nominal_time, row_period
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.core.port_wiring import vector_of
from aerodima.workbench.logs.journal import JournalWriter
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata
from aerodima.workbench.logs.signals import RowUnwrapper
from aerodima.workbench.scenario.signal_table import TIME, Column, names_of

Signals = list[tuple[OutputPort, list[str]]]
"""Ports with the names of the columns that they fill."""


class MemoryLog:
    """Does without a file what `JournalWriter` does: takes rows within a `with` block, after which
    it makes the log.
    """

    def __init__(self, columns: Sequence[str], metadata: Facts) -> None:
        self._columns = list(columns)
        self._metadata = dict(metadata)
        self._rows: list[np.ndarray] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Closes nothing."""

    def append(self, row: np.ndarray) -> None:
        """Takes a copy of one row: the recorder writes the next one into the same array."""
        self._rows.append(row.copy())

    def add_facts(self, facts: Facts) -> None:
        """Adds facts to `extra` of the log that are known only at the end of the run."""
        self._metadata["extra"] = {**self._metadata["extra"], **facts}

    def run_log(self) -> RunLog:
        """Makes the log, after the block."""
        return run_log_from_metadata(
            pd.DataFrame(np.array(self._rows), columns=self._columns), self._metadata
        )


LogSink = JournalWriter | MemoryLog


class RowSink(Protocol):
    """Takes the rows of a recorder."""

    def append(self, row: np.ndarray) -> None:
        """Takes one row, whose array the recorder uses again."""


def open_log(
    path: str | Path | None, columns: Sequence[str], metadata: Facts, force: bool
) -> LogSink:
    """Opens a journal that becomes the log `path`, or rows in memory without a path.

    Raises:
        LogError: as `JournalWriter`.
    """
    if path is None:
        return MemoryLog(columns, metadata)
    return JournalWriter(path, columns, metadata, force=force)


class OpenBuilder(DiagramBuilder):
    """A builder that can be asked for what was exported and connected.

    Attributes:
        exported: output ports by the names under which they were exported.
    """

    def __init__(self) -> None:
        super().__init__()
        self.exported: dict[str, OutputPort] = {}

    def ExportOutput(  # noqa: N802 (Drake's)
        self, output: OutputPort, name: str | UseDefaultName = kUseDefaultName
    ) -> Any:
        """Exports an output as Drake does."""
        self.exported[name if isinstance(name, str) else output.get_name()] = output
        return super().ExportOutput(output, name)

    def signals(self, taken: Sequence[str]) -> Signals:
        """Lists ports that were exported, or logged by `LogVectorOutput`, with the columns that
        they fill.

        The name of the export, or of the logger (`set_name`), gives the columns' names with their
        units, such as `x_m,y_m`; one name for several elements is followed by their numbers. A
        logger without a name takes those of system and port.

        Args:
            taken: names of the columns that are there already.

        Raises:
            UserError: a port has another number of names than elements, or a column is there
                already.
        """
        ports = list(self.exported.items())
        for sink in self.GetSystems():
            if isinstance(sink, VectorLogSink):
                (source,) = port_sources(self, sink).values()
                name = sink.get_name()
                if "@" in name:
                    system: Any = source.get_system()  # an object, by Drake's stubs
                    system_name = system.get_name().rpartition("/")[2].partition("@")[0]
                    name = f"{system_name}_{source.get_name()}"
                ports.append((name, source))
        signals = []
        known = set(taken)
        for name, port in ports:
            names = name.replace(" ", "").split(",")
            size = port.size()
            if len(names) == 1 < size:
                names = [f"{name}_{index}" for index in range(size)]
            if len(names) != size or known.intersection(names) or len(set(names)) < size:
                raise UserError(
                    f"port exported or logged as {name!r}: {size} elements; must be as many new "
                    "columns"
                )
            known.update(names)
            signals.append((port, names))
        return signals


class RunRecorder(LeafSystem):
    """Appends one row per period to a journal or list; costs nothing between rows.

    Input ports:
        one vector per recorded port, in the order in which they are given.

    Args:
        journal: open journal, or other sink, whose columns are `time_s` and then those of the
            ports, in order.
        signals: recorded ports with the names of their columns.
        rate: rate of the rows, Hz.
        step: time step of a discrete plant, s, such as a simulated car: a row has what sensors and
            controllers did at its instant (`row_period`). None: a row has what stood on the ports
            before its instant.
        with_samples: whether rows are written in the discrete update of the instant, for a plant
            that moves continuously. Drake publishes before it updates, so a publish event sees the
            samples of the period before; the update sees those of its own instant, since sensors
            sample in unrestricted updates, which come first. The row of the time at which a
            simulation ends is written when it runs a little longer.
    """

    def __init__(
        self,
        journal: RowSink,
        signals: Signals,
        rate: float,
        step: float | None,
        with_samples: bool,
    ):
        super().__init__()
        columns = recorded_columns(signals)
        self.set_name("run_recorder")
        self._journal = journal
        self._rate = rate
        self._row = np.zeros(len(columns))
        self._ports = []
        start = 1
        for index, (_, names) in enumerate(signals):
            port = self.DeclareVectorInputPort(f"signal_{index}", len(names))
            self._ports.append((port, start, start + len(names)))
            start += len(names)
        self._unwrapper = RowUnwrapper(columns)
        period = row_period(rate, step) if step else 1.0 / rate
        if with_samples:
            self.DeclareDiscreteState(1)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._record_in_update)
        else:
            self.DeclarePeriodicPublishEvent(period, 0.0, self._record)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        journal: RowSink,
        signals: Signals,
        rate: float,
        step: float | None = None,
        with_samples: bool = False,
    ) -> RunRecorder:
        """Records each output port under the given column names."""
        recorder = cls(journal, signals, rate, step, with_samples)
        builder.AddSystem(recorder)
        for index, (port, _) in enumerate(signals):
            builder.Connect(port, recorder.get_input_port(index))
        return recorder

    def _record(self, context: Context) -> EventStatus:
        row = self._row
        row[0] = nominal_time(context.get_time(), self._rate)
        for port, start, end in self._ports:
            row[start:end] = vector_of(port, context)
        self._journal.append(self._unwrapper.apply(row))
        return EventStatus.Succeeded()

    def _record_in_update(self, context: Context, values: DiscreteValues) -> EventStatus:
        return self._record(context)


def port_sources(builder: DiagramBuilder, system: System) -> dict[str, OutputPort]:
    """Maps the name of each connected input port of a system to the output port that feeds it."""
    return {
        system.get_input_port(int(port)).get_name(): source.get_output_port(int(output))
        for (target, port), (source, output) in builder.connection_map().items()
        if target is system
    }


def output_ports(*systems: System) -> dict[str, OutputPort]:
    """Lists the output ports of several systems by name."""
    return {
        port.get_name(): port
        for system in systems
        for port in map(system.get_output_port, range(system.num_output_ports()))
    }


def signals_of(table: Mapping[str, list[Column]], ports: Mapping[str, OutputPort]) -> Signals:
    """Selects the ports of a table (`aerodima.workbench.scenario.signal_table`) that are there,
    with the names of its columns.
    """
    return [(ports[name], names_of(columns)) for name, columns in table.items() if name in ports]


def recorded_columns(signals: Signals) -> list[str]:
    """Lists the column names of a recording, time first.

    Raises:
        ValueError: a port and its names differ in number.
    """
    columns = [TIME]
    for port, names in signals:
        if port.size() != len(names):
            raise ValueError(
                f"port {port.get_name()!r} has {port.size()} elements for {len(names)} columns"
            )
        columns += names
    return columns
