"""The tailless car as MJCF and its turn in MuJoCo, for the benchmark: the same masses, springs,
edges of the tyres and commands as in Drake.

Its tyres are those of Drake, as forces that are applied (`Tyres`), or MuJoCo's own contacts. These
have the stiffness, damping and cornering stiffness that Drake's have at rest, but keep them
whatever the load, and their friction is whole as soon as a tyre slides. Cage and board have no
contact: a run ends when the car has passed 75 degrees.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from aerodima.workbench.car.car_model import (
    EDGE_HALF_WIDTH,
    SHAFT_MASS,
    SHAFT_RADIUS,
    axle_statics,
    board_centre,
    chassis_inertial,
    gearbox_height,
    stiction_tolerance,
    wheel_rates,
)
from aerodima.workbench.car.laws import knuckle_motion, shaft_gain
from aerodima.workbench.car.termination import quaternion_flipped
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.scenario import Scenario

EDGES = ("left", "right")
"""Edges of a tyre."""
IMPEDANCE = 1e-3
"""Of a tyre's own contact: the smaller, the less mass the contact adds to the wheel."""
FRICTION_RATIO = 10.0
"""Impedance of friction over that of the normal force. With a small one the normal force of a tyre
that slides grows with its slip (MuJoCo projects on its friction cone in a metric that this ratio
sets)."""
SUBSTEP = 2.5e-4
"""Longest step with applied tyre forces, s. They act explicitly, on wheels that are light to
spin."""


def mjcf(scenario: Scenario, step: float, own_contact: bool) -> str:
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
    parts = [_board_and_shaft(scenario)]
    knuckles = []
    edges = []
    for axle in ("front", "rear"):
        for side, sign in (("left", 1), ("right", -1)):
            parts.append(_corner(scenario, axle, side, sign))
            edges += [f"{axle}_{side}_{edge}" for edge in EDGES]
            if axle == "front":
                knuckles.append(
                    f'<position name="{side}" joint="front_{side}_steering" kp="{servo.stiffness}" '
                    f'kv="{servo.damping}" forcerange="{-servo.torque_limit} '
                    f'{servo.torque_limit}"/>'
                )
    friction = f"{car.tyre_friction} " * 2 + "0 0 0"
    pairs = "".join(
        f'<pair geom1="ground" geom2="{edge}" condim="3" friction="{friction}"/>' for edge in edges
    )
    return f"""<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option timestep="{step}" gravity="0 0 {-gravity}" integrator="implicitfast" cone="elliptic"
          impratio="{FRICTION_RATIO}"/>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1" contype="0" conaffinity="0"/>
    <body name="chassis">
      <freejoint/>
      {_inertial(chassis.mass, chassis.com, chassis.moments)}
      <body pos="{car.gearbox_x} 0 {gearbox_height(car, tail)}">
        {_inertial(car.gearbox_mass, (0, 0, 0), (m * (w + h), m * (length + h), m * (length + w)))}
      </body>
      {"".join(parts)}
    </body>
  </worldbody>
  <contact>{pairs if own_contact else ""}</contact>
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


def _board_and_shaft(scenario: Scenario) -> str:
    car = scenario.car
    rear = axle_statics(car, scenario.environment.gravity, "rear")
    ball = (0.4 * SHAFT_MASS * SHAFT_RADIUS**2,) * 3
    shaft = f'<body pos="0 0 {rear.wheel_height}">{_inertial(SHAFT_MASS, (0, 0, 0), ball)}</body>'
    if not car.board:
        return shaft
    m = car.board_mass / 12
    length = car.board_length**2
    w = car.board_width**2
    h = car.board_thickness**2
    moments = (m * (w + h), m * (length + h), m * (length + w))
    x, z = board_centre(car)
    return f'{shaft}<body pos="{x} 0 {z}">{_inertial(car.board_mass, (0, 0, 0), moments)}</body>'


def _corner(scenario: Scenario, axle: str, side: str, sign: int) -> str:
    car = scenario.car
    statics = axle_statics(car, scenario.environment.gravity, axle)
    front = axle == "front"
    name = f"{axle}_{side}"
    spring, damper = wheel_rates(car, axle)
    radius = car.tyre_radius
    diametral = car.wheel_mass * (3 * radius**2 + car.tyre_width**2) / 12
    upright = 0.4 * car.upright_mass * 0.03**2
    knuckle = 0.4 * car.knuckle_mass * 0.02**2
    reach = 0.5 * car.tyre_width - EDGE_HALF_WIDTH
    geoms = "".join(
        f'<geom name="{name}_{edge}" type="ellipsoid" pos="0 {y} 0" '
        f'size="{radius} {EDGE_HALF_WIDTH} {radius}" contype="0" conaffinity="0"/>'
        for edge, y in zip(EDGES, (reach, -reach), strict=True)
    )
    wheel = f"""<body name="{name}_wheel">
        <joint name="{name}_spin" type="hinge" axis="0 1 0"/>
        {
        _inertial(
            car.wheel_mass, (0, 0, 0), (diametral, 0.5 * car.wheel_mass * radius**2, diametral)
        )
    }
        {geoms}
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


