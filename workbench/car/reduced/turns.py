"""Turns of many reduced cars at once, each with its own floor, steering and swing; what screening
asks of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.workbench.car.reduced.compiled import run
from aerodima.workbench.car.reduced.dynamics import (
    RATES,
    STATES,
    TAIL_RATE,
    TINY,
    V,
    W,
    advance,
    tail_axes,
    up_in_body,
)
from aerodima.workbench.car.reduced.turn_plans import TurnPlans
from aerodima.workbench.car.reduced.vehicle_parameters import Vehicles
from aerodima.workbench.car.tail_impulses import END_TILT, FLIP_TILT
from aerodima.workbench.car.tail_plant import SAIL_TIP_MARGIN
from aerodima.workbench.car.turn_course import velocity_over_ground
from aerodima.workbench.car.turn_signals import CALM, CALM_FOR, EXIT_YAW_RATE, LOADED_FORCE
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.core.array_types import FloatArray

_COS_CALM = np.cos(CALM["tilt_truth_rad"])
_CALM_STATES = {
    **{f"w_{axis}": CALM[f"gyro_{axis}_truth_rad_per_s"] for axis in "xyz"},
    "v_y": CALM["velocity_y_truth_m_per_s"],
    **{name: CALM[name + "_rad_per_s"] for name in ("tail_pitch_rate", "tail_roll_rate")},
}
_CALM_PLACES = [STATES.index(name) for name in _CALM_STATES]
WITHIN = (np.arange(8.0)[:, None] + 0.5) / 8.0
"""Instants of a step, in its length: the wheels' angle in a step is the mean over them, so that it
changes smoothly with the times of the steering."""
HISTORY = ("history", "asked", "loads")
"""What `Turns` keeps of every step."""


class TurnRecord:
    """Of n cars in a turn to the left, from the start of the steering on.

    Attributes:
        peak_roll: outwards, rad.
        lowest_tail, lowest_board: least height over the ground, m.

    Args:
        cars: n of them.
        state: when the steering begins (24, n).
        straight: when the wheels are straight again (n), s since then.
    """

    def __init__(self, cars: Vehicles, state: FloatArray, straight: FloatArray) -> None:
        n = cars.count
        self._cars = cars
        self._begun = state
        self._straight = straight
        self._limits = np.outer(list(_CALM_STATES.values()), np.ones(n))
        self._limits[-2:, cars.has_tail == 0.0] = np.inf
        self._restless = straight
        self._settled = np.full(n, np.nan)
        self._left = np.full(n, np.nan)
        self._around = np.zeros((2, *state.shape))
        self.peak_roll = np.zeros(n)
        self.lowest_tail = np.full(n, np.inf)
        self.lowest_board = np.full(n, np.inf)

    def see(self, time: Any, before: FloatArray, state: FloatArray) -> None:
        """Records states (24, n): those a step before a time since the start of the steering, s,
        and those at it.
        """
        self.peak_roll = np.maximum(self.peak_roll, state[5])
        tail, board = heights(state, self._cars)
        self.lowest_tail = np.minimum(self.lowest_tail, tail)
        self.lowest_board = np.minimum(self.lowest_board, board)
        calm = np.abs(state[14]) < EXIT_YAW_RATE
        leaves = np.isnan(self._left) & (time > self._straight) & calm
        self._left = np.where(leaves, time, self._left)
        self._around = np.where(leaves, np.stack([before, state]), self._around)

    def settle(self, time: Any, state: FloatArray, loads: FloatArray, busy: np.ndarray) -> None:
        """Decides who has settled, as in a log, by the loads of the wheels (4, n), N, and by whose
        law is busy.
        """
        calm = np.logical_and.reduce(np.abs(state[_CALM_PLACES]) <= self._limits)
        loaded = np.logical_and.reduce(loads > LOADED_FORCE)
        level = up_in_body(state)[2] > _COS_CALM
        calm = calm & level & loaded & ~busy
        self._restless = np.where(calm, self._restless, np.maximum(self._restless, time))
        first = np.isnan(self._settled) & (time - self._restless >= CALM_FOR - 1e-9)
        self._settled = np.where(first, state[3], self._settled)

    def heading(self, state: FloatArray) -> FloatArray:
        """Change of it from the start until the car settled, else to these states."""
        yaw = np.where(np.isnan(self._settled), state[3], self._settled)
        return yaw - self._begun[3]

    def exits(self, length: float) -> dict[str, FloatArray]:
        """What the cars do at their exit: the wheels are straight again and the yaw rate is below
        `EXIT_YAW_RATE`.

        Args:
            length: of a step, s.

        Returns:
            `exit_time` s since the start; `course`, change of it until then, and `sideslip` then,
            heading less course, rad. NaN without an exit.
        """
        (before, state) = self._around
        earlier = self._left - length
        side = np.where(state[14] < 0.0, -1.0, 1.0)
        fall = side * (before[14] - state[14])
        beyond = side * before[14] - EXIT_YAW_RATE
        calm = np.where(fall > 0.0, beyond / np.where(fall == 0.0, 1.0, fall), 0.0)
        straight = (self._straight - earlier) / length
        share = np.clip(np.maximum(calm, straight), 0.0, 1.0)
        then = course(before, self._cars)
        now = course(state, self._cars)
        exit_course = then + share * (now - then)
        heading = before[3] + share * (state[3] - before[3])
        found = {
            "exit_time": earlier + share * length,
            "course": exit_course - course(self._begun, self._cars),
            "sideslip": heading - exit_course,
        }
        return {
            name: np.where(np.isnan(self._left), np.nan, values) for name, values in found.items()
        }


def course(state: FloatArray, cars: Vehicles) -> FloatArray:
    """Of n cars (n), rad, less than half a turn from their heading."""
    return over_ground(state, cars.com_x)[0]


def over_ground(state: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Course (n), rad, and speed (n), m/s, of the places x (n), m, of n cars."""
    yaw, pitch, roll = state[3:6]
    rates = state[RATES]
    ahead, left = velocity_over_ground(rates[V], rates[W], roll, pitch, x)
    speed = np.sqrt(ahead * ahead + left * left + TINY)
    half_angle = np.arctan(left / (speed + ahead + TINY))  # `compiled.run` has no arctan2
    return yaw + 2.0 * half_angle, speed


