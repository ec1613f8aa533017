"""One run in memory, as cheap as it can be: for sweeps, threshold searches and calibration, which need thousands.

No file and no journal; what a sensor or the plant holds as a vector is recorded by Drake's own C++ loggers, and only
the contacts are read in Python. A run that has flipped is stopped, once the turn is over so that its metrics exist.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.manoeuvre import run_time
from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.logs.recorder import RunRecorder, recorded_columns
from aerodima.workbench.logs.schema import TAIL_LAW, RunLog, run_log_from_metadata, run_metadata
from aerodima.workbench.metrics.run_summary import RunSummary, summarise
from aerodima.workbench.simulate.car_run import CarDiagram, assemble, plant_facts
from aerodima.workbench.stations.outcome_record import FlipWatch, OutcomeRecord
from aerodima.workbench.systems.event_order import Stage

STOPPED = "stopped_at_flip_s"
"""Key in `extra` of a log that ends at a flip: the time of its last row, s."""

_TIME_MARGIN = 1e-9
"""s."""


@dataclass(frozen=True)
class Trial:
    """One run.

    Attributes:
        summary: outcome and metrics. Of a run that was stopped at its flip, what happens after the turn (peak roll,
            roll integral, heading change, time on two wheels, tail energy) is that until the stop.
        run_log: in memory, with column names and units of a run log. With signals `outcome` it has what the metrics
            need and what the sensors report. A log that ends at a flip has `STOPPED` in its `extra`.
    """

    summary: RunSummary
    run_log: RunLog


def run_trial(
    scenario: Scenario,
    *,
    stop_when_flipped: bool = True,
    tail_law: TailLaw | None = None,
    signals: Literal["all", "outcome"] = "outcome",
) -> Trial:
    """Simulates a scenario and measures it; outcome and metrics are those of `run_scenario` and `summarise`.

    Args:
        scenario: resolved.
        stop_when_flipped: end the run when the tilt has passed 75 degrees and the turn is over.
        tail_law: drives the tail instead of the law that the scenario names.
        signals: `all` records every column of a run log, and so gives the impulses of the tail; `outcome` what the
            metrics need, for 0.8 of the CPU time (0.45 when the car flips).

    Raises:
        UserError: the scenario makes no valid plant, or the run no metrics (NaN, too short for its turn).
        RuntimeError: Drake's solver gave up.
    """
    car = assemble(scenario, tail_law=tail_law)
    watch = FlipWatch.add_to_builder(
        car.builder,
        car.station,
        scenario.simulation.log_rate,
        stop_after=turn_end(scenario) if stop_when_flipped else math.inf,
        contacts=signals == "outcome",
    )
    if signals == "all":
        make_table = _record_everything(car, scenario)
    else:
        make_table = OutcomeRecord(car.builder, car.station, scenario, car.signals, watch).table
    law_facts = {} if tail_law is None else {TAIL_LAW: type(tail_law).__name__}
    metadata = run_metadata(scenario.resolved(), scenario.seed, extra=plant_facts(car.station) | law_facts)
    simulator = Simulator(car.builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(run_time(scenario))
    if watch.stopped is not None:
        metadata["extra"][STOPPED] = watch.stopped
    run_log = run_log_from_metadata(make_table(simulator.get_context()), metadata)
    return Trial(summarise(run_log, scenario.name), run_log)


def turn_end(scenario: Scenario) -> float:
    """When the wheels are straight again after the turn, s; the end of a run that is no single turn."""
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind not in ("turn", "auto_turn"):
        return run_time(scenario)
    start = manoeuvre.turn_start if manoeuvre.kind == "turn" else manoeuvre.straight_time
    servo = scenario.servo
    slack = 1.0 / servo.frame_rate + 1.0 / scenario.simulation.log_rate + _TIME_MARGIN
    return start + manoeuvre.turn_hold + manoeuvre.steer_angle / servo.rate + slack


class _Rows:
    """Takes the rows of a `RunRecorder` in memory."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def append(self, row: np.ndarray) -> None:
        """Keeps a copy of one row."""
        self.rows.append(row.copy())


def _record_everything(car: CarDiagram, scenario: Scenario) -> Callable[[Context], pd.DataFrame]:
    rows = _Rows()
    RunRecorder.add_to_builder(car.builder, rows, car.signals, scenario.simulation.log_rate, Stage.RECORD)
    columns = recorded_columns(car.signals)
    return lambda context: pd.DataFrame(np.array(rows.rows), columns=columns)
