"""Turns with what may be otherwise than planned, all at once: who stays on the wheels and how far it still turns.

All candidates of a car meet the same draws, each with the steering that it was given for the turn as planned, so that
a candidate and the published swing make a pair in each draw. Draws of one car are alike, and so are its floors: the
interval of the mean difference comes from drawing cars, and of each car its draws, again and again (a bootstrap of two
stages: Davison and Hinkley 1997, section 3.8). With few cars it is too narrow, since what differs from car to car is
then known from these few alone; with one car it holds for that car.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED, is_clean
from aerodima.optimisation.sweep.runs import Runs, make_frame
from aerodima.optimisation.sweep.study import Sample, Uniform
from aerodima.optimisation.swing.candidate import THESIS, Candidate
from aerodima.optimisation.swing.task import CASE, Task
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, load_scenario

AIR_SHARE, FRICTION_SHARE, TORQUE_SHARE, SPEED_SHARE = 0.3, 0.05, 0.2, 0.03
LIMIT_SHARE = 0.3
"""By which the largest torque of the tail motors may fall short."""
DELAY = 0.020
"""s, on top of the delay of the scenario's IMU."""
NOISE_FACTOR = 4.0
"""Noise and bias of the IMU grow by this: to about the upper ends of their priors."""
LATE = 0.050
"""Latest swing after its release, s: five ticks of the controller."""
MISSED_SHARE = 0.1
"""Of the draws that miss their release; the tail then waits on the inside through the whole turn."""
NEVER = 10.0
"""s; longer than any turn here, and the longest delay that a controller may have."""
RESAMPLES = 4000
"""Draws of the bootstrap, of cars and of their runs."""
_SEED = 1


@dataclass(frozen=True)
class Disturbance:
    """What differs from the plan.

    Attributes:
        air, friction, speed, torque: relative changes of the force on the sail, of the tyres' friction, of the
            commanded speed and of the torque that a command gives.
        torque_limit: relative change of the largest torque of the tail motors.
        imu_delay: on top of the scenario's, s.
        imu_noise: factor of the IMU's noise and bias.
        late: time from the release to the swing on top of the law's own, s; `NEVER` misses it.
        seed: of the sensors' noise; None: the scenario's.
    """

    air: float = 0.0
    friction: float = 0.0
    speed: float = 0.0
    torque: float = 0.0
    torque_limit: float = 0.0
    imu_delay: float = 0.0
    imu_noise: float = 1.0
    late: float = 0.0
    seed: int | None = None

    def settings(self, scenario: Scenario) -> tuple[str, ...]:
        """Overrides that make it, of the scenario that is disturbed.

        The force of the sail is changed through the density of the air, which acts on nothing else, so that every kind
        of coefficients can be disturbed; it equals a change of C_N.
        """
        air, car, imu = scenario.environment.air_density, scenario.car, scenario.imu
        found = [f"environment.air_density={air * (1 + self.air):.9g}"] if self.air else []
        found += [f"imu.delay={imu.delay + self.imu_delay:.9g}"] if self.imu_delay else []
        if self.imu_noise != 1.0:
            noises = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")
            found += [f"imu.{name}={self.imu_noise * getattr(imu, name):.9g}" for name in noises]
        found += [f"{FRICTION}={car.tyre_friction * (1 + self.friction):.9g}"] if self.friction else []
        found += [f"{SPEED}={scenario.manoeuvre.speed * (1 + self.speed):.9g}"] if self.speed else []
        found += [f"tail_motor.torque_error={self.torque:.9g}"] if self.torque else []
        if self.torque_limit:
            found += [f"tail_motor.torque_limit={scenario.tail_motor.torque_limit * (1 + self.torque_limit):.9g}"]
        if self.late:
            found += [f"controller.delay={min(NEVER, scenario.controller.delay + self.late):.9g}"]
        return (*found, *(() if self.seed is None else (f"seed={self.seed}",)))

    @property
    def missed(self) -> bool:
        """Whether the tail never swings."""
        return self.late >= NEVER


def draw_disturbances(number: int, seed: int, car: str) -> list[Disturbance]:
    """Everything at once, evenly from the ranges of this file (Sobol): the first ones of a car are those of any number.

    Args:
        number: of draws.
        seed: with the name of the car that of the draws.
        car: its name.
    """
    ranges = {"air": AIR_SHARE, "friction": FRICTION_SHARE, "speed": SPEED_SHARE, "torque": TORQUE_SHARE}
    factors: dict[str, Uniform] = {name: Uniform(low=-share, high=share) for name, share in ranges.items()}
    factors |= {
        "torque_limit": Uniform(low=-LIMIT_SHARE, high=0.0),
        "imu_delay": Uniform(low=0.0, high=DELAY),
        "imu_noise": Uniform(low=1.0, high=NOISE_FACTOR),
        "release": Uniform(low=0.0, high=1.0),
    }
    sample = Sample(number=number, seed=zlib.crc32(f"{seed} {car}".encode()), factors={**factors}, new_seeds=True)
    found = []
    for row in sample.rows():
        release, noise = float(row.pop("release")), int(row.pop("seed"))
        late = LATE * (release - MISSED_SHARE) / (1.0 - MISSED_SHARE) if release >= MISSED_SHARE else NEVER
        drawn = {name: float(f"{float(value):.6g}") for name, value in row.items()}
        found.append(Disturbance(**drawn, late=float(f"{late:.6g}"), seed=noise))
    return found