def heights(state: FloatArray, cars: Vehicles) -> tuple[FloatArray, FloatArray]:
    """Of the lower corner of the sail's tip and of the board over the ground, m; tail far up where
    there is none.
    """
    upright = up_in_body(state)
    x, _, e = tail_axes(state[6], state[7])
    z = state[2]
    distance, width = cars.tip
    corner = np.sum(upright * (cars.mount + distance * e), axis=0)
    slope = np.sqrt(np.sum(upright * x, axis=0) ** 2 + TINY)
    low = z + corner - slope * width - SAIL_TIP_MARGIN
    corners = np.sum(upright[:, None] * cars.board, axis=0)
    board = z + np.min(corners, axis=0)
    return np.where(cars.has_tail > 0.0, low, np.inf), board


@dataclass(frozen=True)
class Turns:
    """What came of n turns.

    Attributes:
        survived: as the outcome of a full run.
        clean: and tail and board stayed off the ground.
        heading: change from the start of the turn until the car has settled (`TurnRecord`), else to
            the end, rad.
        peak_roll: outwards, rad.
        trigger: when the swing began after the start of the turn, s; NaN when it never did.
        lowest_tail, lowest_board: least height over the ground, m.
        course: change from the start of the turn to its exit (`TurnRecord`), rad; `exit_time` s
            since that start and `sideslip` rad there. NaN without an exit.
        last: states at the end (24, n).
        history: every state (steps, 24, n), when asked for; `asked` the torque of the roll motor by
            its own law at the beginning of each of these steps (steps, n), N m; `loads` of the
            wheels in them (steps, 4, n), N.
    """

    survived: np.ndarray
    clean: np.ndarray
    heading: FloatArray
    peak_roll: FloatArray
    trigger: FloatArray
    lowest_tail: FloatArray
    lowest_board: FloatArray
    course: FloatArray
    exit_time: FloatArray
    sideslip: FloatArray
    last: FloatArray
    history: FloatArray | None = None
    asked: FloatArray | None = None
    loads: FloatArray | None = None


