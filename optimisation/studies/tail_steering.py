"""A running robot that turns by swinging an inertial tail, on level ground: TAYLRoACH (`models/other_tails`).

Feet push the body along its heading at the running speed and resist sliding sideways; about the vertical they do
nothing, as on a slippery floor, so that the tail alone turns the body.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PlanarJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import LogVectorOutput
from scipy.integrate import trapezoid

from aerodima.optimisation.studies.tailed_body import ACCURACY, Swing, drive_hinge

_TAIL_MASS = 1e-3
_SAMPLES = 400


@dataclass(frozen=True)
class SteeredTurn:
    """One turn by a tail.

    Attributes:
        turned: change of the heading, rad.
        radius_in_lengths: way over change of the heading, in lengths of the body.
        kohut: mean of speed times yaw rate over the turn, deg m/s2 (thesis eq. 3.2).
        speed_change_percent: of the speed over ground, from the beginning to the end of the turn.
    """

    turned: float
    radius_in_lengths: float
    kohut: float
    speed_change_percent: float


class Feet(LeafSystem):
    """Force of the feet on a body that runs along its heading.

    Input ports:
        plant_state (8): x, y, heading, tail angle, and their rates; m, rad.
    Output ports:
        generalized_force (4): N in the world's x and y; nothing about the vertical and on the tail.

    Args:
        speed: of running, m/s.
        damping: force per speed that differs from running straight on, N s/m.
    """

    def __init__(self, speed: float, damping: float):
        super().__init__()
        self._speed, self._damping = speed, damping
        self._state = self.DeclareVectorInputPort("plant_state", 8)
        self.DeclareVectorOutputPort("generalized_force", 4, self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state: Any = self._state.Eval(context)
        _, _, heading, _, v_x, v_y, _, _ = state
        wanted = self._speed * np.array([math.cos(heading), math.sin(heading)])
        output.SetFromVector(np.array([*(self._damping * (wanted - [v_x, v_y])), 0.0, 0.0]))


def steer_by_tail(values: Mapping[str, float]) -> SteeredTurn:
    """Runs straight, swings the tail so that the body turns by the wanted angle at the wanted mean rate.

    Args:
        values: of `models/other_tails/taylroach.yaml`.
    """
    turn, rate = math.radians(values["turn"]), math.radians(values["yaw_rate"])
    speed, ratio = values["speed"] * values["length"], values["tail_inertia"]
    swing = Swing(0.0, -turn * (1.0 + ratio) / ratio, turn / rate)
    builder = DiagramBuilder()
    plant, hinge = _runner(builder, values)
    drive_hinge(builder, plant, hinge, swing)
    feet = builder.AddSystem(Feet(speed, values["foot_damping"]))
    builder.Connect(plant.get_state_output_port(), feet.get_input_port())
    builder.Connect(feet.get_output_port(), plant.get_applied_generalized_force_input_port())
    log = LogVectorOutput(plant.get_state_output_port(), builder, swing.duration / _SAMPLES)
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_target_accuracy(ACCURACY)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetVelocities(context, np.array([speed, 0.0, 0.0, 0.0]))
    simulator.AdvanceTo(swing.duration)
    found = log.FindLog(simulator.get_context())
    time, (_, _, heading, _, v_x, v_y, yaw_rate, _) = found.sample_times(), found.data()
    over_ground = np.hypot(v_x, v_y)
    turned, way = float(heading[-1]), float(trapezoid(over_ground, time))
    return SteeredTurn(
        turned,
        way / abs(turned) / values["length"],
        float(trapezoid(np.degrees(yaw_rate) * over_ground, time) / time[-1]),
        100.0 * float(over_ground[-1] / over_ground[0] - 1.0),
    )


def _runner(builder: DiagramBuilder, values: Mapping[str, float]) -> tuple[MultibodyPlant, RevoluteJoint]:
    """A box that slides and turns on a level floor, with a balanced tail on a vertical hinge in its middle."""
    plant = MultibodyPlant(0.0)
    builder.AddSystem(plant)
    box = SpatialInertia.SolidBoxWithMass(values["mass"], values["length"], values["width"], values["width"])
    body = plant.AddRigidBody("body", box)
    moment = values["tail_inertia"] * float(box.CalcRotationalInertia().get_moments()[2])
    rod = UnitInertia.ThinRod(math.sqrt(12.0 * moment / _TAIL_MASS), np.array([1.0, 0.0, 0.0]))
    tail = plant.AddRigidBody("tail", SpatialInertia(_TAIL_MASS, np.zeros(3), rod))
    plant.AddJoint(PlanarJoint("floor", plant.world_frame(), body.body_frame(), np.zeros(3)))
    axis = np.array([0.0, 0.0, 1.0])
    hinge: Any = plant.AddJoint(RevoluteJoint("tail", body.body_frame(), tail.body_frame(), axis))
    plant.AddJointActuator("tail", hinge)
    plant.Finalize()
    return plant, hinge
