"""The turns of a calibration on reduced cars and on full cars, and the figures that the thesis
would have printed.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid, trapezoid
from scipy.signal import butter, lfilter

from aerodima.optimisation.calibrate.calibration_plan import (
    CAUSAL_FILTER_THRESHOLD,
    FIGURES,
    LIFT,
    CalibrationPlan,
    CarPrior,
    Turn,
)
from aerodima.optimisation.studies.limit_search import Bracket
from aerodima.workbench.batch.row_store import Row, content_key
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.rollout import STEP
from aerodima.workbench.car.reduced.states import RATES, V, W
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.turns import Turns, drive_turns
from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.car.verdict import is_loaded
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.signals import IMU_FILTER, low_pass
from aerodima.workbench.metrics.published_values import SAMPLE_TIMES
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import WHEELS

BEFORE = 0.4
"""Time before the start of the steering from which figures are made, s."""
AFTER = 1.6
"""Time after the start of the steering until which figures are made, s."""
LEFT = [index for index, wheel in enumerate(WHEELS) if wheel.endswith("left")]


@dataclass(frozen=True)
class Motion:
    """Signals of a run, every `STEP`, which begin `BEFORE` the steering does.

    Attributes:
        yaw_rate: yaw rate (k), rad/s.
        acceleration: lateral acceleration (k), m/s2.
        roll_rate: roll rate outwards (k), rad/s.
        both_inner: flags of the times at which both inner wheels bear load (k).
    """

    yaw_rate: FloatArray
    acceleration: FloatArray
    roll_rate: FloatArray
    both_inner: NDArray[np.bool_]


def figures_of_motion(motion: Motion, turn: Turn, nuisances: dict[str, float]) -> dict[str, float]:
    """Computes `FIGURES` of one run that survived, as the thesis took them for the system, and the
    yaw rate of the lift.

    Args:
        motion: motion of the run.
        turn: turn whose system decides over filter and sample time.
        nuisances: window and latency in s, gyro_bias in rad/s, forward above 0.5 for a filter of
            one direction.
    """
    of_the_field = turn.system == "physical"
    stride = round(SAMPLE_TIMES["physical"] / STEP) if of_the_field else 1
    time: FloatArray = STEP * np.arange(len(motion.yaw_rate), dtype=float)[::stride]
    signals = [motion.yaw_rate, motion.acceleration, motion.roll_rate]
    signals = [values[::stride] for values in signals]
    start = BEFORE
    if of_the_field:
        start -= nuisances["latency"]
        signals[0] = signals[0] + nuisances["gyro_bias"]
        if nuisances["forward"] > CAUSAL_FILTER_THRESHOLD:
            b, a = butter(IMU_FILTER.order, IMU_FILTER.cutoff_hz, fs=1.0 / SAMPLE_TIMES["physical"])
            signals = [lfilter(b, a, values - values[0]) + values[0] for values in signals]
        else:
            signals = [low_pass(time, values, IMU_FILTER) for values in signals]
    window = (time >= start - 1e-9) & (time <= start + nuisances["window"] + 1e-9)
    figures = []
    inside = time[window]
    span = inside[-1] - inside[0]
    for values in signals[:2]:
        figures.append(np.max(np.abs(values[window])))
        figures.append(trapezoid(values[window], inside) / span)
    figures.append(np.max(cumulative_trapezoid(signals[2], time, initial=0.0)))
    steered = np.arange(len(motion.both_inner)) * STEP >= BEFORE
    lifted = np.flatnonzero(~motion.both_inner & steered)
    until = lifted[0] + 1 if lifted.size else None
    figures.append(np.max(motion.yaw_rate[:until]))
    return dict(zip((*FIGURES, LIFT), map(float, figures), strict=True))


def nuisances_of(prior: CarPrior, car: FloatArray) -> dict[str, float]:
    """Returns the nuisances of a car (n), by name."""
    return {name: float(car[prior.column(name)]) for name in prior.plan.nuisances}


@dataclass(frozen=True)
class WorkItem:
    """Work for the engine: cars (m, n) in one turn.

    Attributes:
        plan: plan of the calibration.
        turn: turn that the cars drive.
        cars: coordinates of the cars (m, n).
        reach: reach of the search for the flip around the friction of a car, to either side, in its
            logarithm; first step of the search of a full car.
        step: step of the full car, s; None for the default.
        margins: logarithm of the friction at which a search begins over that of each car.
    """

    plan: CalibrationPlan
    turn: Turn
    cars: tuple[tuple[float, ...], ...]
    reach: float = 0.0
    step: float | None = None
    margins: tuple[float, ...] = ()

    def key(self, work: str) -> str:
        """Returns the key of the cached result of some work."""
        size = self.plan.size
        return content_key(
            work,
            self.turn.model_dump(),
            self.cars,
            self.margins,
            self.reach,
            self.step,
            (size.rounds, size.full_rounds),
            self.plan.settings,
        )


@lru_cache(maxsize=4)
def _prior(plan: str) -> CarPrior:
    return CarPrior(CalibrationPlan.model_validate_json(plan))


def prior_of(plan: CalibrationPlan) -> CarPrior:
    """Returns the prior of a plan, made once in each process."""
    return _prior(plan.model_dump_json(by_alias=True))


def run_reduced(item: WorkItem) -> Json:
    """Searches the friction at which each reduced car flips, and computes the figures of every run
    of the search that survived.

    Returns:
        `flips` (m): logarithm of the friction at the flip, None where the search did not find it,
        or where it has no reach and each car drives once; `inputs` (k, n) of the runs that
        survived, which are cars with the friction of the run, and their `figures` (k, 6).
    """
    plan = item.plan
    prior = prior_of(plan)
    turn = item.turn
    cars = np.array(item.cars)
    friction = prior.column(turn.friction)
    scenarios = [load_scenario(f"turn_{turn.tail}", prior.settings(car, turn)) for car in cars]
    vehicles = VehicleParams.from_scenarios(scenarios)
    plans = TurnPlans.from_scenarios(scenarios)
    begun = drive_turns(vehicles, plans, duration=0.0, length=STEP).last
    rng = np.random.default_rng([plan.seed, crc32(turn.name.encode()), crc32(cars.tobytes())])
    x, z = (cars[:, prior.column(key)] for key in ("imu.x", "imu.z"))
    centre = np.log(cars[:, friction])
    ends = Bracket(centre - item.reach, centre + item.reach)
    bracket = ends
    inputs = []
    figures = []
    for _ in range(plan.size.rounds if item.reach else 1):
        tried = np.exp(bracket.next_value(centre, item.reach))
        turns = drive_turns(
            replace(vehicles, friction=tried),
            plans,
            duration=AFTER,
            length=STEP,
            history=True,
            begun=begun,
        )
        bracket = bracket.updated(np.log(tried), turns.survived)
        motions = _motions(turns, x, z)
        for index in np.flatnonzero(turns.survived):
            car = _with_drawn_nuisances(prior, cars[index], rng)
            car[friction] = tried[index]
            inputs.append(car.tolist())
            shown = figures_of_motion(motions[index], turn, nuisances_of(prior, car))
            figures.append(list(shown.values()))
    known = (bracket.held > ends.held) & (bracket.lost < ends.lost)
    middle = bracket.next_value(centre, item.reach)
    flips = [float(value) if ok else None for value, ok in zip(middle, known, strict=True)]
    return {"flips": flips, "inputs": inputs, "figures": figures}


def _with_drawn_nuisances(prior: CarPrior, car: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Returns a car (n) with new nuisances, which cost nothing, except for its gyro bias."""
    drawn = car.copy()
    for name, ends in prior.plan.nuisances.items():
        drawn[prior.column(name)] = rng.uniform(*ends)
    bias = prior.column("gyro_bias")
    drawn[bias] = car[bias]
    return drawn


