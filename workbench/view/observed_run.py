"""A diagram of the reader's own, watched: following camera, arrows of the air, and a run log of
what its plant does.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, PortDataType

from aerodima.workbench.aero.section_watch import SectionWatch
from aerodima.workbench.car.car_run import plant_facts, truth_signals
from aerodima.workbench.car.roll_estimator import RollEstimator
from aerodima.workbench.control.controller_systems import TailController, TurnDriver
from aerodima.workbench.core.atomic_write import refuse_existing
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.logs.recorder import (
    LogSink,
    RunRecorder,
    Signals,
    open_log,
    output_ports,
    recorded_columns,
    signals_of,
)
from aerodima.workbench.logs.schema import (
    METADATA_KEY,
    PLANT_RUN,
    RunLog,
    decode_metadata,
    encode_metadata,
    run_metadata,
)
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import CAR_PORTS, sensor_columns
from aerodima.workbench.view.logged_run import AIR_SCALE, AIR_SCALE_KEY
from aerodima.workbench.view.watched_plant import WatchedPlant


class ObservedRun:
    """The log of a diagram while it is simulated; a context manager, see `observe`.

    Args:
        path: of the log; None keeps it in memory.
        force: replace an existing log.
    """

    def __init__(self, path: Path | None, force: bool) -> None:
        if path is not None:
            refuse_existing(path, force, LogError)
        self._path = path
        self._force = force
        self._columns: list[str] = []
        self._metadata: dict[str, Any] = {}
        self._watches: dict[str, SectionWatch] = {}
        self._sink: LogSink | None = None
        self._over = False

    @property
    def log(self) -> RunLog:
        """The run log, after the `with` block; UserError before its end."""
        if self._sink is None or not self._over:
            raise UserError(
                "observe: the log is there after the `with` block in which the diagram is simulated"
            )
        return self._sink.run_log()

    def append(self, row: np.ndarray) -> None:
        """Takes a row of the recorder; UserError outside the `with` block."""
        if self._sink is None or self._over:
            raise UserError(
                "observe: simulate the diagram inside the block `with observe(...) as run:`"
            )
        self._sink.append(row)

    def __enter__(self) -> Self:
        self._sink = open_log(self._path, self._columns, self._metadata, self._force)
        self._over = False
        self._sink.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._sink is not None
        self._sink.add_facts(
            {f"{name}_sections": watch.facts() for name, watch in self._watches.items()}
        )
        self._sink.__exit__(kind, error, trace)
        self._over = kind is None
        for name, watch in self._watches.items():
            if watch.felt_no_air:
                warnings.warn(
                    f"{name}: air passed its sections at up to {watch.fastest:.2g} m/s and made no "
                    "force; is normal_B of their layout across the flow?",
                    UserWarning,
                    stacklevel=2,
                )

    def watch(self, builder: DiagramBuilder, tail: Any, rate: float) -> None:
        """Counts how long the sections of a `TailForce` are outside their coefficients' range."""
        ports = (tail.GetOutputPort("sections"), tail.GetOutputPort("validity"))
        watch = SectionWatch.add_to_builder(builder, f"{tail.get_name()}_watch", *ports, rate)
        self._watches[tail.get_name()] = watch

    def record(
        self,
        builder: DiagramBuilder,
        signals: Signals,
        rate: float,
        step: float,
        metadata: dict[str, Any],
    ) -> None:
        """Adds the recorder of these ports; LogError when two columns have one name."""
        # What cannot be read is not written.
        decode_metadata({METADATA_KEY: encode_metadata(metadata)}, "observe")
        self._columns = recorded_columns(signals)
        self._metadata = metadata
        twice = sorted({name for name in self._columns if self._columns.count(name) > 1})
        if twice:
            raise LogError(
                f"observe: column(s) named twice: {', '.join(twice)}; give the ports other names"
            )
        RunRecorder.add_to_builder(builder, self, signals, rate, step)


