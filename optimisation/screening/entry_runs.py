"""Manoeuvres of many reduced cars that begin rolling, steered open loop or as a fishhook, with the feedback law.

The law sees the IMU late, as on the full car, but without noise and bias, and the speed without delay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from aerodima.optimisation.screening.compiled import for_cars
from aerodima.optimisation.screening.turns import heights
from aerodima.optimisation.screening.vehicle_motion import (
    COMMANDED,
    RATES,
    SPIN,
    STATES,
    TINY,
    TRAVEL,
    V,
    W,
    advance,
    dot,
    up,
)
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.feedback_law import Seen, respond
from aerodima.workbench.controllers.manoeuvre import make_schedule, run_time
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.metrics.tip_up import LAST, TWO_WHEELS
from aerodima.workbench.metrics.turn_course import velocity_over_ground
from aerodima.workbench.metrics.turn_signals import EXIT_YAW_RATE

STEP = 0.002
"""s."""
STRAIGHT = 0.01
"""rad; below it a command steers to no side."""
TURN = 2.0 * np.pi
LEAD = 0.1
"""s; of the straight before the steering so much is driven."""


@dataclass(frozen=True)
class Entries:
    """What came of n runs.

    Attributes:
        upright: no two wheels of a side in the air, no tail on the ground, no board while the car is steered, not
            flipped; and straight again at the end, as `optimisation.entry.entry_speed` asks.
        figure: mean lateral acceleration of the course to the side that is steered to, m/s2.
    """

    upright: np.ndarray
    figure: FloatArray


def enter(cars: Vehicles, scenario: Scenario, gains: Any, steers_tail: FloatArray) -> Entries:
    """Drives n cars that begin rolling at their speeds through the manoeuvre of a scenario, to the left.

    Args:
        cars: n of them.
        scenario: of manoeuvre, servo, controller and IMU; wheelbase of all.
        gains: fields of `FeedbackParameters` as arrays (n).
        steers_tail: 1 where the law rolls the tail, 0 where its roll is held in the middle (n).

    Raises:
        UserError: a manoeuvre that follows a path.
    """
    n, rate, speed, plan = cars.count, scenario.controller.rate, cars.speed, scenario.manoeuvre
    if plan.kind == "path":
        raise UserError("manoeuvre.kind: path; the screening model knows: turn, fishhook, slalom, rising")
    fishhook = plan.kind == "fishhook"
    schedule = None if fishhook else make_schedule(scenario)
    start, reach = plan.turn_start - LEAD, plan.steer_angle / scenario.servo.rate
    state = np.zeros((len(STATES), n))
    state[RATES][V][0], state[RATES][SPIN] = speed, speed / cars.rolling_radius
    ticks, most = round(1.0 / (STEP * rate)), scenario.servo.rate * STEP
    late = round(np.ceil(scenario.imu.delay * rate - 1e-9))
    angle, reference, counter = np.zeros(n), np.zeros(n), np.full(n, np.inf)
    upright, gone, total, steered, course = np.ones(n, bool), np.zeros(n, bool), *np.zeros((3, n))
    hold, command, seen = (scenario.controller.hold_kp, scenario.controller.hold_kd), np.zeros(n), []
    pitch = np.stack([gains.pitch_angle, *np.outer([0.0, *hold], np.ones(n))])
    state[6] = gains.pitch_angle
    moved_by = for_cars(driven, cars, *COMMANDED)
    steps, last, ending = round((run_time(scenario) - start) / STEP), round(LAST / STEP), np.zeros(n)
    for index in range(steps):
        time = start + index * STEP
        if index % ticks == 0:
            seen.append((state[5], state[RATES][W][0], state[RATES][W][2]))
            roll, roll_rate, yaw_rate = seen[max(0, index // ticks - late)]
            signals = Seen(roll, roll_rate, yaw_rate, state[RATES][V][0], command, np.ones(n, bool))
            found = respond(gains, scenario.car.wheelbase, rate, reference, signals)
            reference = steers_tail * found.reference
            tail = np.stack([pitch, np.stack([reference, np.zeros(n), gains.kp, gains.kd])])
            if schedule is not None:
                command = np.full(n, schedule.at(time).steering_angle)
            else:
                falls = np.isinf(counter) & (time >= plan.turn_start + reach) & (roll_rate < plan.counter_roll_rate)
                counter = np.where(falls, time, counter)
                command = np.where(
                    time < counter, plan.steer_angle * (time + 1e-9 >= plan.turn_start), -plan.steer_angle
                )
                command = np.where(time >= counter + 2.0 * reach + plan.turn_hold, 0.0, command)
        angle = angle + np.clip(command - angle, -most, most)
        new, clear, board, level = moved_by(
            state, np.stack([angle, angle]), speed / cars.rolling_radius, tail * cars.has_tail
        )
        state = np.where(gone, state, new)
        gone |= level < np.cos(FLIP_TILT)
        if time >= plan.turn_start:
            steers = np.abs(command) > STRAIGHT
            upright &= (clear > 0.0) & ((board > 0.0) | ~steers) & ~gone
            if index >= steps - last:
                ending += np.where(steers, np.nan, state[14] / last)
            ahead, left = velocity_over_ground(state[RATES][V], state[RATES][W], state[5], state[4], cars.com_x)
            turned = state[3] + np.arctan2(left, ahead) - course
            to_side = np.sign(command) * np.hypot(ahead, left) * (turned - TURN * np.round(turned / TURN)) / STEP
            course, total, steered = course + turned, total + steers * to_side, steered + steers
    straight = np.isnan(ending) | (np.abs(ending) <= EXIT_YAW_RATE)  # NaN: it is steered to the end
    return Entries(upright & straight, total / np.maximum(steered, 1.0))


def driven(
    cars: Vehicles, state: FloatArray, steering: FloatArray, shaft_speed: FloatArray, tail: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """State after `STEP`; 1 where no side lifts and no tail touches the ground; height of the board; cosine of tilt."""
    state, _ = advance(STEP, cars, state, steering, shaft_speed, tail)
    lift, (sail, board) = wheel_lifts(state, cars, steering[0]), heights(state, cars)
    side = np.maximum(np.minimum(lift[0], lift[2]), np.minimum(lift[1], lift[3]))
    return state, (side <= TWO_WHEELS) & (sail > 0.0), board, up(state[4], state[5])[2]


def wheel_lifts(state: FloatArray, cars: Vehicles, steering: FloatArray) -> FloatArray:
    """Height of the lowest point of each tyre over the ground (4, n), m; negative where it presses into it.

    Args:
        state: (24, n).
        cars: n of them.
        steering: angle of the front wheels (n), rad.
    """
    n = up(state[4], state[5])[:, None]
    steer = np.concatenate([np.stack([steering, steering]), np.zeros((2, cars.count))])
    tilt = dot(np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer]), n)
    reach = np.sqrt(cars.tyre_radius**2 * (1.0 - tilt * tilt + TINY) + cars.tyre_half_width**2 * tilt * tilt)
    centre = np.stack([cars.wheel[0], cars.wheel[1], cars.wheel[2] + state[TRAVEL]])
    found: FloatArray = state[2] + dot(n, centre) - cars.edge * np.abs(tilt) - reach
    return found


def climb(
    cars: Vehicles, speeds: FloatArray, scenario: Scenario, gains: Any, steers_tail: FloatArray
) -> tuple[np.ndarray, FloatArray]:
    """Whether n cars stay upright at speeds (m, n), m/s, and their figures, (m, n) each; all runs at once."""
    which, speed = np.tile(np.arange(cars.count), len(speeds)), speeds.ravel()
    tried = cars.take(which)
    tried = replace(tried, speed=speed, slip_speed=tried.slip_speed * speed / tried.speed)  # of a slip angle
    own = SimpleNamespace(**{name: values[which] for name, values in vars(gains).items()})
    found = enter(tried, scenario, own, steers_tail[which])
    return found.upright.reshape(speeds.shape), found.figure.reshape(speeds.shape)
