"""Manoeuvres of many reduced cars that begin rolling, steered open loop, and the highest speed that they complete."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aerodima.optimisation.screening.turns import heights
from aerodima.optimisation.screening.vehicle_motion import (
    RATES,
    SPIN,
    STATES,
    TINY,
    TRAVEL,
    Commands,
    V,
    W,
    cross,
    dot,
    equations,
    step,
    up,
)
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.car_parameters import FeedbackParameters
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.feedback_law import Seen, respond
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT

LIFT = 0.005
"""m; two wheels of a side that are higher at once end a manoeuvre (NHTSA: two inches at full size)."""
LEAST_YAW = 0.9
"""Share of the speed times yaw rate of the car without a tail that a turn must have."""


@dataclass(frozen=True)
class Steering:
    """Commands of a manoeuvre, held from each time on.

    Attributes:
        times: s, increasing; levels: rad, of the same length. The first command is 0 until the first time.
        counter: steer to the other side once the roll rate has fallen (fishhook), for so long, s; 0: no.
        duration: of the run, s.
    """

    times: tuple[float, ...]
    levels: tuple[float, ...]
    duration: float
    counter: float = 0.0

    def at(self, time: float) -> float:
        """Command at a time, rad."""
        index = int(np.searchsorted(self.times, time + 1e-9, side="right")) - 1
        return 0.0 if index < 0 else self.levels[index]


START = 0.1
ANGLE = float(np.radians(30.0))
MANOEUVRES = {
    "turn": Steering((START, START + 0.5), (ANGLE, 0.0), 1.4),
    "held turn": Steering((START, START + 1.5), (ANGLE, 0.0), 2.2),
    "twice": Steering((START, START + 0.5, START + 1.5, START + 2.0), (ANGLE, 0.0, ANGLE, 0.0), 2.9),
    "fishhook": Steering((START,), (ANGLE,), 2.4, counter=0.95),
    "slalom": Steering(
        tuple(START + 0.02 * k for k in range(101)),
        tuple(float(ANGLE * np.sin(2 * np.pi * 0.02 * k / 1.0)) * (k < 100) for k in range(101)),
        2.6,
    ),
}
ROLL_FALLS = float(np.radians(1.5) * np.sqrt(10.0))
"""rad/s; 1.5 degrees per second at full size (NHTSA)."""


def wheel_heights(state: FloatArray, cars: Vehicles, steering: FloatArray) -> FloatArray:
    """Of the lowest point of each wheel over the ground (4, n), m; negative where it presses into it."""
    n = up(state[4], state[5])
    steer = np.concatenate([np.stack([steering, steering]), np.zeros((2, cars.count))])
    axle = np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer])
    tilt = dot(axle, n[:, None])
    reach = np.sqrt(cars.tyre_radius**2 * (1.0 - tilt * tilt + TINY) + cars.tyre_half_width**2 * tilt * tilt)
    centre = np.stack([cars.wheel[0], cars.wheel[1], cars.wheel[2] + state[TRAVEL]])
    middle = state[2] + dot(n[:, None], centre)
    found: FloatArray = middle - cars.edge * np.abs(tilt) - reach
    return found


@dataclass(frozen=True)
class Entry:
    """What came of n runs: whether nothing tipped or touched the ground, and speed times mean yaw rate, m/s2."""

    upright: np.ndarray
    figure: FloatArray
    tail_roll: FloatArray
    history: FloatArray | None = None


Gains = dict[str, Any]


def enter(
    cars: Vehicles,
    steering: Steering,
    speed: FloatArray,
    gains: Any,
    controls: FloatArray,
    late: int,
    scenario: Scenario,
    length: float = 0.002,
    history: bool = False,
) -> Entry:
    """Drives n cars that begin at speeds (n), m/s, through a manoeuvre to the left.

    Args:
        gains: fields of `FeedbackParameters` as arrays (n).
        controls: 1 where the law steers the tail, 0 where it is held upright (n).
        late: ticks by which the IMU is old.
        scenario: rates of servo and controller, gains of the pitch joint, wheelbase.
    """
    n, rate, c = cars.count, scenario.controller.rate, scenario.controller
    state = np.zeros((len(STATES), n))
    state[RATES][V][0] = speed
    state[RATES][SPIN] = speed / cars.rolling_radius
    ticks, servo = round(1.0 / (length * rate)), scenario.servo.rate * length
    angle, reference = np.zeros(n), np.zeros(n)
    upright, gone, kept = np.ones(n, bool), np.zeros(n, bool), []
    total, steered = np.zeros(n), np.zeros(n)
    countered = np.full(n, np.inf)
    seen: list[tuple[FloatArray, FloatArray]] = []
    pitch = np.stack([0.0 * speed, 0.0 * speed, c.hold_kp + 0.0 * speed, c.hold_kd + 0.0 * speed])
    tail = np.stack([pitch, pitch])
    last_command = np.zeros(n)
    for index in range(round(steering.duration / length)):
        time = index * length
        command = np.full(n, steering.at(time))
        if steering.counter > 0.0 and time > START + 0.05:
            turns = np.isinf(countered) & (state[RATES][W][0] < ROLL_FALLS)
            countered = np.where(turns, time, countered)
            command = np.where(time >= countered, -ANGLE, command)
            command = np.where(time >= countered + steering.counter, 0.0, command)
        if index % ticks == 0:
            seen.append((state[5].copy(), state[RATES][W][0].copy()))
            roll, roll_rate = seen[max(0, len(seen) - 1 - late)]
            ahead = state[RATES][V][0]
            found = respond(
                gains,
                scenario.car.wheelbase,
                rate,
                reference,
                Seen(roll, roll_rate, ahead, last_command, state[7], np.ones(n, bool)),
            )
            reference = np.where(controls > 0.0, found.reference, 0.0)
            own = np.stack([found.position, found.velocity, found.kp, found.kd])
            tail = np.stack([pitch, np.where(controls > 0.0, own, pitch)])
            last_command = command
        angle = angle + np.clip(command - angle, -servo, servo)
        commands = Commands(np.stack([angle, angle]), speed / cars.rolling_radius, tail * cars.has_tail)
        state = np.where(gone, state, step(state, equations(state, commands, cars), length))
        gone |= up(state[4], state[5])[2] < np.cos(FLIP_TILT)
        if index * length >= START:
            lift = wheel_heights(state, cars, angle)
            side = np.maximum(np.minimum(lift[0], lift[2]), np.minimum(lift[1], lift[3]))
            low_tail, board = heights(state, cars)
            upright &= (side <= LIFT) & (low_tail > 0.0) & (board > 0.0) & ~gone
            steers = np.abs(command) > 0.01
            total += np.where(steers, np.sign(command) * state[14], 0.0)
            steered += steers
        if history:
            kept.append(np.vstack([state, angle]))
    figure = speed * total / np.maximum(steered, 1.0)
    return Entry(upright, figure, state[7], np.array(kept) if history else None)


def climb(
    cars: Vehicles,
    steering: Steering,
    speeds: FloatArray,
    gains: Any,
    controls: FloatArray,
    late: int,
    scenario: Scenario,
) -> tuple[np.ndarray, FloatArray]:
    """Whether n cars stay upright at speeds (m), m/s, and their figures, (m, n) each; all runs at once."""
    n, m = cars.count, len(speeds)
    which, speed = np.tile(np.arange(n), m), np.repeat(speeds, n)
    all_gains = type(gains)(**{name: values[which] for name, values in vars(gains).items()})
    tried = with_speed(cars.take(which), speed)
    found = enter(tried, steering, speed, all_gains, controls[which], late, scenario)
    return found.upright.reshape(m, n), found.figure.reshape(m, n)


def entry_speeds(speeds: FloatArray, upright: np.ndarray, figure: FloatArray, least: FloatArray) -> FloatArray:
    """Highest speed (n) below the first that is not upright, at which the figure is at least that (n); 0 without."""
    held = np.cumprod(upright, axis=0) > 0
    ok = held & (figure >= least)
    found: FloatArray = np.max(np.where(ok, speeds[:, None], 0.0), axis=0)
    return found


def with_speed(cars: Vehicles, speed: FloatArray) -> Vehicles:
    """The cars at speeds (n), m/s; a slip angle is spread over a slip speed that grows with the speed."""
    return replace(cars, speed=speed, slip_speed=cars.slip_speed * speed / cars.speed)


def gains_of(laws: list[dict[str, float]], base: FeedbackParameters) -> Any:
    """Gains of laws as arrays (laws,)."""
    from types import SimpleNamespace

    names = [name for name in type(base).model_fields]
    return SimpleNamespace(**{k: np.array([law.get(k, getattr(base, k)) for law in laws]) for k in names})
