"""One verb: from a scenario of car or rig to the log of its run, in a file or in memory."""

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
    force: bool = False,
    meshcat: Meshcat | None = None,
    real_time_rate: float = 0.0,
    progress: Progress | None = None,
) -> RunLog:
    """Simulates a scenario: a manoeuvre of the car, or an experiment of a wind-tunnel rig.

    With a file, rows reach the disk while the run goes on; after an interruption the journal beside
    it keeps them and `aerodima log recover` makes a log of it.

    Args:
        scenario: resolved scenario.
        log: the Parquet file to be; refused when it exists, unless `force`. None keeps the log in
            memory.
        record: `all` records every column of a run log; `outcome`, of the car and in memory only,
            what the metrics need and what the sensors report, for half of the CPU time: the
            vertical forces of the ground come from the motion (design section 9).
        stop_when_certain: end the run of a car when its outcome is certain, by default with
            `record="outcome"` only: when its tilt has passed 75 degrees and the turn is over; a
            trial of a single turn in still air also when the car has settled after it
            (`metrics.settling`), so that a law which acts later still is not seen. The log has
            `STOPPED` or `SETTLED` in its `extra` then, and what happens after the turn (peak roll,
            roll integral, heading change, time on two wheels, tail energy) is that until the stop.
        law: drives the tail of a car instead of the law that the scenario names; the log has the
            name of its class as `tail_law` in its `extra`.
        build: drives the car in place of driver and tail law, and not together with `law`:
            `build(builder, station)` adds systems of your own, with discrete or continuous state,
            and connects every input port of the station. What it exports, or logs by
            `LogVectorOutput`, fills columns of the log, named by the export or the logger, such as
            `x_m,y_m`. `aerodima.hardware.drive` takes the same function.
        force: replace an existing log.
        meshcat: shows the run live.
        real_time_rate: 0 runs as fast as possible, 1 in real time.
        progress: receives how far the run is, about ten times per simulated second.

    Raises:
        UserError: the scenario makes no valid plant, the rig's tail leaves its range or holding
            takes too much current, unwritable or existing log.
        RuntimeError: Drake's solver gave up.
    """
    from aerodima.workbench.car.run_view import LiveView

    view = LiveView(meshcat, real_time_rate, progress)
    if isinstance(scenario, RigScenario):
        from aerodima.workbench.rig.rig_run import run_rig

        if law is not None or build is not None or stop_when_certain or record != "all":
            raise UserError(
                f"{scenario.name}: law, build, stop_when_certain and record='outcome' are for "
                "scenarios of the car"
            )
        return run_rig(scenario, log, force=force, view=view)
    from aerodima.workbench.car.car_run import run_car, run_outcome

    if law is not None and build is not None:
        raise UserError("law: allowed without build; each says what the tail does")
    if record == "all":
        return run_car(scenario, log, bool(stop_when_certain), law, force, view, build)
    if log is not None:
        raise UserError(
            f"{log}: record='outcome' leaves out columns of a log file; allowed: record='all'"
        )
    return run_outcome(scenario, stop_when_certain is not False, law, view, build=build)
