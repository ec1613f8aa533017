"""What drives the plant of a car in one step: drive, steering, tail motors with their joints'
friction, and air.

One system calls all laws, since every system and every port that Python reads costs as much as a
law. The laws have one home each: `shaft_torque`, `servo_frame`, `steering_motion` and
`knuckle_motion` (chassis_actuators.py), `TailJoints` (ak70.py),
`SectionLaw.line_force` (aero/laws.py).
"""

import math
from collections.abc import Mapping
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
)
from pydrake.systems.primitives import ZeroOrderHold

from aerodima.workbench.aero.laws import LineMotion, cross, wind_direction
from aerodima.workbench.aero.sail import SailMotion, generalised_force, sail_motion
from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.car.ak70 import TailJoints
from aerodima.workbench.car.car_air import sail_strips
from aerodima.workbench.car.car_model import ROLLING_RATE, axle_statics, rolling_torques
from aerodima.workbench.car.car_plant import CarPlant
from aerodima.workbench.car.chassis_actuators import (
    knuckle_motion,
    servo_frame,
    shaft_gain,
    shaft_torque,
    steering_motion,
)
from aerodima.workbench.core.port_wiring import PortMux, PortSlice, constant, vector_of
from aerodima.workbench.core.system_lifetime import weak_callback
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import TAIL_COMMAND, WHEELS

TAIL_JOINTS = ("tail_pitch", "tail_roll", "tail_sail_turn")
TAIL_COMMANDS = ("tail_pitch_command", "tail_roll_command")


def _ranges(**sizes: int) -> dict[str, range]:
    """Where a vector has its parts, by their names."""
    ends = accumulate(sizes.values())
    return {
        name: range(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)
    }


MOTION = _ranges(
    quaternion=4, position=3, velocity=6, angles=3, rates=3, shaft_rate=1, wheel_rates=4
)
"""Motion of a car as one vector: of the chassis its quaternion w, x, y, z, position, m, and angular
velocity, rad/s, and velocity, m/s, in W; angles, rad, and rates, rad/s, of pitch, roll and sail
joint (0 where there are none); rate of the drive's shaft and of the `WHEELS`, rad/s."""
MOTION_SIZE = MOTION["wheel_rates"].stop

DRIVES = _ranges(
    shaft_torque=1,
    knuckles=4,
    frame=3,
    rolling=4,
    joint_torques=2,
    air_on_chassis=6,
    air_on_joints=3,
    motor_torques=2,
)
"""What drives the plant as one vector: torque on the shaft, N m; angles, rad, then rates, rad/s, of
left and right knuckle, and the servo's frame; rolling resistance of the `WHEELS`, N m; torques of
motor and friction together on pitch and roll joint, N m; of the air its moment on the chassis about
its origin, N m, and its force, N, in W, and its torques on pitch, roll and sail joint, N m; torques
of the tail motors alone, N m. Without a tail all behind the wheels is 0."""
DRIVES_SIZE = DRIVES["motor_torques"].stop

LAST = _ranges(stepped=1, velocity=6, rates=2, joint_torques=2, motor_torques=2, frame=3)
"""What is held of the plant's last step: 1, and 0 before the first one, then parts of `MOTION`, the
rates of pitch and roll joint alone, and of `DRIVES`."""
LAST_SIZE = LAST["frame"].stop


