"""`simulate`: from a scenario of car or rig to the log of its run, in a file or in memory."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.scenario import Scenario

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from aerodima.workbench.car.car_bodies import AddBodies
    from aerodima.workbench.car.car_diagram import Build
    from aerodima.workbench.car.run_view import Progress


def simulate(
    scenario: Scenario | RigScenario,
    log: str | Path | None = None,
    *,
    record: Literal["all", "outcome"] = "all",
    stop_when_certain: bool | None = None,
    law: TailLaw | None = None,
    build: Build | None = None,
    bodies: AddBodies | None = None,
    force: bool = False,
    meshcat: Meshcat | None = None,
    real_time_rate: float = 0.0,
    progress: Progress | None = None,
) -> RunLog:
    """Simulate a scenario: a manoeuvre of the car, or an experiment of a wind-tunnel rig.

    An interrupted run leaves a journal, from which `aerodima log recover` makes a log.

    Args:
        scenario: resolved scenario of a car or a rig.
        log: path of the Parquet file to be written; None keeps the log in memory.
        record: `all` columns, or the `outcome` of a car, in half the time (design section 9).
        stop_when_certain: whether a run ends once the car has tilted past 75 degrees after a turn
            or, with `outcome`, settled in still air (`extra`: `STOPPED`, `SETTLED`); None: for
            `outcome` without `build`, whose last steering nobody knows.
        law: tail law in place of the scenario's; `extra` names its class as `tail_law`.
        build: function that replaces driver and tail law: `build(builder, station)` adds systems
            and connects every input port of the station. An export or `LogVectorOutput` named
            `x_m,y_m` fills these columns of the log.
        bodies: function that adds bodies, say a wing: `bodies(builder, plant, wind)` (`AddBodies`).
        force: whether an existing log is replaced.
        meshcat: Meshcat that shows the run live.
        real_time_rate: 0 for a run as fast as possible, 1 for real time.
        progress: function that receives time and length of the run, s, at most 0.1 s apart.

    Raises:
        UserError: no valid plant, a rig beyond its limits, an unwritable or existing log.
        RuntimeError: Drake's solver gave up.
    """
    from aerodima.workbench.car.car_run import run_car, run_outcome
    from aerodima.workbench.car.run_view import LiveView

    view = LiveView(meshcat, real_time_rate, progress)
    if isinstance(scenario, RigScenario):
        from aerodima.workbench.rig.rig_run import run_rig

        if law or build or bodies or stop_when_certain or record != "all":
            raise UserError(
                f"{scenario.name}: law, build, bodies, stop_when_certain and record='outcome' are "
                "for scenarios of the car"
            )
        return run_rig(scenario, log, force=force, view=view)
    if law is not None and build is not None:
        raise UserError("law and build exclude each other: each says what the tail does")
    if record == "all":
        return run_car(scenario, log, bool(stop_when_certain), law, force, view, build, bodies)
    if log is not None:
        raise UserError(f"{log}: must be None with record='outcome', which leaves out columns")
    stops = build is None if stop_when_certain is None else stop_when_certain
    return run_outcome(scenario, stops, law, view, build=build, bodies=bodies)
