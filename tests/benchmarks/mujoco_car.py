"""The tailless car as MJCF and its turn in MuJoCo, for the benchmark: the same masses, springs,
tyres and commands.

What differs is the contact: MuJoCo's soft constraint instead of point contact with Hunt-Crossley
damping. Its stiffness and damping are set so that a tyre carries its load at the same deflection
and is damped alike there. Cage and board are left out: a run ends when the car has passed 75
degrees.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from aerodima.workbench.car.car_model import (
    axle_statics,
    chassis_inertial,
    gearbox_height,
    unsprung_mass,
    wheel_rates,
)
from aerodima.workbench.car.laws import knuckle_motion, shaft_gain
from aerodima.workbench.car.verdict import FLIP_TILT
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.scenario import Scenario

IMPEDANCE = 0.1
"""Of a tyre contact: the smaller, the more its force is that of a spring and damper and nothing
else."""
FRICTION_RATIO = 0.1
"""Impedance of friction over that of the normal force. From 1 on the normal force of a tyre that
slides grows with its slip (MuJoCo projects on its friction cone in a metric that this ratio sets),
and with a fine step no car rolls over."""


def mjcf(scenario: Scenario, step: float) -> str:
    """The car of a scenario as MJCF text; it stands at the origin and heads along x."""
    car = scenario.car
    tail = scenario.tail
    drive = scenario.drive
    servo = scenario.servo
    gravity = scenario.environment.gravity
    chassis = chassis_inertial(car, tail, gravity)
    m = car.gearbox_mass / 12
    w = car.gearbox_width**2
    length = car.gearbox_length**2
    h = car.gearbox_height**2
    parts = []
    knuckles = []
    for axle in ("front", "rear"):
        for side, sign in (("left", 1), ("right", -1)):
            parts.append(_corner(scenario, axle, side, sign))
            if axle == "front":
                knuckles.append(
                    f'<position name="{side}" joint="front_{side}_steering" kp="{servo.stiffness}" '
                    f'kv="{servo.damping}" forcerange="{-servo.torque_limit} '
                    f'{servo.torque_limit}"/>'
                )
    return f"""<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option timestep="{step}" gravity="0 0 {-gravity}" integrator="implicitfast" cone="elliptic"
          impratio="{FRICTION_RATIO}"/>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1" friction="{car.tyre_friction} 0 0"
          contype="1" conaffinity="0"/>
    <body name="chassis">
      <freejoint/>
      {_inertial(chassis.mass, chassis.com, chassis.moments)}
      <body pos="{car.gearbox_x} 0 {gearbox_height(car, tail)}">
        {_inertial(car.gearbox_mass, (0, 0, 0), (m * (w + h), m * (length + h), m * (length + w)))}
      </body>
      {"".join(parts)}
    </body>
  </worldbody>
  <tendon>
    <fixed name="shaft" armature="{drive.rotor_inertia}">
      <joint joint="rear_left_spin" coef="0.5"/><joint joint="rear_right_spin" coef="0.5"/>
    </fixed>
  </tendon>
  <actuator>
    {"".join(knuckles)}
    <velocity name="drive" tendon="shaft" kv="{shaft_gain(drive, car)}"
              forcerange="{-drive.torque_limit} {drive.torque_limit}"/>
  </actuator>
