"""Turns of many reduced cars at once, each with its own floor, steering and swing; what screening asks of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from aerodima.optimisation.screening.turn_record import TurnRecord
from aerodima.optimisation.screening.vehicle_motion import STATES, Commands, equations, step, up
from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.swing_law import SwingSettings, SwingState
from aerodima.workbench.errors import UserError
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.metrics.turn_metrics import END_TILT

RECORDED = ("peak_roll", "lowest_tail", "lowest_board", "course", "exit_time", "sideslip")
"""Of `TurnRecord`, in `Turns`."""
COMMON = {"start": "manoeuvre.turn_start, s", "rate": "controller.rate, Hz", "late": "imu.delay, ticks"}
"""Of `TurnPlans`: the same for all turns that are driven at once, with the words of a complaint."""


@dataclass(frozen=True)
class TurnPlans:
    """What n cars do in their turn; the last axis of every field is the car.

    Attributes:
        ramp, start: the car gathers speed for so long and goes straight until then, s.
        steer_angle: rad; `hold` s, length of the steering step; `steer_rate` of the servo, rad/s.
        rate: of the controller, Hz; `late` how many of its ticks a yaw rate is old.
        swings: 1 where the tail swings; all others as `SwingSettings`, rad, s, rad/s, N m/rad, N m s/rad.
    """

    ramp: FloatArray
    start: FloatArray
    steer_angle: FloatArray
    hold: FloatArray
    steer_rate: FloatArray
    rate: FloatArray
    late: FloatArray
    swings: FloatArray
    trigger_yaw_rate: FloatArray
    delay: FloatArray
    hold_angle: FloatArray
    hold_kp: FloatArray
    hold_kd: FloatArray
    pitch_angle: FloatArray
    swing_speed: FloatArray
    swing_kp: FloatArray
    swing_kd: FloatArray
    travel: FloatArray
    stall_factor: FloatArray
    settle_kp: FloatArray
    settle_kd: FloatArray

    @classmethod
    def of(cls, scenarios: Sequence[Scenario]) -> TurnPlans:
        """The plans of scenarios whose tail follows the thesis' law or is held.

        Raises:
            UserError: a swing file, steering of two levels, or scenarios that differ in `COMMON`.
        """
        rows = []
        for scenario in scenarios:
            if scenario.tail.mode == "swing" and scenario.controller.swing_file != "none":
                raise UserError(
                    f"controller.swing_file: {scenario.controller.swing_file}; the screening model knows: none"
                )
            if scenario.manoeuvre.first_hold > 0.0:
                raise UserError(
                    f"manoeuvre.first_hold: {scenario.manoeuvre.first_hold:g} s; the screening model knows: 0 s"
                )
            if scenario.tail.mode == "swing" and scenario.controller.trigger != "yaw_rate":
                raise UserError(
                    f"controller.trigger: {scenario.controller.trigger}; the screening model knows: yaw_rate"
                )
            settings, turn, imu = SwingSettings.from_scenario(scenario), scenario.manoeuvre, scenario.imu
            own = {
                "ramp": turn.speed_ramp,
                "start": turn.turn_start,
                "steer_angle": turn.steer_angle,
                "hold": turn.turn_hold,
                "steer_rate": scenario.servo.rate,
                "late": np.ceil(imu.delay * settings.rate - 1e-9),
                "swings": float(settings.mode == "swing"),
            }
            rows.append([own[f.name] if f.name in own else getattr(settings, f.name) for f in fields(cls)])
        plans = cls(*np.array(rows, float).T)
        for name, words in COMMON.items():
            if len(found := np.unique(getattr(plans, name))) > 1:
                raise UserError(f"{words}: {found[0]:g} and {found[-1]:g}; turns that are driven at once have one")
        return plans

    def take(self, places: Any) -> TurnPlans:
        """Plans at these places, again and again if asked."""
        return TurnPlans(*(getattr(self, field.name)[..., places] for field in fields(self)))


@dataclass(frozen=True)
class Turns:
    """What came of n turns.

    Attributes:
        survived: as the outcome of a full run.
        clean: and tail and board stayed off the ground.
        heading: change from the start of the turn to the end, rad.
        peak_roll: outwards, rad.
        trigger: when the swing began after the start of the turn, s; NaN when it never did.
        lowest_tail, lowest_board: least height over the ground, m.
        speed: at the end, m/s.
        course: change from the start of the turn to its exit (`TurnRecord`), rad; `exit_time` s since that start and
            `sideslip` rad there. NaN without an exit.
        last: states at the end (24, n).
        history: every state (steps, 24, n), when asked for.
    """

    survived: np.ndarray
    clean: np.ndarray
    heading: FloatArray
    peak_roll: FloatArray
    trigger: FloatArray
    lowest_tail: FloatArray
    lowest_board: FloatArray
    speed: FloatArray
    course: FloatArray
    exit_time: FloatArray
    sideslip: FloatArray
    last: FloatArray
    history: FloatArray | None = None


def drive_turns(
    cars: Vehicles,
    plans: TurnPlans,
    *,
    duration: float = 2.0,
    length: float = 0.002,
    history: bool = False,
    begun: FloatArray | None = None,
) -> Turns:
    """Drives the turns of n cars, from standstill on: a held sail already drags the car round on a slippery straight.

    Args:
        cars, plans: n of each.
        duration: s from the start of the steering; 0 ends with the straight, whose `last` begins other turns.
        length: of a step, s.
        history: keep every state (steps, 24, n).
        begun: states (24, n) when the steering begins, of cars whose tail still waits; the straight is not driven.
    """
    n, law = cars.count, BatchLaw(plans, cars)
    state = np.zeros((len(STATES), n))
    state[6], state[7] = plans.pitch_angle, -plans.hold_angle
    ticks = round(1.0 / (length * float(plans.rate[0])))
    begin = round(float(plans.start[0]) / length)
    state, first = (state, 0) if begun is None else (begun, begin)
    gone, loads, kept, record = np.zeros(n, bool), np.zeros((4, n)), [], TurnRecord(cars, state)
    for index in range(first, begin + round(duration / length)):
        time = (index - begin) * length
        if index % ticks == 0:
            law.tick(time, state)
        if index == begin:
            record = TurnRecord(cars, state)
        speed = cars.speed * np.minimum(1.0, (time + plans.start) / plans.ramp)
        commands = Commands(_steering(time, plans), speed / cars.rolling_radius, law.commands())
        found = equations(state, commands, cars)
        state, loads = np.where(gone, state, step(state, found, length)), found.loads
        gone |= up(state[4], state[5])[2] < np.cos(FLIP_TILT)
        if index >= begin:
            now = time + length
            record.see(now, state, (now > plans.hold) & (_steering(now, plans)[0] <= 0.0))
        if history:
            kept.append(state)
    leaning = (np.arccos(np.clip(up(state[4], state[5])[2], -1.0, 1.0)) > END_TILT) & (loads <= 0.0).any(axis=0)
    survived = ~(gone | leaning)
    return Turns(
        survived=survived,
        clean=survived & (record.lowest_tail > 0.0) & (record.lowest_board > 0.0),
        heading=record.heading(state),
        trigger=law.trigger,
        speed=np.hypot(state[15], state[16]),
        last=state,
        history=np.array(kept) if history else None,
        **{name: getattr(record, name) for name in RECORDED},
    )


def _steering(time: float, plans: TurnPlans) -> FloatArray:
    angle = np.clip(plans.steer_rate * time, 0.0, plans.steer_angle)
    angle = np.clip(angle - np.maximum(0.0, plans.steer_rate * (time - plans.hold)), 0.0, None)
    return np.stack([angle, angle])


class BatchLaw:
    """The thesis' law (`workbench.controllers.swing_law`) for many cars in a turn to the left."""

    def __init__(self, plans: TurnPlans, cars: Vehicles) -> None:
        n = cars.count
        self._plans, self._has_tail = plans, cars.has_tail
        self._state, self._since, self._start = np.full(n, int(SwingState.HOLD)), np.zeros(n), np.zeros(n)
        self._seen: list[FloatArray] = []
        self.trigger = np.full(n, np.nan)
        self._late = int(np.max(plans.late))

    def tick(self, time: float, state: FloatArray) -> None:
        """One tick of the controller."""
        p, angle = self._plans, state[7]
        yaw_rate = state[14]
        self._seen.append(yaw_rate)
        seen = self._seen[max(0, len(self._seen) - 1 - self._late)]
        before, elapsed = self._state.copy(), time - self._since + 1e-9
        released = (before == SwingState.HOLD) & (p.swings > 0.0) & (seen > p.trigger_yaw_rate)
        self._enter(released, SwingState.DELAY, time, angle)
        elapsed = np.where(released, 1e-9, elapsed)
        begins = (self._state == SwingState.DELAY) & (elapsed >= p.delay)
        self._enter(begins, SwingState.SWING, time, angle)
        self.trigger = np.where(begins, time, self.trigger)
        travelled = angle - self._start
        over = (travelled >= p.travel) | (elapsed >= p.stall_factor * p.travel / p.swing_speed)
        self._enter((before == SwingState.SWING) & over, SwingState.SETTLE, time, angle)

    def _enter(self, who: np.ndarray, number: SwingState, time: float, angle: FloatArray) -> None:
        self._state = np.where(who, int(number), self._state)
        self._since = np.where(who, time, self._since)
        self._start = np.where(who, angle, self._start)

    def commands(self) -> FloatArray:
        """To pitch and roll motor (2, 4, n); no gains without a tail."""
        p, zero = self._plans, np.zeros_like(self._since)
        hold = np.stack([-p.hold_angle, zero, p.hold_kp, p.hold_kd])
        swing = np.stack([zero, p.swing_speed, p.swing_kp, p.swing_kd])
        settle = np.stack([p.hold_angle, zero, p.settle_kp, p.settle_kd])
        roll = np.where(
            self._state == SwingState.SWING, swing, np.where(self._state == SwingState.SETTLE, settle, hold)
        )
        pitch = np.stack([p.pitch_angle, zero, p.hold_kp, p.hold_kd])
        return np.stack([pitch, roll]) * np.stack([1.0 + zero, 1.0 + zero, self._has_tail, self._has_tail])
