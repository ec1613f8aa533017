"""The tail arm: signs of its joints, its inertia, and its answer to a step against the closed
form.
"""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from aerodima.workbench.aero.added_mass import add_added_mass
from aerodima.workbench.car.ak70 import TAIL_JOINTS, TailMotor
from aerodima.workbench.car.car_plant import parse_model
from aerodima.workbench.car.laws import joint_friction
from aerodima.workbench.car.tail_plant import (
    added_mass_layout,
    arm_inertia,
    ground_partner_friction,
    inertia_about_joints,
    tail_sdf,
)
from aerodima.workbench.scenario.scenario import scenario_from_dict
from tests.certain_cars import HEAVY_TAIL

FRICTIONLESS = {"friction": {"coulomb": 0.0, "viscous": 0.0}}
OFF = [0.0] * 5
HELD = [0.0, 0.0, 17.0, 5.0, 0.0]
"""Command of a joint that stays in the middle."""
STIFF = [0.0, 0.0, 50.0, 5.0, 0.0]


class ArmDrive(LeafSystem):
    """Motors and friction of an arm alone; what acts in a step is asked for once, when the step
    begins.
    """

    def __init__(self, scenario, plant, arm, commands):
        super().__init__()
        self.motors = [TailMotor(scenario, joint) for joint in TAIL_JOINTS]
        self.contexts = [motor.CreateDefaultContext() for motor in self.motors]
        for motor, context, command in zip(self.motors, self.contexts, commands, strict=True):
            motor.GetInputPort("tail_command").FixValue(context, command)
        self.friction = scenario.friction
        self.step = scenario.simulation.step
        self.nq = plant.num_positions()
        joints = [plant.GetJointByName(name, arm) for name in ("tail_pitch", "tail_roll")]
        self.places = [(joint.position_start(), joint.velocity_start()) for joint in joints]
        ports = {
            "state": plant.get_state_output_port(),
            "acceleration": plant.GetOutputPort("generalized_acceleration"),
            "last": plant.get_net_actuation_output_port(arm),
        }
        self.sources = {
            name: (self.DeclareVectorInputPort(name, port.size()), port)
            for name, port in ports.items()
        }
        self.DeclareVectorOutputPort("actuation", 2, self.calc)

    def calc(self, context, output):
        state, acceleration, last = (
            port.Eval(context).tolist() for port, _ in self.sources.values()
        )
        roll = state[self.places[1][0]]
        torques = []
        for index, (q, v) in enumerate(self.places):
            rate = state[self.nq + v]
            before = rate - acceleration[v] * self.step
            motion = [state[q], rate, 1.0, before, last[index], roll]
            motor = self.motors[index]
            context = self.contexts[index]
            motor.GetInputPort("joint_motion").FixValue(context, motion)
            (torque,) = motor.GetOutputPort("torque").Eval(context)
            law = self.friction
            torques.append(torque + joint_friction(rate, law.coulomb, law.viscous, law.tanh_gain))
        output.SetFromVector(torques)

    def wire(self, builder, plant, arm):
        builder.AddSystem(self)
        for target, port in self.sources.values():
            builder.Connect(port, target)
        builder.Connect(self.get_output_port(), plant.get_actuation_input_port(arm))


class ArmOnTheBench:
    """The arm with its motors, welded to the world, without gravity."""

    def __init__(
        self, step=0.002, roll=OFF, angles=(0.0, 0.0), gravity=0.0, pitch=HELD, **overrides
    ):
        self.scenario = scenario_from_dict(
            {"simulation": {"step": step, "log_rate": 100.0}}
            | overrides
            | {"tail": HEAVY_TAIL | overrides.get("tail", {})}
        )
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, step)
        plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -gravity])
        model = tail_sdf(self.scenario.tail, self.scenario.tail_motor, self.scenario.car)
        model.fix_joint("tail_sail_turn")
        arm = parse_model(plant, model)
        tail = self.scenario.tail
        added = add_added_mass(
            plant, plant.GetBodyByName("tail_rod"), added_mass_layout(tail), tail.added_mass
        )
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("tail_anchor"))
        plant.Finalize()
        added.add_to_builder(builder)
        ArmDrive(self.scenario, plant, arm, (pitch, roll)).wire(builder, plant, arm)
        self.simulator = Simulator(builder.Build())
        self.plant = plant
        self.context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        for joint, angle in zip(("tail_pitch", "tail_roll"), angles, strict=True):
            plant.GetJointByName(joint).set_angle(self.context, angle)

    def angle(self, joint):
        return self.plant.GetJointByName(joint).get_angle(self.context)

    def tip(self):
        pose = self.plant.GetBodyByName("tail_rod").EvalPoseInWorld(self.context)
        return pose.multiply(np.array([0.0, 0.0, self.scenario.tail.length]))

    def history(self, joint, times):
        angles = []
        for time in times:
            self.simulator.AdvanceTo(time)
            angles.append(self.angle(joint))
        return np.array(angles)


