"""What drives the plant: the same with and without the truth beside it, and the air as Drake's
kinematics have it.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydrake.math import RigidTransform
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import LogVectorOutput, PassThrough

from aerodima.workbench.car.car_diagram import assemble
from aerodima.workbench.car.car_station import make_car_station, simulated_car
from aerodima.workbench.control.manoeuvre import run_time
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.event_order import EventPriority, period_of
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import STATION_INPUTS, STATION_OUTPUTS
from tests.refusals import assert_refused
from tests.workbench.stands import CarStand

WIND = ["wind.mean_x=-1.0", "wind.mean_y=2.0", "wind.gust_amplitude=1.0", "wind.turbulence=0.5"]
RUNS = {
    "published swing": ("turn_swing", []),
    "no tail": ("turn_none", []),
    "no tail, flips": ("turn_none", ["manoeuvre.speed=3.61"]),
    "locked sail": ("turn_swing", ["tail.sail=locked"]),
    "coefficients over speed": (
        "turn_swing",
        ["tail.coefficients=robot_tail_line", "manoeuvre.duration=2.7"],
    ),
    "free sail through the turn": ("turn_swing", ["tail.sail=free", "manoeuvre.duration=2.7"]),
    "added mass in wind": ("turn_swing", ["tail.added_mass=0.003", *WIND]),
    "held, to the right, smaller step": (
        "turn_held",
        ["manoeuvre.direction=right", "simulation.step=0.001"],
    ),
}


def run(scenario, minimal):
    """State of the plant at every step, and every output of the contract at 100 Hz, by name of the
    port.
    """
    car = assemble(scenario, minimal=minimal)
    rates = {"plant_state_truth": 1.0 / scenario.simulation.step} | dict.fromkeys(
        STATION_OUTPUTS, 100.0
    )
    sinks = {
        name: LogVectorOutput(
            car.station.GetOutputPort(name),
            car.builder,
            publish_period=period_of(rate, EventPriority.RECORD),
        )
        for name, rate in rates.items()
    }
    simulator = Simulator(car.builder.Build())
    simulator.AdvanceTo(run_time(scenario))
    return {name: sink.FindLog(simulator.get_context()).data() for name, sink in sinks.items()}


@pytest.mark.slow
@pytest.mark.parametrize("case", RUNS)
def test_station_moves_alike_with_and_without_its_truth_over_a_whole_run(case):
    """With it the plant samples its output ports, and what drives it is kept by a `SampledHold`."""
    name, settings = RUNS[case]
    scenario = load_scenario(name, settings)
    expected, found = (run(scenario, minimal) for minimal in (False, True))
    moved = expected["plant_state_truth"]
    assert moved.shape[1] > 1300
    assert np.abs(moved - moved[:, :1]).max() > 1.0
    for port, values in expected.items():
        assert_array_equal(found[port], values, err_msg=port)


@pytest.mark.parametrize("sail", ["free", "locked", "facing"])
def test_air_in_wind_is_what_a_tail_force_says_at_any_state(sail):
    """`TailForce` asks Drake where the sail is and how it moves; what drives the plant has that in
    closed form, also on which coordinates a force of the sail acts.
    """
    car = CarStand(load_scenario("turn_swing", [f"tail.sail={sail}", *WIND]))
    plant = car.plant
    context = car.plant_context
    air = car.station.GetSubsystemByName("tail_aerodynamics").GetOutputPort("force")
    wrenches = [
        system.GetOutputPort("wrench")
        for system in car.station.GetSystems()
        if system.get_name().startswith("tail_force_tail_sail")
    ]
    names = ("tail_pitch", "tail_roll", "tail_sail_turn")[: 3 if sail == "free" else 2]
    q = car.chassis.floating_positions_start()
    v = car.chassis.floating_velocities_start_in_v()
    moved = [*range(v, v + 6), *(plant.GetJointByName(name).velocity_start() for name in names)]
    frame = plant.GetFrameByName("tail_sail")
    world = plant.world_frame()
    rng = np.random.default_rng(4)
    strongest = 0.0
    for _ in range(10):
        positions = rng.uniform(-1.0, 1.0, plant.num_positions())
        positions[q : q + 4] /= np.linalg.norm(positions[q : q + 4])
        plant.SetPositions(context, positions)
        plant.SetVelocities(context, rng.uniform(-5.0, 5.0, plant.num_velocities()))
        car.simulator.Initialize()  # the plant's ports show the state that it is given then
        told = [port.Eval(port.get_system().GetMyContextFromRoot(car.context)) for port in wrenches]
        (force, moment, _) = np.split(np.sum(told, axis=0), 3)
        found = air.Eval(air.get_system().GetMyContextFromRoot(car.context))
        J = plant.CalcJacobianSpatialVelocity(
            context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world
        )
        expected = J[:, moved].T @ [*moment, *force]
        assert_allclose(found[: len(moved)], expected, rtol=0.0, atol=1e-9)
        strongest = max(strongest, np.linalg.norm(force))
    assert strongest > 0.5


def test_torque_of_a_step_is_that_of_the_motor_law_at_its_end():
    """The drives foresee the end of a step from the acceleration of the step before. On a car in
    space whose tail swings 0.5 rad to both sides, the torque then is kp (q_d - q) - kd w of the
    state that it leads to; at its begin it would be kd times the change of w off.
    """
    kp, kd = 17.0, 5.0
    still = {"environment": {"gravity": 0.0}, "friction": {"coulomb": 0.0, "viscous": 0.0}}
    tail = {"mode": "held", "normal_force_coefficient": 0.0}
    hold = [0.0, 0.0, kp, kd, 0.0]
    car = CarStand(
        scenario_from_dict(still | {"tail": tail}), tail_pitch_command=hold, tail_roll_command=hold
    )
    joint = car.plant.GetJointByName("tail_roll")
    joint.set_angle(car.plant_context, 0.5)
    car.place(RigidTransform([0.0, 0.0, 50.0]))
    rows = []
    for number in range(150):
        car.advance((number + 0.5) * car.scenario.simulation.step)
        motion = joint.get_angle(car.plant_context), joint.get_angular_rate(car.plant_context)
        rows.append([car.output("tail_torque")[1], *motion])
    torques = np.array(rows)[:-1, 0]
    _, angle, rate = np.array(rows)[1:].T
    error = torques + kp * angle + kd * rate
    assert np.abs(kd * np.diff(rate)).max() > 0.9
    assert np.abs(error[3:]).max() < 0.1  # until the first steps have shown an acceleration


class Spring(LeafSystem):
    """A tail motor of a user: a torsional spring of 5 N m/rad that takes no command."""

    def __init__(self, scenario, joint):
        super().__init__()
        state = self.DeclareVectorInputPort("joint_state", 2)
        self.DeclareVectorOutputPort(
            "torque",
            1,
            lambda context, torque: torque.SetFromVector(-5.0 * state.Eval(context)[:1]),
        )


def test_a_motor_of_the_user_takes_the_place_of_both_tail_motors():
    station = make_car_station(load_scenario("turn_held"), with_truth=False, tail_motor=Spring)
    context = station.CreateDefaultContext()
    for name, fields in STATION_INPUTS.items():
        station.GetInputPort(name).FixValue(context, [0.0] * fields.size)
    plant = simulated_car(station).plant
    state = plant.GetMyMutableContextFromRoot(context)
    for name, angle in (("tail_pitch", 0.1), ("tail_roll", -0.3)):
        plant.GetJointByName(name).set_angle(state, angle)
    torques = station.GetOutputPort("tail_torque").Eval(context)
    assert_allclose(torques, [-0.5, 1.5])


def test_a_motor_without_a_torque_is_refused():
    def work():
        make_car_station(load_scenario("turn_held"), tail_motor=lambda *_: PassThrough(2))

    assert_refused(work, UserError, "tail_motor", "'u'")
