"""Swerves of many reduced cars that begin rolling: levels of steering, each car with its own, and
the tail by knots or by the feedback law.

Wheels turn at the exact times of the levels and not at ticks, so that the result of a swerve
changes smoothly with these times; the controller sees the steering one tick late, as on the full
car. The law sees the IMU late, but without noise and bias, and the speed without delay.
"""

from typing import Any

import numpy as np

from aerodima.workbench.car.laws import pd_torque, torque_bounds
from aerodima.workbench.car.reduced.compiled.steps import run
from aerodima.workbench.car.reduced.ground_terms import wheel_lifts
from aerodima.workbench.car.reduced.parameters import VehicleParams
from aerodima.workbench.car.reduced.rollout import (
    STEP,
    Rollout,
    delay_ticks,
    heights,
    over_ground,
    tick_flags,
)
from aerodima.workbench.car.reduced.states import RATES, SPIN, STATES, TAIL_RATE, V, W
from aerodima.workbench.car.swerve import Swerve
from aerodima.workbench.control.feedback_law import OVER, FeedbackSignals, LawMemory, respond
from aerodima.workbench.control.manoeuvre import TICK_TOLERANCE, level_angle, slewed_angle
from aerodima.workbench.control.rollover_control import RolloverMemory, limit_by_roll, max_angle
from aerodima.workbench.control.swing_player import RollTrajectory
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.scenario import Scenario

LEAD = 0.1
"""Time that is driven straight before the steering, s."""
WITHIN = (np.arange(4.0)[:, None] + 0.5) / 4.0
"""Instants of a step, as shares of its length, over which the angle of the wheels is averaged."""
LEVELS = 3
"""Number of levels of steering; in an array of steering all ends but the last follow them."""
STEERING = 2 * LEVELS - 1
"""Length of an array of steering: angles, rad, then the ends of all but the last, s. The array of a
car whose tail waits at a side is longer by one: the trim, an angle that keeps the car straight
until the steering starts, rad."""


class SwerveRollout(Rollout):
    """Cars that begin rolling and swerve to the left; a step is given its time since the start of
    the steering, s.

    Args:
        cars: parameters of the n cars, with their speeds.
        scenario: scenario whose servo, controller, IMU, wheelbase and end of the last level apply
            to every car.
        steering: steering of each car (`STEERING`, n), or one row longer, with a trim in place of
            that of the scenario. With a trim the whole straight of the scenario is driven, else
            `LEAD` of it.
        pitch, roll: angles at which the tails wait (n), rad.

    Attributes:
        lead: time that is driven straight before the steering, s.
    """

    def __init__(
        self,
        cars: VehicleParams,
        scenario: Scenario,
        steering: FloatArray,
        pitch: FloatArray,
        roll: FloatArray,
    ) -> None:
        n = cars.count
        state = np.zeros((len(STATES), n))
        state[6] = pitch
        state[7] = roll
        rates = state[RATES]
        rates[V][0] = cars.speed
        rates[SPIN] = cars.speed / cars.rolling_radius
        super().__init__(cars, state, delay_ticks(scenario), STEP)
        plan = scenario.manoeuvre
        last = np.full((1, n), plan.turn_hold)
        self._levels = steering[:LEVELS]
        self._ends = np.concatenate([steering[LEVELS:STEERING], last])
        self._first = 0.0  # start of the first angle
        self.lead = LEAD
        trim = steering[STEERING:]
        if plan.trim_angle and not len(trim):
            trim = np.full((1, n), plan.trim_angle)
        if len(trim):
            self.lead = plan.turn_start
            self._first = -self.lead
            self._levels = np.concatenate([trim, self._levels])
            self._ends = self.lead + np.concatenate([np.zeros((1, n)), self._ends])
        self._servo_rate = scenario.servo.rate * np.ones(n)
        self._rate = scenario.controller.rate

    def _commanded(self, since: Any) -> Any:
        """Returns the steering command at a time since the start of the steering (n), rad."""
        return level_angle([*self._levels], [*self._ends], since - self._first)

    def _seen_steering(self, time: Any) -> Any:
        """Returns the steering that a controller sees (n), rad: that of the tick before."""
        return self._commanded(time - 1.0 / self._rate + TICK_TOLERANCE)

    def _wheels(self, time: Any) -> Any:
        """Returns the mean angle of the wheels in a step (n), rad."""
        within = time - self._first + STEP * WITHIN
        angles = slewed_angle([*self._levels], [*self._ends], self._servo_rate, within)
        return np.sum(angles, axis=0) / len(WITHIN)

    def step(self, time: Any) -> tuple[FloatArray, ...]:
        """Drives one step and returns the values of it that `Swerve` holds."""
        cars = self._cars
        steering = self._wheels(time)
        self._drive(steering, cars.speed / cars.rolling_radius)
        state = self.state
        course, speed = over_ground(state, cars.com_x)
        joints = state[6:8]
        rates = state[RATES][TAIL_RATE]
        target, target_rate, kp, kd = np.swapaxes(self._tail, 0, 1)
        scale = cars.torque_scale
        asked = pd_torque(joints, rates, target, target_rate, scale * kp, scale * kd)
        low, high = torque_bounds(rates, cars.torque_limit, cars.stall_torque, cars.no_load_speed)
        torques = np.clip(asked, low, high)
        commanded = self._commanded(time + STEP) + 0.0 * speed
        body = [state[0], state[1], state[3], course, speed, state[RATES][W][2], state[5]]
        lag = cars.has_tail * (state[7] - self._tail[1, 0])
        body += [commanded, lag, np.sum(torques * rates, axis=0)]
        lifts = wheel_lifts(state, cars, steering)
        return np.stack(body), lifts, np.stack(heights(state, cars)), joints, torques