class Driven:
    """Cars on the way, a batch of `compiled.run`; times are s since the start of the steering.

    Attributes:
        state: (24, n); `gone`, who has flipped (n); `loads` of the wheels before the last step (4,
            n), N.

    Args:
        cars, plans: n of each.
        state: that they begin with (24, n).
        length: of a step, s.
    """

    def __init__(self, cars: Vehicles, plans: TurnPlans, state: FloatArray, length: float) -> None:
        self._cars = cars
        self._plans = plans
        self._length = length
        self.state = state
        self.gone = np.zeros(cars.count, bool)
        self.loads = np.zeros((4, cars.count))
        self.law = BatchLaw(plans, cars, state[14])
        self.record = TurnRecord(cars, state, plans.straight)

    def tick(self, time: Any) -> None:
        """One tick of the controller."""
        self.law.tick(time, self.state)

    def step(self, time: Any) -> tuple[FloatArray, ...]:
        """Drives one step and returns what `HISTORY` names."""
        cars = self._cars
        plans = self._plans
        before = self.state
        tail = self.law.commands()
        gathered = (time + plans.start) / plans.ramp
        speed = cars.speed * np.where(gathered < 1.0, gathered + plans.lead / plans.ramp, 1.0)
        angles = plans.steering(time + self._length * WITHIN)
        steered = np.sum(angles, axis=0) / len(WITHIN)
        asked = asked_torque(before, tail)
        steering = np.stack([steered, steered])
        shaft_speed = speed / cars.rolling_radius
        new, loads = advance(self._length, cars, before, steering, shaft_speed, tail)
        state = np.where(self.gone, before, new)
        self.state = state
        self.loads = loads
        self.gone = self.gone | (up_in_body(state)[2] < np.cos(FLIP_TILT))
        end = time + self._length
        self.record.see(end, before, state)
        self.record.settle(end, state, loads, self.law.busy)
        return state, asked, loads


def drive_turns(
    cars: Vehicles,
    plans: TurnPlans,
    *,
    duration: float = 2.0,
    length: float = 0.002,
    history: bool = False,
    begun: FloatArray | None = None,
) -> Turns:
    """Drives the turns of n cars, from standstill on: a held sail already drags the car round on a
    slippery straight.

    Args:
        cars, plans: n of each.
        duration: s from the start of the steering; 0 ends with the straight, whose `last` begins
            other turns.
        length: of a step, s.
        history: keep every state, the torques that were asked of the roll motor, and the loads.
        begun: states (24, n) when the steering begins, of cars whose tail still waits; the straight
            is not driven.
    """
    if begun is None:
        state = np.zeros((len(STATES), cars.count))
        state[6] = plans.pitch_angle
        state[7] = -plans.hold_angle
    else:
        state = begun
    ticks = round(1.0 / (length * float(plans.rate[0])))
    begin = round(float(plans.start[0]) / length)
    first = 0 if begun is None else begin
    end = begin + round(duration / length)
    driven = Driven(cars, plans, state, length)
    kept = []
    for part in (np.arange(first, begin), np.arange(begin, end)):
        if part.size:
            # The record of the turn begins with the turn.
            driven.record = TurnRecord(cars, driven.state, plans.straight)
            ticked = (part % ticks == 0) | (part == first)
            kept.append(run(driven, ticked, (part - begin) * length, keep=history))
    state = driven.state
    loads = driven.loads
    record = driven.record
    cosine = np.clip(up_in_body(state)[2], -1.0, 1.0)
    lifted = (loads <= 0.0).any(axis=0)
    leaning = (np.arccos(cosine) > END_TILT) & lifted
    survived = ~(driven.gone | leaning)
    histories = map(np.concatenate, zip(*kept, strict=True))
    return Turns(
        survived=survived,
        clean=survived & (record.lowest_tail > 0.0) & (record.lowest_board > 0.0),
        heading=record.heading(state),
        trigger=driven.law.trigger,
        last=state,
        peak_roll=record.peak_roll,
        lowest_tail=record.lowest_tail,
        lowest_board=record.lowest_board,
        **dict(zip(HISTORY, histories, strict=False)),
        **record.exits(length),
    )