def load_model(scenario: Scenario, step: float, own_contact: bool) -> Any:
    """Makes the car of a scenario as an `MjModel`."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]  # of the extra `bench`

    model = mujoco.MjModel.from_xml_string(mjcf(scenario, step, own_contact))
    for pair in range(model.npair):
        geom = model.geom(model.pair_geom2[pair])
        edge = edge_law(scenario, geom.name.startswith("front"))
        # MuJoCo scales what it is given by the inverse mass of the wheel at rest.
        scale = (1.0 - IMPEDANCE) * model.body_invweight0[geom.bodyid[0], 0]
        model.pair_solimp[pair, :2] = IMPEDANCE
        model.pair_solref[pair] = -scale * edge.stiffness, -scale * edge.damping
        slope = scenario.car.tyre_friction * edge.load / edge.slip_speed
        model.pair_solreffriction[pair] = -1e-9, -scale * slope / FRICTION_RATIO
    return model


@dataclass(frozen=True)
class EdgeLaw:
    """One edge of a tyre at rest: load (N), stiffness (N/m), damping (N s/m), and the slip over
    which its friction is spread (m/s).
    """

    load: float
    stiffness: float
    damping: float
    slip_speed: float


def edge_law(scenario: Scenario, front: bool) -> EdgeLaw:
    """Returns the law of one edge of a tyre of an axle."""
    car = scenario.car
    axle = "front" if front else "rear"
    load = axle_statics(car, scenario.environment.gravity, axle).wheel_load / len(EDGES)
    tyre = car.tyre_stiffness_front if front else car.tyre_stiffness_rear
    slip = stiction_tolerance(car, scenario.manoeuvre.speed)
    return EdgeLaw(load, tyre / len(EDGES), load * car.tyre_dissipation, slip)


class Tyres:
    """Drake's law of the eight edges, as forces on the wheels: k x (1 + d x') of each, and friction
    that rises with the slip as v / sqrt(v^2 + `slip_speed`^2).
    """

    def __init__(self, scenario: Scenario, model: Any) -> None:
        car = scenario.car
        geoms = [g for g in map(model.geom, range(model.ngeom)) if g.name != "ground"]
        laws = [edge_law(scenario, geom.name.startswith("front")) for geom in geoms]
        self._bodies = np.array([geom.bodyid[0] for geom in geoms])
        self._geoms = np.array([geom.id for geom in geoms])
        self._roots = model.body_rootid[self._bodies]
        self._squares = model.geom_size[self._geoms[0]] ** 2
        self._stiffness = np.array([law.stiffness for law in laws])
        self._slip_speed = laws[0].slip_speed
        self._friction = car.tyre_friction
        self._dissipation = car.tyre_dissipation

    def apply(self, data: Any) -> None:
        """Sets the forces of a state, between `mj_step1` and `mj_step2`."""
        bodies = self._bodies
        rotations = data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        down = -rotations[:, 2, :]  # in the frames of the ellipsoids
        lever = self._squares * down
        lever /= np.sqrt(np.sum(lever * down, axis=1))[:, None]
        points = data.geom_xpos[self._geoms] + np.einsum("nij,nj->ni", rotations, lever)
        depth = -points[:, 2]
        points[:, 2] = 0.0  # rigid ground
        spatial = data.cvel[bodies]
        from_root = points - data.subtree_com[self._roots]
        velocity = spatial[:, 3:] + np.cross(spatial[:, :3], from_root)
        load = self._stiffness * depth * (1.0 - self._dissipation * velocity[:, 2])
        load = np.where(depth > 0.0, np.maximum(load, 0.0), 0.0)
        slip = velocity[:, :2]
        spread = np.sqrt(np.sum(slip**2, axis=1) + self._slip_speed**2)
        forces = np.column_stack([-(self._friction * load / spread)[:, None] * slip, load])
        moments = np.cross(points - data.xipos[bodies], forces)
        data.xfrc_applied[:] = 0.0
        np.add.at(data.xfrc_applied, bodies, np.hstack([forces, moments]))


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


def drive_in_mujoco(scenario: Scenario, step: float, own_contact: bool) -> Iterator[Any]:
    """Drives the turn; yields the `MjData` after every step."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]

    steps = 1 if own_contact else math.ceil(step / SUBSTEP - 1e-9)
    model = load_model(scenario, step / steps, own_contact)
    data = mujoco.MjData(model)
    tyres = Tyres(scenario, model)
    for knuckles, rate in zip(*commanded(scenario, step), strict=True):
        data.ctrl[:2] = knuckles
        data.ctrl[2] = rate
        for _ in range(steps):
            mujoco.mj_step1(model, data)
            if not own_contact:
                tyres.apply(data)
            mujoco.mj_step2(model, data)
        yield data


def flips_in_mujoco(scenario: Scenario, step: float, own_contact: bool) -> bool:
    """Returns whether the tilt passes 75 degrees; the run ends there."""
    return any(
        quaternion_flipped(data.qpos[3:7]) for data in drive_in_mujoco(scenario, step, own_contact)
    )
