"""What the car of the model files has where the thesis states something that is no parameter.

No simulation.
"""

import math
from functools import cache, partial
from xml.etree import ElementTree

import numpy as np
from pydrake.systems.framework import DiagramBuilder

from aerodima.optimisation.studies.study import load_study, plan_runs
from aerodima.workbench.aero.section_laws import LineMotion, NormalForceLaw
from aerodima.workbench.car.car_air import free_sail, sail_law
from aerodima.workbench.car.car_model import wheel_rates
from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.control.manoeuvre import ThrottleLine
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.logs.signals import GPS_FILTER, IMU_FILTER, RIG_FILTER
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import AXLES
from tests.built.registry import CHECKS, check
from tests.built.statements import parameter_entry
from tests.workbench.aero import vanes


@cache
def car(tail="swing", *settings):
    scenario = load_scenario(f"turn_{tail}", list(settings))
    return scenario, add_car_plant(DiagramBuilder(), scenario)


def actuated(part, built=None):
    """Joints of the tail or the car that a motor or servo moves."""
    built = built or car()[1]
    instance = built.tail if part == "tail" else built.car
    return {
        built.plant.get_joint_actuator(i).joint().name()
        for i in built.plant.GetJointActuatorIndices(instance)
    }


def joints(kind, part, built=None):
    """Names of the joints of a type in the tail or the car."""
    built = built or car()[1]
    instance = built.tail if part == "tail" else built.car
    found = (built.plant.get_joint(index) for index in built.plant.GetJointIndices(instance))
    return sorted(joint.name() for joint in found if joint.type_name() == kind)


# Tail and gearbox


@check
def driven_tail_joints():
    return " and ".join(sorted(name.removeprefix("tail_") for name in actuated("tail")))


@check
def third_joint_has_a_motor():
    """Of the free sail, which is the one with a joint of its own."""
    _, built = car("swing", "tail.sail=free")
    assert "tail_sail_turn" in joints("revolute", "tail", built)
    return "tail_sail_turn" in actuated("tail", built)


def side_moment(*settings):
    """Side area of shell and board times its distance behind the bearing (m3): above 0 the sail
    turns into the wind.
    """
    tail = load_scenario("turn_swing", ["tail.sail=free", *settings]).tail
    return vanes.side_moment(free_sail(tail, sail_law(tail)[0]))


@check
def final_sail_turns_into_the_wind():
    return side_moment() > 0.0


@check
def sail_turns_into_the_wind_with_its_bearing_further_back():
    """Bearing 0.6 of the width further back than ours."""
    return side_moment("tail.sail_shell_offset=-0.35") > 0.0


@check
def torque_in_a_wind_of_30():
    """Moment (N m) of the air about the roll axis, sail broadside at rest in a wind of 30 m/s."""
    tail = car()[0].tail
    air = car()[0].environment
    arm = tail.length - 0.5 * tail.sail_length
    area = tail.sail_length * tail.sail_width
    return 0.5 * air.air_density * tail.normal_force_coefficient * area * 30.0**2 * arm


@check
def sail_area():
    tail = car()[0].tail
    return tail.sail_length * tail.sail_width


# Body


@check
def end_of_the_anti_ramp_board():
    """Where the board's body stands in the plant, against the axles."""
    scenario, built = car()
    plant = built.plant
    half = 0.5 * scenario.car.board_length
    chassis, board = (plant.GetFrameByName(name) for name in ("chassis", "board"))
    middle = plant.CalcRelativeTransform(
        plant.CreateDefaultContext(), chassis, board
    ).translation()[0]
    return (
        "rear"
        if middle + half < 0.0
        else "front"
        if middle - half > scenario.car.wheelbase
        else "middle"
    )


@cache
def car_file():
    return ElementTree.parse(model_path("car/car.sdf")).getroot()


@check
def gearbox_stands_within_the_cage():
    """Seen from above: the gearbox within the corners of the cage."""
    scenario, _ = car()
    corners = [
        [float(number) for number in collision.findtext("pose").split()[:3]]
        for collision in car_file().iter("collision")
        if "cage" in collision.get("name", "")
    ]
    assert len(corners) >= 4
    low = np.min(corners, axis=0)[:2]
    high = np.max(corners, axis=0)[:2]
    half = 0.5 * np.array([scenario.car.gearbox_length, scenario.car.gearbox_width])
    middle = np.array([scenario.car.gearbox_x, 0.0])
    return bool(np.all(middle - half >= low) and np.all(middle + half <= high))


@check
def gearbox_from_the_middle_of_the_wheelbase():
    """Distance (m) of its middle behind the middle between the axles."""
    scenario, _ = car()
    return 0.5 * scenario.car.wheelbase - scenario.car.gearbox_x