def _motions(driven: Turns, x: FloatArray, z: FloatArray) -> list[Motion]:
    """Returns the motion of each reduced car at its IMU, which is at x and z (m) in B; before the
    steering rates and acceleration are zero and both inner wheels bear load.
    """
    assert driven.history is not None
    assert driven.loads is not None
    rates = driven.history[:, RATES].swapaxes(1, 2)
    w = rates[..., W]
    v = rates[..., V] + np.cross(w, np.column_stack([x, np.zeros_like(x), z]))
    acceleration = np.gradient(v, STEP, axis=0) + np.cross(w, v)
    loaded = is_loaded(driven.loads[:, LEFT]).all(axis=1)
    # States are those at the end of a step, loads those at its beginning.
    before = np.zeros((round(BEFORE / STEP) + 1, len(x)))
    after = (w[:-1, :, 2], acceleration[:-1, :, 1], w[:-1, :, 0])
    signals = [np.concatenate([before, values]).T for values in after]
    both = np.concatenate([before[1:] == 0.0, loaded]).T
    return [Motion(*car) for car in zip(*signals, both, strict=True)]


def search_full(item: WorkItem) -> Json:
    """Searches the friction at which each full car flips; returns the same as `run_reduced`.

    The search begins at the margin of each car and goes up or down, by the reach of the item and
    then by twice as much as the step before, until the outcome changes; then it bisects. The last
    run has the friction of the car. A bracket wider than the reach gives no flip. `errors` says why
    cars could not be run.
    """
    prior = prior_of(item.plan)
    turn = item.turn
    column = prior.column(turn.friction)
    result: dict[str, list[Any]] = {"flips": [], "inputs": [], "figures": [], "errors": []}

    def survives(car: FloatArray, friction: float) -> bool:
        tried = car.copy()
        tried[column] = np.exp(friction)
        row = _full_row(prior, turn, tried, item.step)
        if "error" in row:
            raise UserError(row["error"])
        if row["survived"]:
            result["inputs"].append(tried.tolist())
            result["figures"].append([row[metric] for metric in (*FIGURES, LIFT)])
        return row["survived"]

    for numbers, margin in zip(item.cars, item.margins, strict=True):
        car = np.array(numbers)
        own = float(np.log(car[column]))
        bracket = Bracket()
        stride = 0.5 * item.reach
        tried = own + margin
        try:
            for _ in range(item.plan.size.full_rounds):
                bracket = bracket.updated(tried, survives(car, tried))
                stride *= 2.0
                tried = float(bracket.next_value(tried, stride))
            survives(car, own)
        except UserError as error:
            result["errors"].append(f"; {error}")
        is_narrow = bracket.lost - bracket.held <= item.reach
        result["flips"].append(tried if is_narrow else None)
    return result