def second_order(time, start, target, inertia, kp, kd):
    """Closed form of I q'' = kp (target - q) - kd q' from rest at `start`."""
    roots = np.roots([inertia, kd, kp]).astype(complex)
    a, b = roots
    return target + (start - target) * np.real(
        (a * np.exp(b * time) - b * np.exp(a * time)) / (a - b)
    )


def roll_inertia(tail, motor):
    """About the roll axis, from the geometry: uniform rod, box as deep as shell and board,
    reflected rotor.
    """
    sail = tail.mass * tail.sail_mass_fraction
    rod = tail.mass - sail
    middle = tail.length - tail.sail_length / 2
    depth = (0.5 + tail.sail_board_share) * tail.sail_width
    return (
        rod * tail.length**2 / 3
        + sail * (middle**2 + (tail.sail_length**2 + depth**2) / 12)
        + motor.rotor_inertia * motor.gear_ratio**2
    )


def test_positive_roll_swings_to_the_right_and_positive_pitch_forward():
    length = ArmOnTheBench().scenario.tail.length
    assert_allclose(ArmOnTheBench().tip(), [0.0, 0.0, length], atol=1e-12)
    assert_allclose(ArmOnTheBench(angles=(0.0, math.pi / 2)).tip(), [0.0, -length, 0.0], atol=1e-12)
    assert_allclose(ArmOnTheBench(angles=(math.pi / 2, 0.0)).tip(), [length, 0.0, 0.0], atol=1e-12)


def test_roll_inertia_is_that_of_rod_sail_and_rotor():
    scenario = scenario_from_dict({})
    motor = scenario.tail_motor
    arm = arm_inertia(scenario.tail, motor, scenario.car)
    rotor = motor.rotor_inertia * motor.gear_ratio**2
    assert arm.roll + rotor == pytest.approx(roll_inertia(scenario.tail, motor), rel=1e-7)