class CarDrives(LeafSystem):
    """What drives the plant, from the commands and its state.

    Input ports:
        inputs (n): `MOTION`, then `LAST`, then throttle: -1..1, and steering_angle: commanded
            bicycle steering angle, rad, positive to the left. With a tail, tail_pitch_command and
            tail_roll_command: position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m;
            a NaN gives no torque. In wind its velocity v_WA in W, m/s.
    Output ports:
        drives (25): see `DRIVES`.
        wind_direction (1): with a tail, of the sail's first line of sections, as
            `TailForce.wind_direction`, rad.

    Args:
        scenario: of the car.
        p_BoSo_B: where the tail's joint axes cross, in the chassis frame (3), m; None without a
            tail.
        windy: whether the air of its tail moves.
    """

    def __init__(self, scenario: Scenario, p_BoSo_B: np.ndarray | None, windy: bool) -> None:
        super().__init__()
        self.set_name("car_drives")
        self._scenario = scenario
        self._gain = shaft_gain(scenario.drive, scenario.car)
        self._radius = axle_statics(scenario.car, scenario.environment.gravity, "rear").wheel_height
        rolling = rolling_torques(scenario.car, scenario.environment.gravity)
        self._rolling = [rolling[wheel.split("_")[0]] for wheel in WHEELS]
        state = {**MOTION, **{f"last_{name}": place for name, place in LAST.items()}}
        sizes = {name: len(place) for name, place in state.items()} | {
            "throttle": 1,
            "steering_angle": 1,
        }
        if p_BoSo_B is not None:
            sizes |= dict.fromkeys(TAIL_COMMANDS, TAIL_COMMAND.size)
            if windy:
                sizes["wind_velocity"] = 3
        self._parts = {
            name: slice(place.start, place.stop) for name, place in _ranges(**sizes).items()
        }
        self._inputs = self.DeclareVectorInputPort("inputs", sum(sizes.values()))
        tickets = {self.time_ticket(), self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort(
            "drives", DRIVES_SIZE, weak_callback(self._calc), prerequisites_of_calc=tickets
        )
        self._p_BoSo_B = None
        if p_BoSo_B is not None:
            self._p_BoSo_B = p_BoSo_B.tolist()
            self._joints = TailJoints.of_scenario(scenario)
            self._lines = sail_strips(scenario.tail)
            inputs = {self.all_input_ports_ticket()}
            self.DeclareVectorOutputPort(
                "wind_direction", 1, weak_callback(self._calc_wind_direction), inputs
            )

    def _calc(self, context: Context, output: BasicVector) -> None:
        x = vector_of(self._inputs, context).tolist()
        scenario = self._scenario
        part = self._parts
        time = context.get_time()
        wheel_rates = x[part["wheel_rates"]]
        frame = x[part["last_frame"]]
        (shaft_rate,) = x[part["shaft_rate"]]
        (throttle,) = x[part["throttle"]]
        (command,) = x[part["steering_angle"]]
        rolling = [
            -most * math.tanh(w / ROLLING_RATE)
            for most, w in zip(self._rolling, wheel_rates, strict=True)
        ]
        torque = shaft_torque(
            throttle, shaft_rate, scenario.drive, self._gain, self._radius, -sum(rolling)
        )
        frame = servo_frame(
            frame if x[part["last_stepped"].start] else None, time, command, scenario.servo
        )
        angle, rate = steering_motion(frame, time, scenario.servo.rate)
        drives = [
            torque,
            *knuckle_motion(angle, rate, scenario.servo, scenario.car),
            *frame,
            *rolling,
        ]
        if self._p_BoSo_B is None:
            drives += [0.0] * (DRIVES_SIZE - len(drives))
        else:
            joints = self._joint_torques(x)
            drives += [motor + friction for motor, friction in joints]
            drives += self._air(x)
            drives += [motor for motor, _ in joints]
        output.SetFromVector(np.array(drives))

    def _joint_torques(self, x: list[float]) -> list[tuple[float, float]]:
        """Torque of the motor and of the friction on pitch and roll joint, N m."""
        part = self._parts
        rates = x[part["rates"]]
        (stepped,) = x[part["last_stepped"]]
        step = self._scenario.simulation.step
        changes = [
            stepped * (rate - old) / step
            for rate, old in zip(rates, x[part["last_rates"]], strict=False)
        ]
        commands = [x[part[name]] for name in TAIL_COMMANDS]
        return self._joints.torques(
            x[part["angles"]], rates, changes, x[part["last_joint_torques"]], commands
        )

    def _sail(self, x: list[float]) -> SailMotion:
        assert self._p_BoSo_B is not None
        part = self._parts
        angles = x[part["angles"]]
        rates = x[part["rates"]]
        return sail_motion(
            x[part["quaternion"]], x[part["velocity"]], angles, rates, self._p_BoSo_B
        )

    def _line(self, x: list[float], layout: SectionLayout, sail: SailMotion) -> LineMotion:
        """Motion of a line of sections against the air."""
        if "wind_velocity" in self._parts:
            wind = x[self._parts["wind_velocity"]]
        else:
            wind = None
        return layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind)

    def _air(self, x: list[float]) -> tuple[float, ...]:
        """Force of the air on the tail as in `generalised_force`."""
        sail = self._sail(x)
        density = self._scenario.environment.air_density
        fx = fy = fz = mx = my = mz = 0.0
        for layout, law in self._lines:
            line = self._line(x, layout, sail)
            gx, gy, gz, kx, ky, kz = law.line_force(line, layout.distances, layout.areas, density)
            if layout.p_BoRo_B != (0.0, 0.0, 0.0):
                dx, dy, dz = cross(layout.root_in(sail.R_WS), (gx, gy, gz))
                kx = kx + dx
                ky = ky + dy
                kz = kz + dz
            fx = fx + gx
            fy = fy + gy
            fz = fz + gz
            mx = mx + kx
            my = my + ky
            mz = mz + kz
        return generalised_force(sail, (fx, fy, fz), (mx, my, mz))

    def _calc_wind_direction(self, context: Context, output: BasicVector) -> None:
        x = vector_of(self._inputs, context).tolist()
        (layout, _) = self._lines[0]
        output[0] = wind_direction(
            self._line(x, layout, self._sail(x)), layout.distances, layout.areas
        )