def drive_disturbed(task: Task, cases: pd.DataFrame, candidates: Sequence[Candidate], runs: Runs) -> pd.DataFrame:
    """A row per disturbed run of each case whose steering was borne out; without `survived` where one came to nothing.

    Args:
        task: with the number of draws.
        cases: a row per candidate and turn, with its steering.
        candidates: of the cases.
        runs: where they are made.
    """
    who = {one.name: one for one in candidates}
    heads, tasks = [], []
    for case in cases[cases["steering_deg"].notna()].to_dict("records"):
        turn = task.run(task.steered_turn(who[case["candidate"]], case), task.step)
        planned = load_scenario(turn.scenario, turn.settings)
        for draw, given in enumerate(draw_disturbances(task.disturbed, task.seed, case["car"]), 1):
            head = {name: case[name] for name in ("candidate", *CASE)} | {"draw": draw, **vars(given)}
            heads.append(head | {"missed": given.missed})
            tasks.append(replace(turn, settings=(*turn.settings, *given.settings(planned))))
    return make_frame([head | _result(task, row) for head, row in zip(heads, runs.rows(tasks), strict=True)])


def _result(task: Task, row: Mapping[str, Any]) -> dict[str, Any]:
    """Of the row of a run; one that is not clean has turned nothing."""
    found = {name: row.get(name) for name in ("outcome", "peak_roll_rad", "exit_time_s", "swing_trigger_time_s")}
    found["error"] = row.get("error")
    if row["outcome"] is None:
        return found | dict.fromkeys(("survived", "counts", "course_change_rad"))
    clean = is_clean(row)
    course = float(row["course_change_rad"] or 0.0) if clean else 0.0
    return found | {"survived": float(clean), "counts": float(task.counts(row)), "course_change_rad": course}


def summarise_disturbed(runs: pd.DataFrame, candidates: Sequence[Candidate]) -> pd.DataFrame:
    """A row per candidate: shares and mean course of its runs, and the difference to the published swing in pairs.

    A run that is not clean has turned nothing. The differences are NaN without the published swing.
    """
    rows = []
    for who in candidates:
        own = runs[runs["candidate"] == who.name]
        ran = own[own["survived"].notna()]
        released, missed = (ran[ran["missed"].astype(bool) == one] for one in (False, True))
        row: dict[str, Any] = {"candidate": who.name, "cases": len(own.groupby(CASE)), "runs": len(ran)}
        row |= {"failed": len(own) - len(ran), "survived": ran["survived"].mean(), "counted": ran["counts"].mean()}
        row |= {"released_survived": released["survived"].mean(), "missed_survived": missed["survived"].mean()}
        row["mean_course_rad"] = ran["course_change_rad"].mean()
        for name, value in (("survived", "survived"), ("course", "course_change_rad")):
            mean, low, high = paired_difference(paired_by_car(runs, who.name, THESIS.name, value))
            row |= {f"{name}_difference": mean, f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return make_frame(rows)


def paired_by_car(runs: pd.DataFrame, one: str, other: str, value: str) -> list[FloatArray]:
    """Difference of a value between two candidates, of each car the means (draws,) over its other cases.

    Cases in which one of them has no steering make no pair.
    """
    tables = [runs[runs["candidate"] == name].set_index([*CASE, "draw"])[value].astype(float) for name in (one, other)]
    gap = (tables[0] - tables[1]).dropna()
    draws = gap.groupby(level=["car", "draw"]).mean()
    return [np.asarray(part, dtype=np.float64) for _, part in draws.groupby(level="car")]


def paired_difference(cars: Sequence[FloatArray]) -> tuple[float, float, float]:
    """Mean over the cars, and its 95 % interval; NaN without a pair.

    Args:
        cars: differences of each, in the unit of what they are of.
    """
    if not cars:
        return np.nan, np.nan, np.nan
    rng = np.random.default_rng(_SEED)
    number = len(cars)
    found = np.zeros(RESAMPLES)
    for _ in cars:
        drawn = rng.integers(number, size=RESAMPLES)
        for which, car in enumerate(cars):
            own = drawn == which
            draws = rng.integers(car.size, size=(np.count_nonzero(own), car.size))
            found[own] += car[draws].mean(axis=1) / number
    low, high = np.quantile(found, [0.025, 0.975])
    return float(np.mean([car.mean() for car in cars])), float(low), float(high)