</mujoco>"""


def _corner(scenario: Scenario, axle: str, side: str, sign: int) -> str:
    car = scenario.car
    statics = axle_statics(car, scenario.environment.gravity, axle)
    front = axle == "front"
    name = f"{axle}_{side}"
    spring, damper = wheel_rates(car, axle)
    tyre = car.tyre_stiffness_front if front else car.tyre_stiffness_rear
    moving = unsprung_mass(car, axle)
    stiffness = (1.0 - IMPEDANCE) * tyre / moving
    damping = statics.wheel_load * car.tyre_dissipation / moving
    radius = car.tyre_radius
    half = 0.5 * car.tyre_width
    diametral = car.wheel_mass * (3 * radius**2 + car.tyre_width**2) / 12
    upright = 0.4 * car.upright_mass * 0.03**2
    knuckle = 0.4 * car.knuckle_mass * 0.02**2
    wheel = f"""<body name="{name}_wheel">
        <joint name="{name}_spin" type="hinge" axis="0 1 0"/>
        {
        _inertial(
            car.wheel_mass, (0, 0, 0), (diametral, 0.5 * car.wheel_mass * radius**2, diametral)
        )
    }
        <geom type="cylinder" size="{radius} {half}" zaxis="0 1 0" friction="{
        car.tyre_friction
    } 0 0" contype="0"
              conaffinity="1" solref="{-stiffness} {-damping}" solimp="{IMPEDANCE} {
        IMPEDANCE
    } 0.001" priority="1"/>
      </body>"""
    if front:
        wheel = f"""<body name="{name}_knuckle">
        <joint name="{name}_steering" type="hinge" axis="0 0 1"/>
        {_inertial(car.knuckle_mass, (0, 0, 0), (knuckle,) * 3)}
        {wheel}
      </body>"""
    x = car.wheelbase if front else 0.0
    y = sign * car.track / 2
    travel = car.suspension_travel
    return f"""<body name="{name}_upright" pos="{x} {y} {statics.wheel_height}">
      <joint name="{name}_suspension" type="slide" axis="0 0 1"
             stiffness="{spring}" damping="{damper}" springref="{statics.spring_reference}"
             limited="true" range="{-travel} {travel}"/>
      {_inertial(car.upright_mass, (0, 0, 0), (upright,) * 3)}
      {wheel}
    </body>"""


def _inertial(mass: float, centre: tuple[float, ...], moments: tuple[float, ...]) -> str:
    numbers = [" ".join(f"{value:.9g}" for value in values) for values in (centre, moments)]
    return f'<inertial mass="{mass:.9g}" pos="{numbers[0]}" diaginertia="{numbers[1]}"/>'


def load_model(scenario: Scenario, step: float) -> Any:
    """The car of a scenario as an `MjModel`."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]  # of the extra `bench`

    return mujoco.MjModel.from_xml_string(mjcf(scenario, step))


def commanded(scenario: Scenario, step: float) -> tuple[FloatArray, FloatArray]:
    """The published turn at every step: left and right knuckle (n, 2), rad, and the shaft's rate
    (n,), rad/s.

    Ramp, steering step through the linkage, straight again.
    """
    manoeuvre = scenario.manoeuvre
    servo = scenario.servo
    radius = axle_statics(scenario.car, scenario.environment.gravity, "rear").wheel_height
    times = np.arange(round(manoeuvre.duration / step)) * step
    begin = manoeuvre.turn_start
    travel = servo.rate * step
    angle = 0.0
    angles = []
    for turning in (begin <= times + 1e-9) & (times + 1e-9 < begin + manoeuvre.turn_hold):
        target = manoeuvre.steer_angle if turning else 0.0
        angle += min(max(target - angle, -travel), travel)
        angles.append(knuckle_motion(angle, 0.0, servo, scenario.car)[:2])
    return np.array(angles), manoeuvre.speed * np.minimum(
        1.0, times / manoeuvre.speed_ramp
    ) / radius


def flips_in_mujoco(scenario: Scenario, step: float) -> bool:
    """Whether the tilt passes 75 degrees; the run ends there."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]

    model = load_model(scenario, step)
    data = mujoco.MjData(model)
    cosine = math.cos(FLIP_TILT)
    for knuckles, rate in zip(*commanded(scenario, step), strict=True):
        data.ctrl[:2] = knuckles
        data.ctrl[2] = rate
        mujoco.mj_step(model, data)
        x = data.qpos[4]
        y = data.qpos[5]
        if 1.0 - 2.0 * (x * x + y * y) < cosine:
            return True
    return False
