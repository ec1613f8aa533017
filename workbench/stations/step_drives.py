"""What drives the plant in one step as a function of numbers alone: no Drake, no objects, so that it can be compiled.

The laws are those of the separate systems (`actuators`, `aero`, `plants`), called with plain numbers under the names of
the parameters. `inputs` may be a list or an array: a list is the fastest in Python, an array in compiled code.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from aerodima.workbench.actuators.ak70 import loaded_torque, torque_speed_limits
from aerodima.workbench.actuators.drive import shaft_gain, shaft_torque
from aerodima.workbench.actuators.servo import knuckle_motion, steering_motion
from aerodima.workbench.aero.laws import SectionLaw
from aerodima.workbench.aero.plates import Plates, plates_force
from aerodima.workbench.aero.sail_motion import SailMotion, generalised_force, sail_motion
from aerodima.workbench.aero.sections import SectionLayout, line_motion
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.plants.car_model import axle_statics
from aerodima.workbench.plants.joint_friction import friction_torque
from aerodima.workbench.plants.tail import ArmInertia, arm_inertia, inertia_about_joints
from aerodima.workbench.stations.car_air import sail_strips

QUATERNION, VELOCITY, ANGLES, RATES, SHAFT, MOTION_SIZE = 0, 7, 13, 16, 19, 20
"""Where the laws find in the plant's motion: quaternion, position, angular velocity and velocity of the chassis in W,
angles and rates of the tail's joints (0 where there are none), rate of the drive's shaft."""

SHAFT_TORQUE, KNUCKLES, JOINT_TORQUES, AIR_ON_CHASSIS, AIR_ON_JOINTS = 0, 1, 5, 7, 13
MOTOR_TORQUES, DRIVES_SIZE = 16, 18
"""What drives the plant: torque on the shaft, N m; angles, rad, then rates, rad/s, of left and right knuckle; torques
on pitch and roll joint, N m; of the air, its moment on the chassis about its origin, N m, its force, N, in W, and its
torques on pitch, roll and sail joint, N m; torques of the tail motors alone, N m, which those on the joints include.
Without a tail all behind the knuckles is 0."""

THROTTLE, FRAME = MOTION_SIZE, MOTION_SIZE + 1
STEPPED = FRAME + 3
LAST_MOTION = STEPPED + 1
LAST_DRIVES = LAST_MOTION + MOTION_SIZE
COMMANDS = LAST_DRIVES + DRIVES_SIZE
WIND = COMMANDS + 2 * 5
"""Where a step finds its inputs behind the motion, see `FusedStep`."""

_NO_TAIL = (0.0,) * (DRIVES_SIZE - JOINT_TORQUES)


class DriveNumbers(NamedTuple):
    """Of `DriveParameters`."""

    throttle_gain: float
    throttle_offset: float
    breakaway_throttle: float
    governor: bool
    torque_limit: float


class LinkageNumbers(NamedTuple):
    """Of `ServoParameters` and `CarParameters`."""

    linkage: str
    wheelbase: float
    track: float


class CarNumbers(NamedTuple):
    """Drive and steering of a car.

    Attributes:
        drive: line, torque limit.
        gain: of `shaft_gain`, N m s/rad.
        radius: of the loaded rear tyres, m.
        linkage: of the steering.
        servo_rate: rad/s.
    """

    drive: DriveNumbers
    gain: float
    radius: float
    linkage: LinkageNumbers
    servo_rate: float


class MotorNumbers(NamedTuple):
    """Of `TailMotorParameters`."""

    torque_error: float
    kp_max: float
    kd_max: float
    torque_limit: float


class Strip(NamedTuple):
    """A line of sections, see `SectionLayout`, with numbers for coefficients."""

    axis_B: tuple[float, float, float]
    normal_B: tuple[float, float, float]
    p_BoRo_B: tuple[float, float, float]
    distances: Sequence[float]
    areas: Sequence[float]
    plates: Plates


class TailNumbers(NamedTuple):
    """A tail with its air.

    Attributes:
        p_BoSo_B: where the joint axes cross, in the chassis frame, m.
        step: of the plant, s.
        motor: limits.
        line: of `torque_speed_limits`.
        rotor: reflected inertia, kg m2.
        arm: inertia about the joints.
        coulomb, viscous, tanh_gain: of `smooth_friction`.
        density: of the air, kg/m3.
        windy: whether the inputs have the velocity of the air.
        strips: lines of sections whose law is numbers.
    """

    p_BoSo_B: tuple[float, float, float]
    step: float
    motor: MotorNumbers
    line: tuple[float, float]
    rotor: float
    arm: ArmInertia
    coulomb: float
    viscous: float
    tanh_gain: float
    density: float
    windy: bool
    strips: tuple[Strip, ...]


def car_numbers(scenario: Scenario) -> CarNumbers:
    """Drive and steering of a scenario."""
    drive, car = scenario.drive, scenario.car
    return CarNumbers(
        DriveNumbers(*(getattr(drive, name) for name in DriveNumbers._fields)),
        shaft_gain(drive, car),
        axle_statics(car, scenario.environment.gravity, "rear").wheel_height,
        LinkageNumbers(scenario.servo.linkage, car.wheelbase, car.track),
        scenario.servo.rate,
    )


def tail_numbers(
    scenario: Scenario, p_BoSo_B: Sequence[float], windy: bool
) -> tuple[TailNumbers, list[tuple[SectionLayout, SectionLaw]]]:
    """The tail of a scenario, and the lines of its sail whose law is no numbers.

    Args:
        p_BoSo_B: where the tail's joint axes cross, in the chassis frame (3), m.
        windy: whether the inputs have the velocity of the air.
    """
    motor, friction, strips = scenario.tail_motor, scenario.friction, []
    others = []
    for layout, law in sail_strips(scenario.tail):
        if law.plates is None:
            others.append((layout, law))
            continue
        geometry = (layout.axis_B, layout.normal_B, layout.p_BoRo_B, layout.distances, layout.areas)
        strips.append(Strip(*geometry, law.plates))
    x, y, z = p_BoSo_B
    numbers = TailNumbers(
        p_BoSo_B=(float(x), float(y), float(z)),
        step=scenario.simulation.step,
        motor=MotorNumbers(*(getattr(motor, name) for name in MotorNumbers._fields)),
        line=torque_speed_limits(motor),
        rotor=motor.rotor_inertia * motor.gear_ratio**2,
        arm=arm_inertia(scenario.tail, motor, scenario.car),
        coulomb=friction.coulomb,
        viscous=friction.viscous,
        tanh_gain=friction.tanh_gain,
        density=scenario.environment.air_density,
        windy=windy,
        strips=tuple(strips),
    )
    return numbers, others


def step_drives(time: float, inputs: Sequence[float], car: CarNumbers, tail: TailNumbers | None) -> tuple[float, ...]:
    """What drives the plant (18), see `DRIVES_SIZE`.

    Args:
        time: s.
        inputs: of `FusedStep`, (n).
        car, tail: of the scenario; None without a tail.
    """
    torque = shaft_torque(inputs[THROTTLE], inputs[SHAFT], car.drive, car.gain, car.radius)
    frame = (inputs[FRAME], inputs[FRAME + 1], inputs[FRAME + 2])
    angle, rate = steering_motion(frame, time, car.servo_rate)
    left, right, left_rate, right_rate = knuckle_motion(angle, rate, car.linkage, car.linkage)
    drives = (torque, left, right, left_rate, right_rate)
    if tail is None:
        return drives + _NO_TAIL
    pitch_inertia, roll_inertia = inertia_about_joints(tail.arm, inputs[ANGLES + 1])
    pitch, pitch_friction = joint_torque(0, pitch_inertia, inputs, tail)
    roll, roll_friction = joint_torque(1, roll_inertia, inputs, tail)
    joints = (pitch + pitch_friction, roll + roll_friction)
    return drives + joints + air_force(inputs, tail) + (pitch, roll)


def joint_torque(joint: int, inertia: float, inputs: Sequence[float], tail: TailNumbers) -> tuple[float, float]:
    """Torque of the motor and of the friction of one joint, N m.

    Args:
        joint: 0 pitch, 1 roll.
        inertia: of the arm about it, kg m2.
        inputs, tail: as for `step_drives`.
    """
    rate = inputs[RATES + joint]
    friction = friction_torque(rate, math.tanh(tail.tanh_gain * rate), tail.coulomb, tail.viscous)
    acceleration = inputs[STEPPED] * (rate - inputs[LAST_MOTION + RATES + joint]) / tail.step
    motion = (inputs[ANGLES + joint], rate, acceleration)
    c = COMMANDS + 5 * joint
    command = (inputs[c], inputs[c + 1], inputs[c + 2], inputs[c + 3], inputs[c + 4])
    last = inputs[LAST_DRIVES + JOINT_TORQUES + joint]
    torque = loaded_torque(motion, last, friction, command, tail.motor, tail.line, tail.step, inertia + tail.rotor)
    return torque, friction


def sail_of(inputs: Sequence[float], p_BoSo_B: tuple[float, float, float]) -> SailMotion:
    """Motion of the sail, see `sail_motion`."""
    q, v = QUATERNION, VELOCITY
    return sail_motion(
        (inputs[q], inputs[q + 1], inputs[q + 2], inputs[q + 3]),
        (inputs[v], inputs[v + 1], inputs[v + 2], inputs[v + 3], inputs[v + 4], inputs[v + 5]),
        (inputs[ANGLES], inputs[ANGLES + 1], inputs[ANGLES + 2]),
        (inputs[RATES], inputs[RATES + 1], inputs[RATES + 2]),
        p_BoSo_B,
    )


def wind_of(inputs: Sequence[float], windy: bool) -> tuple[float, float, float]:
    """Velocity of the air in W, m/s."""
    return (inputs[WIND], inputs[WIND + 1], inputs[WIND + 2]) if windy else (0.0, 0.0, 0.0)


def air_force(inputs: Sequence[float], tail: TailNumbers) -> tuple[float, ...]:
    """Of the air on the lines of sections that are numbers, see `generalised_force`; arguments as `step_drives`."""
    sail, wind = sail_of(inputs, tail.p_BoSo_B), wind_of(inputs, tail.windy)
    fx = fy = fz = mx = my = mz = 0.0
    for strip in tail.strips:
        a, n, u, k = line_motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind, strip.axis_B, strip.normal_B, strip.p_BoRo_B)
        wrench = plates_force(u, k, a, n, strip.distances, strip.areas, tail.density, strip.plates)
        force, moment = about_origin(wrench, sail.R_WS, strip.p_BoRo_B)
        fx, fy, fz = fx + force[0], fy + force[1], fz + force[2]
        mx, my, mz = mx + moment[0], my + moment[1], mz + moment[2]
    return generalised_force(sail, (fx, fy, fz), (mx, my, mz))


def about_origin(
    wrench: Sequence[float], R_WS: Sequence[Sequence[float]], p_SoRo_S: tuple[float, float, float]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Force and moment about the sail's origin of a wrench (6) about a point of the sail; `R_WS` as in `SailMotion`."""
    fx, fy, fz, mx, my, mz = wrench
    x, y, z = p_SoRo_S
    if x != 0.0 or y != 0.0 or z != 0.0:
        (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R_WS
        px, py, pz = xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z
        mx, my, mz = mx + (py * fz - pz * fy), my + (pz * fx - px * fz), mz + (px * fy - py * fx)
    return (fx, fy, fz), (mx, my, mz)