def run_full(item: WorkItem) -> list[Row]:
    """Runs full cars (m) in a turn, each at its own friction.

    Returns:
        A row per car: `survived`, `trigger` in s after the steering or None, and the figures of a
        run that survived; or `error` of a car that could not be run.
    """
    prior = prior_of(item.plan)
    return [_full_row(prior, item.turn, np.array(car), item.step) for car in item.cars]


def _full_row(prior: CarPrior, turn: Turn, car: FloatArray, step: float | None) -> Row:
    from aerodima.workbench.batch.simulation import simulate

    settings = prior.settings(car, turn)
    if step is not None:
        settings += [f"simulation.step={step!r}"]
    try:
        run = simulate(load_scenario(f"turn_{turn.tail}", settings), record="outcome")
        signals = turn_signals(run, "truth")
        start = signals.window[0]
        row: Row = {"survived": outcome_of(run).result == "survived", "trigger": None}
        if run.has_tail:
            swings = np.isin(run.signal("controller_state"), (SwingState.DELAY, SwingState.SWING))
            if swings.any():
                row["trigger"] = float(signals.time[np.argmax(swings)] - start)
        if row["survived"]:
            grid = start - BEFORE + STEP * np.arange(round((BEFORE + AFTER) / STEP))
            both = is_loaded(signals.wheel_loads[:, LEFT]).all(axis=1)  # type: ignore[index]
            moved = (signals.yaw_rate, signals.lateral_acceleration, signals.roll_rate)
            yaw, lateral, roll = (np.interp(grid, signals.time, values) for values in moved)
            both_inner = np.interp(grid, signals.time, 1.0 * both) > 0.5
            motion = Motion(yaw, lateral, roll, both_inner)
            row |= figures_of_motion(motion, turn, nuisances_of(prior, car))
        return row
    except (UserError, ArithmeticError, RuntimeError, ValueError) as error:
        return {"error": " ".join(str(error).split())}
