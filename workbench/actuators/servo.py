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

    30 degrees take 0.14 s (thesis 7.1.1). The command is clipped to the servo's limit; NaN holds the last angle.

    Input ports:
        steering_angle (1): commanded bicycle steering angle, rad, positive to the left.
    Output ports:
        knuckle_state (4): left and right knuckle angle rad, then their rates rad/s, as the linkage demands them.
    """

    def __init__(self, servo: ServoParameters, car: CarParameters, step: float):
        super().__init__()
        self._servo, self._car, self._step = servo, car, step
        self._command = self.DeclareVectorInputPort("steering_angle", 1)
        self._state = DiscreteVector(self, [0.0, 0.0])
        self.DeclarePeriodicDiscreteUpdateEvent(step, 0.0, self._update)
        self.DeclareVectorOutputPort(
            "knuckle_state", 4, self._calc_knuckles, prerequisites_of_calc={self._state.ticket}
        )

    def _update(self, context: Context, next_state: DiscreteValues) -> None:
        commanded: Any = self._command.Eval(context)
        command = float(commanded[0])
        angle, _ = self._state.read(context)
        target = angle if math.isnan(command) else min(max(command, -self._servo.limit), self._servo.limit)
        most = self._servo.rate * self._step
        change = min(max(target - angle, -most), most)
        self._state.write(next_state, [angle + change, change / self._step])

    def _calc_knuckles(self, context: Context, output: BasicVector) -> None:
        angle, rate = self._state.read(context)
        left, right = ackermann(angle, self._car.wheelbase, self._car.track)
        slope = 1.0 + math.tan(angle) ** 2
        half = 0.5 * self._car.track / self._car.wheelbase
        rates = []
        for side in (-half, half):
            lever = 1.0 + side * math.tan(angle)
            rates.append(rate * slope / (lever**2 + math.tan(angle) ** 2))
        output.SetFromVector(np.array([left, right, *rates]))