class PlayedSwerve(SwerveRollout):
    """Cars whose tails follow knots from the tick on at which the controller sees the steering.

    Args:
        cars, scenario, steering: as for `SwerveRollout`.
        pitch: pitch of the tails (n), rad.
        knots: knots of the roll of the tails.
    """

    def __init__(
        self,
        cars: VehicleParams,
        scenario: Scenario,
        steering: FloatArray,
        pitch: FloatArray,
        knots: RollTrajectory,
    ) -> None:
        super().__init__(cars, scenario, steering, pitch, knots.roll[0])
        self._knots = knots
        self._pitch = np.stack([pitch, 0.0 * pitch, knots.pitch_kp, knots.pitch_kd])

    def tick(self, time: Any) -> None:
        """Commands the tail until the next tick."""
        released = time - 1.0 / self._rate
        self._command(self._pitch, np.stack(self._knots.command(released, self._rate)))


class FeedbackSwerve(SwerveRollout):
    """Cars with the feedback law.

    Args:
        cars, scenario, steering: as for `SwerveRollout`; the scenario also gives the gains that
            hold the pitch.
        gains: fields of `FeedbackParameters` as arrays (n).
    """

    def __init__(
        self, cars: VehicleParams, scenario: Scenario, steering: FloatArray, gains: Any
    ) -> None:
        n = cars.count
        super().__init__(cars, scenario, steering, gains.pitch_angle, np.zeros(n))
        kp, kd = np.outer(scenario.controller.hold_gains, np.ones(n))
        self._gains = gains
        self._wheelbase = scenario.car.wheelbase * np.ones(n)
        self._pitch = np.stack([gains.pitch_angle, 0.0 * kp, kp, kd])
        still = np.zeros(n)
        self._memory = np.stack([still, still, still + OVER, still, still])

    def tick(self, time: Any) -> None:
        """Asks the law once."""
        gains = self._gains
        speed = self.state[RATES][V][0]
        roll, roll_rate, yaw_rate = self._measure()
        seen = FeedbackSignals(roll, roll_rate, yaw_rate, speed, self._seen_steering(time), True)
        memory = LawMemory(*self._memory)
        self._memory = np.stack(respond(gains, self._wheelbase, self._rate, memory, seen))
        reference = self._memory[0]
        self._command(self._pitch, np.stack([reference, 0.0 * reference, gains.kp, gains.kd]))


class LimitedSwerve(FeedbackSwerve):
    """Cars with the feedback law, or without tail, whose rollover control limits the steering; the
    wheels follow the levels from tick to tick.

    Args:
        cars, scenario, steering, gains: as for `FeedbackSwerve`.
        control: fields of `RolloverControlParameters` as arrays (n).
    """

    def __init__(
        self,
        cars: VehicleParams,
        scenario: Scenario,
        steering: FloatArray,
        gains: Any,
        control: Any,
    ) -> None:
        super().__init__(cars, scenario, steering, gains)
        straight = np.zeros(cars.count)
        self._control = control
        self._max_angle = max_angle(self._wheelbase, control.acceleration, cars.speed)
        self._limited = np.stack([1.0 + straight, straight])
        self._asked = straight
        self._angle = straight

    def tick(self, time: Any) -> None:
        """Asks the law, then the control."""
        super().tick(time)
        driver = super()._commanded(time + TICK_TOLERANCE)
        asked = np.clip(driver, -self._max_angle, self._max_angle)
        roll, roll_rate, _ = self._imu[0]
        memory = RolloverMemory(*self._limited)
        limited = limit_by_roll(self._control, self._rate, memory, asked, roll, roll_rate)
        self._limited = np.stack(limited)
        self._asked = limited.share * asked

    def _commanded(self, since: Any) -> Any:
        return self._asked

    def _wheels(self, time: Any) -> Any:
        before = self._angle
        step = STEP * self._servo_rate
        self._angle = before + np.clip(self._asked - before, -step, step)
        return 0.5 * (before + self._angle)


def drive_swerves(rollout: SwerveRollout, scenario: Scenario) -> Swerve:
    """Drives the cars of a rollout to the end of the run of a scenario."""
    cars = rollout._cars
    plan = scenario.manoeuvre
    lead = rollout.lead
    index = np.arange(round((lead + plan.duration - plan.turn_start) / STEP))
    time = np.asarray(index * STEP - lead, dtype=np.float64)
    ticked = tick_flags(index, scenario.controller.rate, STEP)
    body, lifts, above, joints, torques = run(rollout, ticked, time, keep=True)
    x, y, heading, course, speed, yaw_rate, roll, steering, lag, power = np.moveaxis(body, 1, 0)
    return Swerve(
        time=np.asarray(time + STEP, dtype=np.float64),
        x=x,
        y=y,
        heading=heading,
        course=course,
        speed=speed,
        yaw_rate=yaw_rate,
        roll=roll,
        steering=steering,
        lifts=lifts,
        heights=above,
        tail=joints,
        lag=lag,
        torques=torques,
        power=power,
        flipped=rollout.gone,
        com_x=cars.com_x,
        outline=cars.outline,
    )
