"""Does a swing do on the full car what its file promises? Forward simulation at the fine step, over the ensemble.

Three questions. On the car the swing was made for: how far is the motion from the knots, does anything leave its limits
or touch the car? On the ensemble: which share of the members survives, clean? And is the turn still the turn: is the
heading change at least 95 % of that with the thesis' swing (8 rad/s), at the highest friction that both survive
(design section 10)?
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.sweep.rollover_threshold import is_clean
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.runs import Runs, RunTask, measured_row
from aerodima.optimisation.swing.task import FINE_STEP
from aerodima.workbench.batch import Engine
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.config.ensemble import Ensemble
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile, swing_at
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.errors import SwingError, UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.run_summary import RunSummary, summarise
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.plants.clearance import RangeOfMotion, ground_clearance
from aerodima.workbench.simulate.simulation import simulate

REFERENCE_SETTINGS = ("tail.mode=swing", "controller.swing_file=none", "controller.swing_speed=8.0")
LOWER_FRICTION, MOST_LOWER = 0.05, 6
"""Where the reference flips, headings are compared at a friction lower by this, at most so many times."""
_MARGIN = 1e-3
"""rad and N m; an encoder and a stop give this much."""


@dataclass(frozen=True)
class StateErrors:
    """How the run of the car that the swing was made for compares with its file.

    Attributes:
        tail_roll: largest distance of the tail from the curve through the knots during the swing, rad.
        tail_pitch: likewise.
        tail_roll_at_end: at the last knot, rad.
        largest_roll, largest_pitch: of the tail's joints, rad.
        largest_torque: of a motor, N m.
        clearance: least distance of rod and sail from the car, m; from the ground at the actual roll of the car.
        ground: see clearance.
        fell_back: the player gave the swing up.
    """

    tail_roll: float
    tail_pitch: float
    tail_roll_at_end: float
    largest_roll: float
    largest_pitch: float
    largest_torque: float
    clearance: float
    ground: float
    fell_back: bool


@dataclass(frozen=True)
class Verification:
    """Everything that was found.

    Attributes:
        errors: on the car that it was made for.
        rows: one per run: who (`swing`, `8 rad/s`), member, weight, outcome, metrics.
        heading_ratio: swing over reference on that car; NaN when no friction was found that both survive.
        heading_friction: friction of that comparison.
        survival: weighted share of the ensemble that survives clean, swing and reference.
        complaints: what speaks against the swing; empty when it is verified.
        own: the run of the swing on that car, and its `summary`.
        reference: the same turn with the thesis' swing.
    """

    errors: StateErrors
    rows: pd.DataFrame
    heading_ratio: float
    heading_friction: float
    survival: dict[str, float]
    complaints: tuple[str, ...]
    own: RunLog
    summary: RunSummary
    reference: RunLog


def verify_swing(
    swing: SwingFile,
    swing_path: str | Path,
    scenario_name: str,
    settings: Sequence[str],
    ensemble: Ensemble,
    motion: RangeOfMotion,
    *,
    members: int | None = None,
    step: float = FINE_STEP,
    engine: Engine | None = None,
) -> Verification:
    """Does a swing keep what it promises, on the full car and on the cars of an ensemble?

    Args:
        swing: read from `swing_path`.
        scenario_name: turn to make; `settings` override it.
        ensemble: of cars; `members` of it, drawn by weight.
        motion: range-of-motion map of the car.
        step: of the plant, s.
        engine: where the ensemble is run.

    Raises:
        SwingError: the swing is never released in this turn.
        UserError: what the scenario or the file lacks.
    """
    engine = engine or Engine()
    runs = Runs(engine)
    fine = (f"simulation.step={step!r}", f"simulation.log_rate={min(500.0, 1.0 / step):g}")
    playing = ("tail.mode=swing", f"controller.swing_file={swing_path}")
    own = (*settings, *fine, *playing)
    scenario = load_scenario(scenario_name, own)
    thesis = load_scenario(scenario_name, [*settings, *fine, *REFERENCE_SETTINGS])
    run, reference = engine.map(_logged, [scenario, thesis])
    summary = summarise(run, scenario.name)
    if summary.trigger_time is None:
        raise SwingError(f"swing {swing.name}: was never released in this turn ({scenario_name} {' '.join(settings)})")
    errors = _state_errors(swing, scenario, run, motion)
    chosen = ensemble.members if members is None else ensemble.drawn(members)
    laws = {"swing": playing, "8 rad/s": REFERENCE_SETTINGS}
    pairs = [(who, member) for who in laws for member in chosen]
    tasks = [
        RunTask(m.name, scenario_name, (*m.settings_on(scenario_name), *settings, *fine, *laws[who]))
        for who, m in pairs
    ]
    rows = _rows(tasks, [(scenario, run), (thesis, reference)], runs)
    frame = make_frame(
        [
            {"who": who, "member": member.name, "weight": member.weight} | row
            for (who, member), row in zip(pairs, rows, strict=True)
        ]
    )
    survival = {}
    for who in laws:
        part = frame[frame["who"] == who]
        survival[who] = float(part.loc[part["clean"].fillna(False).astype(bool), "weight"].sum() / part["weight"].sum())
    pair = [summary.metrics.as_row(), summarise(reference, thesis.name).metrics.as_row()]
    ratio, friction = heading_ratio(scenario_name, (*settings, *fine), playing, scenario.car.tyre_friction, pair, runs)
    complaints = _complaints(swing, summary, errors, ratio)
    return Verification(errors, frame, ratio, friction, survival, tuple(complaints), run, summary, reference)


def _logged(scenario: Scenario) -> RunLog:
    return simulate(scenario, stop_when_certain=True)


def _rows(tasks: Sequence[RunTask], logged: Sequence[tuple[Scenario, RunLog]], runs: Runs) -> list[Row]:
    """Rows of tasks; one whose scenario has a log is not driven again (the nominal car is a member as well)."""
    known = {place: row for place, task in enumerate(tasks) if (row := _row_of_log(task, logged)) is not None}
    left = [place for place in range(len(tasks)) if place not in known]
    driven = dict(zip(left, runs.rows([tasks[place] for place in left]), strict=True))
    return [(known | driven)[place] for place in range(len(tasks))]


def _row_of_log(task: RunTask, logged: Sequence[tuple[Scenario, RunLog]]) -> Row | None:
    try:
        wanted = load_scenario(task.scenario, task.settings).resolved()
    except UserError:  # its row will say so
        return None
    return next((measured_row(task, one, run) for one, run in logged if one.resolved() == wanted), None)


def heading_ratio(
    scenario: str,
    settings: Sequence[str],
    playing: Sequence[str],
    friction: float,
    pair: Sequence[Row],
    runs: Runs,
) -> tuple[float, float]:
    """Heading change over the reference's at the highest friction that both survive clean, and that friction.

    From `friction`, where the rows of both are `pair`, downwards in steps; NaN twice where there is none. SwingError
    when a run fails.
    """

    def run(mu: float) -> Sequence[Row]:
        if mu == friction:
            return pair
        here = (*settings, f"car.tyre_friction={mu:.9g}")
        rows = runs.rows([RunTask("", scenario, (*here, *law)) for law in (playing, REFERENCE_SETTINGS)])
        for row in rows:
            if row["error"]:
                raise SwingError(f"{scenario} {' '.join(here)}: {row['error']}")
        return rows

    own, other, mu = both_clean(run, (friction - lower * LOWER_FRICTION for lower in range(MOST_LOWER + 1)))
    return own["heading_change_rad"] / other["heading_change_rad"] if own else math.nan, mu


def both_clean(run: Callable[[float], Sequence[Row]], frictions: Iterable[float]) -> tuple[Row, Row, float]:
    """Rows of two runs at the first friction that both survive clean, and that friction; empty ones and NaN else."""
    for friction in frictions:
        own, other = run(friction)
        if is_clean(own) and is_clean(other):
            return own, other, friction
    return {}, {}, math.nan


def _state_errors(swing: SwingFile, scenario: Scenario, log: RunLog, motion: RangeOfMotion) -> StateErrors:
    state = log.signal("controller_state")
    swinging = np.flatnonzero(state == SwingState.SWING)
    release = log.time[swinging[0]]
    side = scenario.manoeuvre.direction
    since = log.time - release
    during = (since >= 0.0) & (since <= swing.knots.time_s[-1])
    point = swing_at(swing, since, side)
    roll, pitch = log.signal("tail_roll_angle_rad"), log.signal("tail_pitch_angle_rad")
    after = since >= 0.0
    torque = np.maximum(np.abs(log.signal("tail_roll_torque_n_m")), np.abs(log.signal("tail_pitch_torque_n_m")))
    end = int(np.flatnonzero(during)[-1])
    upright = after & (log.signal("tilt_truth_rad") < 0.8)
    ground = ground_clearance(scenario, pitch[upright], roll[upright], log.signal("roll_truth_rad")[upright])
    return StateErrors(
        tail_roll=float(np.max(np.abs(roll - point.roll_position)[during])),
        tail_pitch=float(np.max(np.abs(pitch - point.pitch_position)[during])),
        tail_roll_at_end=float(abs(roll[end] - point.roll_position[end])),
        largest_roll=float(np.max(np.abs(roll[after]))),
        largest_pitch=float(np.max(np.abs(pitch[after]))),
        largest_torque=float(np.max(torque[after])),
        clearance=float(np.min(motion.clearance(pitch[after], roll[after], ("cage", "deck", "wheels")))),
        ground=float(np.min(ground)),
        fell_back=bool(np.any(state == SwingState.FALLBACK)),
    )


def _complaints(swing: SwingFile, summary: RunSummary, errors: StateErrors, ratio: float) -> list[str]:
    """In words, worst first."""
    found, limits = [], swing.limits
    if not summary.survived:
        found.append("the car rolls over")
    elif not summary.clean:
        found.append(f"{' and '.join(summary.metrics.outcome.touched)} touched the ground")
    if not ratio >= LEAST_HEADING:
        found.append(
            f"heading change is {ratio:.1%} of that with 8 rad/s; allowed: >= {LEAST_HEADING:.0%}"
            if ratio == ratio
            else "no friction was found that both this swing and that of 8 rad/s survive clean: headings do not compare"
        )
    if errors.fell_back:
        found.append("the tail did not follow its knots on the car that the swing was made for")
    for name, value, allowed, unit in (
        ("tail roll", errors.largest_roll, limits.roll_position_rad, "rad"),
        ("tail pitch", errors.largest_pitch, limits.pitch_position_rad, "rad"),
        ("motor torque", errors.largest_torque, limits.torque_n_m, "N m"),
    ):
        if value > allowed + _MARGIN:
            found.append(f"{name} reaches {value:.4g} {unit}; allowed: {allowed:.4g} {unit}")
    for name, value in (("car", errors.clearance), ("ground", errors.ground)):
        if value <= 0.0:
            found.append(f"the tail overlaps with the {name} by {-1000 * value:.0f} mm")
    return found