@pytest.mark.parametrize("added", [0.0, 0.03, -0.02, -0.039])
@pytest.mark.parametrize("roll", [0.0, 0.6, -math.pi / 2])
def test_inertia_that_the_motors_count_with_is_that_of_the_plant_and_its_added_mass(added, roll):
    bench = ArmOnTheBench(angles=(0.3, roll), tail={"added_mass": added})
    motor = bench.scenario.tail_motor
    arm = arm_inertia(bench.scenario.tail, motor, bench.scenario.car)
    # The slides free the added mass along the tail: what the two joints feel is the matrix with
    # them eliminated.
    inverse = np.linalg.inv(bench.plant.CalcMassMatrix(bench.context))
    joints = [
        bench.plant.GetJointByName(name).velocity_start() for name in ("tail_pitch", "tail_roll")
    ]
    felt = np.linalg.inv(inverse[np.ix_(joints, joints)])
    rotor = motor.rotor_inertia * motor.gear_ratio**2
    expected = np.diag(np.array(inertia_about_joints(arm, roll)) + rotor)
    assert_allclose(expected, felt, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("added", [0.03, -0.039])
def test_swing_with_added_mass_is_the_same_at_a_quarter_of_the_step(added):
    times = np.arange(0.02, 1.01, 0.02)
    angles = []
    for step in (0.002, 0.0005):
        bench = ArmOnTheBench(step, [1.0, *HELD[1:]], (0.0, -1.5), tail={"added_mass": added})
        angles.append(bench.history("tail_roll", times))
    # First order in the step: 1.5 ms on a rate of at most 8.5 rad/s (2.5 rad, kp / kd = 3.4 /s).
    assert_allclose(angles[0], angles[1], atol=0.013)
    assert angles[0][-1] == pytest.approx(1.0, abs=0.15)  # there, less what friction keeps


@pytest.mark.parametrize(("kp", "kd"), [(17.0, 5.0), (5.0, 2.0), (17.0, 1.0)])
def test_step_of_the_roll_command_follows_the_closed_form(kp, kd):
    start = -0.5
    target = 0.4
    times = np.arange(0.05, 1.01, 0.05)
    errors = []
    for step in (0.002, 0.001):
        bench = ArmOnTheBench(
            step, [target, 0.0, kp, kd, 0.0], (0.0, start), pitch=STIFF, **FRICTIONLESS
        )
        inertia = roll_inertia(bench.scenario.tail, bench.scenario.tail_motor)
        expected = second_order(times, start, target, inertia, kp, kd)
        errors.append(np.abs(bench.history("tail_roll", times) - expected).max())
    # First order in the step: 2 ms late on a fastest rate of 8 rad/s, and half of that at half the
    # step.
    assert errors[0] < 0.016
    assert errors[1] < 0.6 * errors[0]


def test_swing_reaches_the_commanded_rate_less_what_friction_takes():
    speed = 8.0
    kd = 3.0
    bench = ArmOnTheBench(roll=[0.0, speed, 0.0, kd, 0.0], angles=(0.0, -1.5))
    bench.simulator.AdvanceTo(0.3)
    rate = bench.plant.GetJointByName("tail_roll").get_angular_rate(bench.context)
    friction = bench.scenario.friction
    # kd (8 - w) = Cf + Vf w; the start, with a time constant of 26 ms, has died out to 1e-5.
    assert rate == pytest.approx(
        (kd * speed - friction.coulomb) / (kd + friction.viscous), rel=1e-4
    )


def test_held_tail_sags_by_its_weight_over_the_gain():
    kp = 17.0
    angle = 0.5
    hold = [angle, *HELD[1:]]
    bench = ArmOnTheBench(roll=hold, angles=(0.0, angle), gravity=9.81, **FRICTIONLESS)
    bench.simulator.AdvanceTo(3.0)
    tail = bench.scenario.tail
    first_moment = tail.mass * (
        (1 - tail.sail_mass_fraction) * tail.length / 2
        + tail.sail_mass_fraction * (tail.length - tail.sail_length / 2)
    )
    reached = bench.angle("tail_roll")
    # A tail to the right of upright falls further to the right; at rest the motor carries its
    # moment, exactly.
    assert reached > angle
    assert kp * (reached - angle) == pytest.approx(
        9.81 * first_moment * math.sin(reached), rel=1e-4
    )


def test_motor_cannot_pass_the_stop_of_the_joint():
    bench = ArmOnTheBench(
        roll=[3.0, 0.0, 50.0, 2.0, 0.0], angles=(0.0, 1.0), tail={"roll_stop": math.pi / 2}
    )
    bench.simulator.AdvanceTo(1.0)
    # The stop is a stiff spring: it gives way by less than a hundredth of a radian under the peak
    # torque.
    assert bench.angle("tail_roll") == pytest.approx(math.pi / 2, abs=0.01)


def test_friction_of_the_pair_is_that_of_the_scenario():
    car = scenario_from_dict({"car": {"tyre_friction": 0.7, "cage_friction": 0.3}}).car
    partner = ground_partner_friction(car)
    assert 2 * partner * 0.7 / (partner + 0.7) == pytest.approx(0.3)


def test_every_tail_of_the_prior_loads_in_drake():
    generator = np.random.default_rng(1)
    for low, high in generator.random((25, 2)):
        tail = {
            "length": 0.6 + 0.4 * low,
            "sail_length": 0.3 + 0.3 * high,
            "sail_width": 0.03 + 0.22 * low,
        }
        ArmOnTheBench(tail=tail | {"mass": 0.05 + 0.2 * high})
