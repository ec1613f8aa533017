"""Motion of the chassis alone, for sensors that would otherwise ask the plant for that of every body."""

from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialAcceleration, SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from aerodima.workbench.aero.sail_motion import rotation_rows
from aerodima.workbench.systems.autodiff_system import declare_abstract_output


class ChassisMotion(LeafSystem):
    """Pose, velocity and acceleration of the chassis, on ports of the plant's names with lists of one.

    The plant's own lists cost about 25 us each to read, since every body becomes a Python object.

    Input ports:
        chassis (13): quaternion, position m, angular velocity rad/s, velocity m/s, in W.
        before (6): angular velocity and velocity before the plant's last step.
        stepped (1): 0 before the first step of a run: then there is no acceleration yet.
    Output ports:
        body_poses, body_spatial_velocities: as the plant's.
        body_spatial_accelerations: of the last step.

    Args:
        step: of the plant, s.
    """

    def __init__(self, step: float) -> None:
        super().__init__()
        self.set_name("chassis_motion")
        self._step = step
        sizes = {"chassis": 13, "before": 6, "stepped": 1}
        self._chassis, self._before, self._stepped = (
            self.DeclareVectorInputPort(name, size) for name, size in sizes.items()
        )
        inputs = {self.all_input_ports_ticket()}
        for name, make, calc in (
            ("body_poses", Value[list[RigidTransform]], self._calc_pose),
            ("body_spatial_velocities", Value[list[SpatialVelocity]], self._calc_velocity),
            ("body_spatial_accelerations", Value[list[SpatialAcceleration]], self._calc_acceleration),
        ):
            declare_abstract_output(self, name, make, calc, inputs)

    def _calc_pose(self, context: Context, output: Any) -> None:
        chassis: Any = self._chassis.Eval(context)
        R_WB = RotationMatrix(np.array(rotation_rows(chassis[:4].tolist())))
        output.set_value([RigidTransform(R_WB, chassis[4:7])])

    def _calc_velocity(self, context: Context, output: Any) -> None:
        chassis: Any = self._chassis.Eval(context)
        output.set_value([SpatialVelocity(chassis[7:10], chassis[10:])])

    def _calc_acceleration(self, context: Context, output: Any) -> None:
        chassis: Any = self._chassis.Eval(context)
        before: Any = self._before.Eval(context)
        stepped: Any = self._stepped.Eval(context)
        change = stepped[0] * (chassis[7:] - before) / self._step
        output.set_value([SpatialAcceleration(change[:3], change[3:])])