@check
def friction_over_stability_factor():
    """Friction over (half track / height of the centre of mass): above 1 a rigid car tips before it
    slides.
    """
    values = car()[0].car
    return values.tyre_friction * values.com_height / values.outer_half_track


@check
def suspensions():
    return float(
        sum("suspension" in name for name in joints("prismatic", "car") + joints("revolute", "car"))
    )


@check
def steered_wheels():
    steering = sorted(name for name in actuated("car") if "steering" in name)
    return "front" if steering == ["front_left_steering", "front_right_steering"] else str(steering)


@check
def differential_ratio():
    """Turns of the motor's shaft per turn of both rear wheels, from the constraint of the model
    file.
    """
    ends = {
        element.get("name"): float(element.get("a", "nan"))
        for element in car_file().iter()
        if element.tag.endswith("tendon_constraint_joint")
    }
    return -(ends["rear_left_spin"] + ends["rear_right_spin"]) / ends["drive_shaft_spin"]


@check
def front_tyre_damping():
    """Damping (N s/m) of a front tyre under its share of the car's weight: dissipation x normal
    force.
    """
    scenario, _ = car("none")
    values = scenario.car
    rear = 1.0 - values.com_x / values.wheelbase
    return values.tyre_dissipation * 0.5 * (1.0 - rear) * values.mass * scenario.environment.gravity


for axle in AXLES:
    for place, what in enumerate(("stiffness", "damping")):
        CHECKS[f"{axle}_wheel_{what}"] = lambda axle=axle, place=place: wheel_rates(
            car()[0].car, axle
        )[place]


@check
def suspension_damping_over_stiffness():
    values = car()[0].car
    front = values.suspension_damping_front / values.suspension_stiffness_front
    rear = values.suspension_damping_rear / values.suspension_stiffness_rear
    assert math.isclose(front, rear, rel_tol=1e-3)
    return front


# Straight line


def throttle_line():
    drive = car()[0].drive
    return ThrottleLine(drive.throttle_gain, drive.throttle_offset)


@check
def governor_of_the_automatic_run():
    return load_scenario("auto_turn").drive.governor


@check
def time_to_a_steady_speed():
    """After a throttle step the open-loop drive is within 3 % of its steady speed, s."""
    return car()[0].drive.time_constant * math.log(1.0 / 0.03)


def speed_at(percent):
    drive = car()[0].drive
    return drive.throttle_gain * percent / 100.0 + drive.throttle_offset


for percent in (30, 35, 50):
    CHECKS[f"speed_at_{percent}_percent"] = partial(speed_at, percent)


@check
def speed_at_full_throttle():
    """Fastest speed (m/s) that a scenario may ask for, bisected."""
    low = 0.0
    high = 100.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        try:
            throttle_line().check_speed(middle)
        except UserError:
            high = middle
        else:
            low = middle
    return low


# Tunnel tests and aerodynamic model of the robot's tail


def _robot_grid(factor):
    (block,) = load_study("robot_swings").blocks
    return ", ".join(f"{float(value):g}" for value in block.grid[factor])


@check
def swings_of_the_robot_campaign():
    return float(len(plan_runs(load_study("robot_swings"))))


CHECKS["winds_of_the_robot_campaign"] = partial(_robot_grid, "experiment.wind_speed")
CHECKS["gains_of_the_robot_campaign"] = partial(_robot_grid, "robot.kp")


def described(design):
    return f"order {design.order}, {design.cutoff_hz:g} Hz"


CHECKS["filter_of_the_rig"] = partial(described, RIG_FILTER)
CHECKS["filter_of_the_imu"] = partial(described, IMU_FILTER)
CHECKS["filter_of_the_gps"] = partial(described, GPS_FILTER)


def force_at(gamma):
    """Normal force (N) on 1 m2 of sail whose axis leans by gamma out of broadside, wind of 1 m/s
    along x.
    """
    a = (math.sin(gamma), 0.0, math.cos(gamma))
    n = (math.cos(gamma), 0.0, -math.sin(gamma))
    found = NormalForceLaw(2.0).line_force(
        LineMotion((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), a, n), [0.0], [1.0], 1.225
    )
    return math.hypot(*found[:3])


@check
def force_broadside_over_equation_6_8():
    return force_at(0.0) / (0.5 * 1.225 * 2.0 * 1.0)


@check
def force_at_45_degrees_over_equation_6_8():
    return force_at(math.radians(45.0)) / (0.5 * 1.225 * 2.0 * math.cos(math.radians(45.0)))


@check
def torque_constant_at_the_rotor():
    output = parameter_entry("rig/robot.torque_constant")
    ratio = parameter_entry("tail_motor.gear_ratio")
    return float(output.value) / float(ratio.value)


@check
def current_at_the_peak_torque():
    return car()[0].tail_motor.torque_limit / float(
        parameter_entry("rig/robot.torque_constant").value
    )