class SampledHold(LeafSystem):
    """A `ZeroOrderHold` beside a plant that samples its output ports.

    Such a plant steps in an unrestricted update, and Drake makes these before any discrete one of
    the same instant.

    Args:
        period: s.
        size: of the vector that is held.
    """

    def __init__(self, period: float, size: int) -> None:
        super().__init__()
        self._input = self.DeclareVectorInputPort("input", size)
        self._held = self.DeclareDiscreteState(size)
        self.DeclareStateOutputPort("output", self._held)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._hold)

    def _hold(self, context: Context, state: State) -> None:
        state.get_mutable_discrete_state(int(self._held)).SetFromVector(
            vector_of(self._input, context)
        )


class DrivenCar(NamedTuple):
    """A plant with its `CarDrives`, to be cut by `PortMux`.

    Attributes:
        system: the drives.
        motion: elements of `MOTION`.
        last: port of `LAST`.
        zero: an element that is 0.
    """

    system: CarDrives
    motion: list[PortSlice]
    last: OutputPort
    zero: PortSlice

    def drive(self, part: str) -> PortSlice:
        """A part of `DRIVES`."""
        return self.system.GetOutputPort("drives"), DRIVES[part]

    def moves(self, part: str) -> list[PortSlice]:
        """A part of `MOTION`."""
        return [self.motion[index] for index in MOTION[part]]

    @property
    def chassis_motion(self) -> list[PortSlice]:
        """Motion of the chassis for its sensors, see `CHASSIS_MOTION_SIZE`."""
        before = (self.last, [*LAST["velocity"], *LAST["stepped"]])
        return [*self.motion[: MOTION["velocity"].stop], before]


