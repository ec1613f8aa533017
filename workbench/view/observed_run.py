"""A user's diagram, watched: following camera, arrows of the air, and a run log of its plant."""

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydrake.geometry import Meshcat
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, PortDataType

from aerodima.workbench.aero.section_watch import SectionWatch
from aerodima.workbench.car.car_diagram import car_signals, plant_facts
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.atomic_write import refuse_existing
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.core.key_errors import require_unique
from aerodima.workbench.core.port_wiring import add_and_connect
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.logs.recorder import (
    LogSink,
    RunRecorder,
    Signals,
    open_log,
    recorded_columns,
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
from aerodima.workbench.view.logged_run import AIR_SCALE, AIR_SCALE_KEY
from aerodima.workbench.view.watched_plant import WatchedPlant


class ObservedRun:
    """The log of a diagram while it is simulated; a context manager, see `observe`.

    Args:
        path: path of the log; None keeps it in memory.
        force: whether an existing log is replaced.
    """

    def __init__(self, path: Path | None, force: bool) -> None:
        refuse_existing(path, force, LogError)
        self._path = path
        self._force = force
        self._columns: list[str] = []
        self._metadata: Json = {}
        self._watches: dict[str, SectionWatch] = {}
        self._sink: LogSink | None = None
        self._over = False

    @property
    def log(self) -> RunLog:
        """Returns the run log after the `with` block; UserError before its end."""
        if self._sink is None or not self._over:
            raise UserError(
                "observe: the log is there after the `with` block in which the diagram is simulated"
            )
        return self._sink.run_log()

    def append(self, row: FloatArray) -> None:
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

    def __exit__(self, kind: object, *details: object) -> None:
        assert self._sink is not None
        self._sink.add_facts(
            {f"{name}_sections": watch.facts() for name, watch in self._watches.items()}
        )
        self._sink.__exit__(kind, *details)
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
        name = tail.get_name()
        watch = SectionWatch(tail.layout.number, rate)
        flow, valid = (tail.GetOutputPort(port) for port in ("sections", "validity"))
        add_and_connect(builder, watch, f"{name}_watch", sections=flow, validity=valid)
        self._watches[name] = watch

    def record(
        self,
        builder: DiagramBuilder,
        signals: Signals,
        rate: float,
        step: float,
        metadata: Json,
    ) -> None:
        """Adds the recorder of these ports; LogError if two columns have one name."""
        # Metadata that cannot be read back are refused.
        decode_metadata({METADATA_KEY: encode_metadata(metadata)}, "observe")
        self._columns = recorded_columns(signals)
        self._metadata = metadata
        require_unique(self._columns, "observe: column of a port", LogError)
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
    settings: Scenario | Facts | None = None,
    signals: Mapping[str, OutputPort] | None = None,
    air_scale: float = AIR_SCALE,
    force: bool = False,
) -> ObservedRun:
    """Watches a user's diagram: call it before `builder.Build()`, simulate in its `with` block.

    Meshcat gets the plant, if nothing shows it yet, a camera that follows it, and an arrow for
    every `TailForce`. The log has the state of the plant, the motion of its centre of mass and its
    base, the poses of its bodies with their shapes, wrench and sections of every `TailForce`, the
    wind, and `signals`; `plant_metrics`, `aerodima log metrics`, `replay`, `log compare` read it. A
    car's station with its scenario as `settings` gives the log of a car, whatever drives it.

    Args:
        builder: builder that owns the plant.
        plant: finalised plant, or simulated station.
        meshcat: viewer that shows the run live; for a station, give it to `make_car_station` too.
        log: path of the Parquet file; None keeps the log in memory.
        base: body whose tilt, heading and speed count, z axis up; by default the floating base.
        rate: rate of the rows, Hz.
        name: name of the run, for titles; by default that of the plant.
        settings: nested numbers and texts; `aerodima log compare` names those that differ.
        signals: further vector ports by column name (`<name>_0`, ... for several elements).
        air_scale: length of the arrows, m per N.
        force: whether an existing log is replaced; it is refused otherwise.

    Raises:
        UserError: plant not finalised or elsewhere, no such body, rate not above 0, existing log.
    """
    for what, value in (("rate", rate), ("air_scale", air_scale)):
        check_range(f"observe: {what}", value, 0.0, math.inf, NO_UNIT, above_low=True)
    run = ObservedRun(None if log is None else Path(log), force)
    watched = WatchedPlant.find(builder, plant, base)
    truth = watched.add_truth(builder)
    if meshcat is not None:
        watched.show(builder, truth, meshcat, air_scale)
    more = _user_signals(builder, signals or {})
    if watched.station is not None and isinstance(settings, Scenario):
        recorded = car_signals(builder, watched.station, settings, {}) + more
        facts = plant_facts(watched.station)
        metadata = run_metadata(settings.resolved(), settings.seed, extra=facts)
    else:
        stated = settings.resolved() if isinstance(settings, Scenario) else dict(settings or {})
        stated = {"name": name or stated.get("name") or watched.plant.get_name()} | stated
        for tail in watched.tails:
            run.watch(builder, tail, rate)
        recorded = watched.signals(truth) + more
        facts = watched.facts() | {AIR_SCALE_KEY: air_scale}
        metadata = run_metadata(stated, seed=0, kind=PLANT_RUN, extra=facts)
    run.record(builder, recorded, rate, watched.plant.time_step(), metadata)
    return run


def _user_signals(builder: DiagramBuilder, ports: Mapping[str, OutputPort]) -> Signals:
    """Names a column for each element of the user's own ports."""
    signals: Signals = []
    for name, port in ports.items():
        if port.get_system() not in builder.GetSystems():
            raise UserError(
                f"observe: signal {name!r} is a port of another diagram; it must be a port of this "
                "builder"
            )
        if port.get_data_type() != PortDataType.kVectorValued:
            raise UserError(f"observe: signal {name!r}: port '{port.get_name()}' holds no vector")
        columns = [name]
        if port.size() != 1:
            columns = [f"{name}_{index}" for index in range(port.size())]
        signals.append((port, columns))
    return signals