def asked_torque(state: FloatArray, tail: FloatArray) -> FloatArray:
    """Of the roll motor by its own law (n), before its limits, N m; `tail` of `Commands`."""
    target, speed, kp, kd = tail[1]
    return kp * (target - state[7]) + kd * (speed - state[RATES][TAIL_RATE][1])


class BatchLaw:
    """The thesis' law (`workbench.controllers.swing_law`) for many cars in a turn to the left; or
    knots are played.

    Attributes:
        trigger: when each swing began, s; NaN until it does.

    Args:
        plans, cars: n of them.
        yaw_rate: that is seen until the first one comes (n), rad/s.
    """

    def __init__(self, plans: TurnPlans, cars: Vehicles, yaw_rate: FloatArray) -> None:
        n = cars.count
        self._plans = plans
        self._has_tail = cars.has_tail
        self._state = np.full(n, float(SwingState.HOLD))
        self._since = np.zeros(n)
        self._start = np.zeros(n)
        self._seen = np.tile(yaw_rate, (1 + int(np.max(plans.late)), 1))
        self._commands = np.zeros((2, 4, n))
        self.trigger = np.full(n, np.nan)

    @property
    def busy(self) -> np.ndarray:
        """Whose tail swings or is about to (n)."""
        return (self._state == SwingState.DELAY) | (self._state == SwingState.SWING)

    def tick(self, time: Any, state: FloatArray) -> None:
        """One tick of the controller."""
        p = self._plans
        angle = state[7]
        self._seen = np.concatenate([self._seen[1:], state[14][None]])
        before = self._state
        elapsed = time - self._since + 1e-9
        released = (before == SwingState.HOLD) & (p.swings > 0.0)
        # A controller sees what the driver gave a tick ago.
        steered = p.commanded(time - 1.0 / p.rate)
        turning = self._seen[0] > p.trigger_yaw_rate
        released = released & (turning | (steered > p.trigger_steering))
        self._enter(released, SwingState.DELAY, time, angle)
        elapsed = np.where(released, 1e-9, elapsed)
        begins = (self._state == SwingState.DELAY) & (elapsed >= p.delay)
        self._enter(begins, SwingState.SWING, time, angle)
        self.trigger = np.where(begins, time, self.trigger)
        travelled = angle - self._start
        stalled = elapsed >= p.stall_factor * p.travel / p.swing_speed
        over = (travelled >= p.travel) | stalled
        over = np.where(p.played.plays > 0.0, elapsed >= p.played.time[-1], over)
        self._enter((before == SwingState.SWING) & over, SwingState.SETTLE, time, angle)
        self._commands = self._commanded(time)

    def _enter(self, who: np.ndarray, number: SwingState, time: Any, angle: FloatArray) -> None:
        self._state = np.where(who, int(number), self._state)
        self._since = np.where(who, time, self._since)
        self._start = np.where(who, angle, self._start)

    def commands(self) -> FloatArray:
        """To pitch and roll motor (2, 4, n) since the last tick; no gains without a tail."""
        return self._commands

    def _commanded(self, time: Any) -> FloatArray:
        p = self._plans
        zero = np.zeros_like(self._since)
        hold = np.stack([-p.hold_angle, zero, p.hold_kp, p.hold_kd])
        swing = np.stack([zero, p.swing_speed, p.swing_kp, p.swing_kd])
        settle = np.stack([p.hold_angle, zero, p.settle_kp, p.settle_kd])
        pitch = np.stack([p.pitch_angle, zero, p.hold_kp, p.hold_kd])
        swings = self._state == SwingState.SWING
        settles = self._state == SwingState.SETTLE
        roll = np.where(swings, swing, np.where(settles, settle, hold))
        played = p.played
        playing = (swings | settles) & (played.plays > 0.0)
        knot = played.at(time - self.trigger + 0.5 / p.rate)
        followed = np.stack([*knot, played.kp, played.kd])
        gains = np.stack([p.pitch_angle, zero, played.pitch_kp, played.pitch_kd])
        pitch = np.where(playing, gains, pitch)
        roll = np.where(playing, followed, roll)
        one = 1.0 + zero
        return np.stack([pitch, roll]) * np.stack([one, one, self._has_tail, self._has_tail])