def add_car_drives(
    builder: DiagramBuilder,
    mux: PortMux,
    scenario: Scenario,
    car: CarPlant,
    wind: OutputPort | None,
) -> DrivenCar:
    """Adds a `CarDrives` between the commands, which are inputs of `mux`, and the plant.

    Args:
        builder: that owns the plant.
        mux: of this builder.
        wind: v_WA in W (3), m/s; still air without it.
    """
    plant = car.plant
    p_BoSo_B = None
    if car.tail is not None:
        chassis = plant.GetFrameByName("chassis")
        sail = plant.GetFrameByName("tail_sail")
        X_BS = plant.CalcRelativeTransform(plant.CreateDefaultContext(), chassis, sail)
        p_BoSo_B = X_BS.translation()
    system = CarDrives(scenario, p_BoSo_B, wind is not None)
    builder.AddSystem(system)
    hold = SampledHold if plant.has_sampled_output_ports() else ZeroOrderHold
    last = builder.AddNamedSystem("last_step", hold(scenario.simulation.step, LAST_SIZE))
    constants = constant(builder, "zero_and_one", [0.0, 1.0])
    state = plant.get_state_output_port()
    zero = (constants, [0])
    one = (constants, [1])
    motion: list[PortSlice] = [
        zero if place is None else (state, [place]) for place in _motion_places(plant)
    ]
    driven = DrivenCar(system, motion, last.get_output_port(), zero)
    kept = [driven.drive(part) for part in ("joint_torques", "motor_torques", "frame")]
    mux.route(
        last.get_input_port(), one, *driven.moves("velocity"), *driven.moves("rates")[:2], *kept
    )
    inputs: list[PortSlice] = [*motion, driven.last, "throttle", "steering_angle"]
    if car.tail is not None:
        inputs += TAIL_COMMANDS
    if wind is not None:
        inputs.append(wind)
    mux.route(system.get_input_port(), *inputs)
    drives = system.GetOutputPort("drives")
    for port, rows in _driven_ports(car):
        mux.route(
            port, *((drives, [rows[row]]) if row in rows else zero for row in range(port.size()))
        )
    return driven


def _motion_places(plant: MultibodyPlant) -> list[int | None]:
    """Where the plant's state has the elements of `MOTION`; None for a joint that is not there."""
    chassis = plant.GetBodyByName("chassis")
    nq = plant.num_positions()
    q = chassis.floating_positions_start()
    v = nq + chassis.floating_velocities_start_in_v()
    joints = _tail_joints(plant)
    missing = [None] * (len(TAIL_JOINTS) - len(joints))
    angles = [joint.position_start() for joint in joints]
    rates = [nq + joint.velocity_start() for joint in joints]
    shaft = nq + plant.GetJointByName("drive_shaft_spin").velocity_start()
    wheels = [nq + start for start in _wheel_starts(plant)]
    return [*range(q, q + 7), *range(v, v + 6), *angles, *missing, *rates, *missing, shaft, *wheels]


def _wheel_starts(plant: MultibodyPlant) -> list[int]:
    return [plant.GetJointByName(f"{wheel}_spin").velocity_start() for wheel in WHEELS]


def _tail_joints(plant: MultibodyPlant) -> list[Joint]:
    """Pitch, roll and, of a free sail, its own joint; none without a tail."""
    joints = [plant.GetJointByName(name) for name in TAIL_JOINTS if plant.HasJointNamed(name)]
    return [joint for joint in joints if joint.num_velocities() > 0]


def _driven_ports(car: CarPlant) -> list[tuple[InputPort, Mapping[int, int]]]:
    """Input ports of the plant, each with its elements of the drives; the others are 0."""
    plant = car.plant
    names = car.actuated_joints
    count = len(names)
    steered = [names.index(f"front_{side}_steering") for side in ("left", "right")]
    torques = {_actuation_start(plant, "drive_shaft_spin"): DRIVES["shaft_torque"][0]}
    knuckles = zip(
        [*steered, *(count + index for index in steered)], DRIVES["knuckles"], strict=True
    )
    forces = dict(zip(_wheel_starts(plant), DRIVES["rolling"], strict=True))
    if car.tail is not None:
        starts = [_actuation_start(plant, name) for name in TAIL_JOINTS[:2]]
        torques |= zip(starts, DRIVES["joint_torques"], strict=True)
        v = plant.GetBodyByName("chassis").floating_velocities_start_in_v()
        forces |= zip(range(v, v + 6), DRIVES["air_on_chassis"], strict=True)
        joints = (joint.velocity_start() for joint in _tail_joints(plant))
        forces |= zip(joints, DRIVES["air_on_joints"], strict=False)
    return [
        (plant.get_actuation_input_port(), torques),
        (plant.get_desired_state_input_port(car.car), dict(knuckles)),
        (plant.get_applied_generalized_force_input_port(), forces),
    ]


def _actuation_start(plant: MultibodyPlant, joint: str) -> int:
    """Where the actuation of all actuators has that of a joint."""
    actuators = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    return next(
        int(actuator.input_start()) for actuator in actuators if actuator.joint().name() == joint
    )
