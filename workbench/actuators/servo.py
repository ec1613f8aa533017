"""Steering servo and linkage (design section 6)."""

import math
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from workbench.discrete_vector import DiscreteVector
from workbench.parameters import CarParameters, ServoParameters


def ackermann(steering_angle: float, wheelbase: float, track: float) -> tuple[float, float]:
    """Angles (rad) of the left and right front wheel, positive to the left, that roll about one centre of turn.

    `steering_angle` is that of the wheel in the middle of the kinematic bicycle.
    """
    tangent = math.tan(steering_angle)
    half = 0.5 * track / wheelbase * tangent
    return math.atan2(tangent, 1.0 - half), math.atan2(tangent, 1.0 + half)


class SteeringServo(LeafSystem):
    """Rate-limited servo that drives both front knuckles through an Ackermann linkage.

    30 degrees take 0.14 s (thesis 7.1.1). The servo reads its command once per frame and moves towards it at its rate;
    in between, the angle is that of the moving linkage at every instant. The command is clipped to the servo's limit;
    NaN holds the last angle.

    Input ports:
        steering_angle (1): commanded bicycle steering angle, rad, positive to the left.
    Output ports:
        knuckle_state (4): left and right knuckle angle rad, then their rates rad/s, as the linkage demands them.

    Args:
        servo: rate, limit, frame rate.
        car: wheelbase and track.
        offset: when the first frame is read, s; in a diagram one step of the plant, so that a command that a
            controller gives at the same instant is seen in that frame and not in the next one.
    """

    def __init__(self, servo: ServoParameters, car: CarParameters, offset: float = 0.0):
        super().__init__()
        self._servo, self._car = servo, car
        self._command = self.DeclareVectorInputPort("steering_angle", 1)
        self._frame = DiscreteVector(self, [0.0, 0.0, 0.0])
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / servo.frame_rate, offset, self._read_frame)
        self.DeclareVectorOutputPort(
            "knuckle_state", 4, self._calc_knuckles, prerequisites_of_calc={self.time_ticket(), self._frame.ticket}
        )

    def _read_frame(self, context: Context, next_state: DiscreteValues) -> None:
        commanded: Any = self._command.Eval(context)
        command = float(commanded[0])
        angle, _ = self._motion(context)
        target = angle if math.isnan(command) else min(max(command, -self._servo.limit), self._servo.limit)
        self._frame.write(next_state, [context.get_time(), angle, target])

    def _motion(self, context: Context) -> tuple[float, float]:
        """Bicycle steering angle, rad, and its rate, rad/s, at this instant."""
        begin, start, target = self._frame.read(context).tolist()
        travel = self._servo.rate * (context.get_time() - begin)
        if abs(target - start) <= travel:
            return target, 0.0
        side = 1.0 if target > start else -1.0
        return start + side * travel, side * self._servo.rate

    def _calc_knuckles(self, context: Context, output: BasicVector) -> None:
        angle, rate = self._motion(context)
        left, right = ackermann(angle, self._car.wheelbase, self._car.track)
        tangent = math.tan(angle)
        half = 0.5 * self._car.track / self._car.wheelbase
        turning = rate * (1.0 + tangent**2)
        rates = [turning / (lever**2 + tangent**2) for lever in (1.0 - half * tangent, 1.0 + half * tangent)]
        output.SetFromVector(np.array([left, right, *rates]))