def observe(
    builder: DiagramBuilder,
    plant: MultibodyPlant | Diagram,
    meshcat: Meshcat | None = None,
    log: str | Path | None = None,
    *,
    base: RigidBody | str | None = None,
    rate: float = 100.0,
    name: str = "",
    settings: Scenario | Mapping[str, Any] | None = None,
    signals: Mapping[str, OutputPort] | None = None,
    air_scale: float = AIR_SCALE,
    force: bool = False,
) -> ObservedRun:
    """Watches a diagram of one's own: call it last, before `builder.Build()`, and simulate within
    its `with` block.

    Meshcat gets the plant, if nothing shows it yet, a camera that follows it, and the force of
    every `TailForce` on it as an arrow. The log has the state of the plant, the motion of its
    centre of mass and its base, the poses of its bodies with their shapes, per `TailForce` wrench
    and sections, the wind, and `signals`; `plant_metrics`, `aerodima log metrics`, `replay` and
    `log compare` read it, with the outcome where it is defined (`plant_outcome`). A car's station
    with driver, tail controller and roll estimator in the same builder gives the log of a car if
    `settings` is its scenario.

    Args:
        builder: that owns the plant.
        plant: finalised, discrete or continuous; or a simulated station, whose port
            `plant_state_truth` is read.
        meshcat: shows the run while it goes on; of a station, give it to `make_car_station` too.
        log: the Parquet file to be; refused when it exists, unless `force`. None keeps the log in
            memory.
        base: the body whose tilt, heading and speed count, its z axis up; by default the only
            floating base, if any.
        rate: rows per second, Hz.
        name: of the run, for titles; by default that of the plant.
        settings: what `aerodima log compare` names when runs differ: numbers and texts, nested as
            one likes.
        signals: further vector ports, by the name of their columns; with more than one element
            `<name>_0`, ...
        air_scale: length of the arrows, m per N.
        force: replace an existing log.

    Raises:
        UserError: plant not finalised or not in the builder, no such body, a rate that is not above
            0, an existing log.
    """
    for what, value in (("rate", rate), ("air_scale", air_scale)):
        if not (math.isfinite(value) and value > 0.0):
            raise UserError(f"observe: {what} is {value:g}, but it must be a finite number above 0")
    run = ObservedRun(None if log is None else Path(log), force)
    watched = WatchedPlant.find(builder, plant, base)
    truth = watched.add_truth(builder)
    if meshcat is not None:
        watched.show(builder, truth, meshcat, air_scale)
    step = watched.plant.time_step()
    if isinstance(settings, Scenario):
        stated = settings.resolved()
        if watched.station is not None:
            car = _car_signals(builder, watched.station)
            if car:
                facts = plant_facts(watched.station)
                metadata = run_metadata(stated, settings.seed, extra=facts)
                run.record(builder, car, rate, step, metadata)
                return run
    else:
        stated = dict(settings or {})
    for tail in watched.tails:
        run.watch(builder, tail, rate)
    stated = {"name": name or stated.get("name") or watched.plant.get_name()} | stated
    metadata = run_metadata(
        stated, seed=0, kind=PLANT_RUN, extra=watched.facts() | {AIR_SCALE_KEY: air_scale}
    )
    recorded = watched.signals(truth) + _further(builder, signals or {})
    run.record(builder, recorded, rate, step, metadata)
    return run


def _car_signals(builder: DiagramBuilder, station: Diagram) -> Signals:
    """Every column of a car's log, if driver, tail controller and roll estimator are in the
    builder; else none.
    """
    parts = (TurnDriver, TailController, RollEstimator)
    sources = [system for system in builder.GetSystems() if isinstance(system, parts)]
    signals = signals_of(CAR_PORTS, output_ports(*sources, station))
    found = {name for _, names in signals for name in names}
    wanted = {column.name for column in sensor_columns()[1:] if not column.optional}
    if wanted <= found:
        return signals + truth_signals(station)
    return []


def _further(builder: DiagramBuilder, signals: Mapping[str, OutputPort]) -> Signals:
    """The reader's own ports, with a column per element."""
    found: Signals = []
    for name, port in signals.items():
        if port.get_system() not in builder.GetSystems():
            raise UserError(
                f"observe: signal {name!r} is a port of another diagram; allowed: ports of this "
                "builder"
            )
        if port.get_data_type() != PortDataType.kVectorValued:
            raise UserError(f"observe: signal {name!r}: port '{port.get_name()}' holds no vector")
        columns = [name]
        if port.size() != 1:
            columns = [f"{name}_{index}" for index in range(port.size())]
        found.append((port, columns))
    return found
