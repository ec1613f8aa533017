"""What drives the plant of a car in one step: drive, steering, tail motors with their joints' friction, and air.

One system calls all laws, since every system and every port that Python reads costs as much as a law. The laws have
one home each: `shaft_torque`, `steering_motion` and `knuckle_motion` (actuators/chassis_actuators.py), `TailJoints`
(actuators/ak70.py), `SectionLaw.line_force` (aero/laws.py).
"""

import math
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, InputPort, LeafSystem, OutputPort, State
from pydrake.systems.primitives import Multiplexer, ZeroOrderHold

from aerodima.workbench.actuators.ak70 import TailJoints
from aerodima.workbench.actuators.chassis_actuators import knuckle_motion, shaft_gain, shaft_torque, steering_motion
from aerodima.workbench.aero.laws import cross, wind_direction
from aerodima.workbench.aero.sail import SailMotion, generalised_force, sail_motion
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import TAIL_COMMAND, WHEELS
from aerodima.workbench.plants.car import CarPlant
from aerodima.workbench.plants.car_model import ROLLING_RATE, axle_statics, rolling_torques
from aerodima.workbench.stations.car_air import sail_strips
from aerodima.workbench.systems.system_ports import constant, select, stacked, transformed, vector_of

TAIL_JOINTS = ("tail_pitch", "tail_roll", "tail_sail_turn")
TAIL_COMMANDS = ("tail_pitch_command", "tail_roll_command")


def _ranges(**sizes: int) -> dict[str, range]:
    """Where a vector has its parts, by their names."""
    ends = accumulate(sizes.values())
    return {name: range(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


MOTION = _ranges(quaternion=4, position=3, velocity=6, angles=3, rates=3, shaft_rate=1, wheel_rates=4)
"""Motion of a car as one vector: of the chassis its quaternion w, x, y, z, position, m, and angular velocity, rad/s,
and velocity, m/s, in W; angles, rad, and rates, rad/s, of pitch, roll and sail joint (0 where there are none); rate of
the drive's shaft and of the `WHEELS`, rad/s."""
MOTION_SIZE = MOTION["wheel_rates"].stop

DRIVES = _ranges(
    shaft_torque=1, knuckles=4, rolling=4, joint_torques=2, air_on_chassis=6, air_on_joints=3, motor_torques=2
)
"""What drives the plant as one vector: torque on the shaft, N m; angles, rad, then rates, rad/s, of left and right
knuckle; rolling resistance of the `WHEELS`, N m; torques of motor and friction together on pitch and roll joint, N m;
of the air its moment on the chassis about its origin, N m, and its force, N, in W, and its torques on pitch, roll and
sail joint, N m; torques of the tail motors alone, N m. Without a tail all behind the wheels is 0."""
DRIVES_SIZE = DRIVES["motor_torques"].stop


class CarMotion(NamedTuple):
    """The parts of `MOTION`."""

    quaternion: list[float]
    position: list[float]
    velocity: list[float]
    angles: list[float]
    rates: list[float]
    shaft_rate: float
    wheel_rates: list[float]

    @classmethod
    def of(cls, x: list[float]) -> "CarMotion":
        """The motion in a vector that begins with `MOTION`."""
        return cls(x[:4], x[4:7], x[7:13], x[13:16], x[16:19], x[19], x[20:24])


class CarDrives(LeafSystem):
    """What drives the plant, from the commands and its state.

    Input ports:
        inputs (n): the parts of `input_ranges`. motion: see `MOTION`. throttle: -1..1. frame: of the `SteeringServo`.
            With a tail, last: 1 once the plant has stepped and 0 before, then motion and drives at its last step;
            tail_pitch_command, tail_roll_command: position rad, velocity rad/s, kp N m/rad, kd N m s/rad, torque N m,
            a NaN gives no torque; wind_velocity: v_WA in W, m/s.
    Output ports:
        drives (22): see `DRIVES`.
        wind_direction (1): with a tail, of the sail's first line of sections, as `TailForce.wind_direction`, rad.

    Args:
        scenario: of the car.
        p_BoSo_B: where the tail's joint axes cross, in the chassis frame (3), m; None without a tail.
    """

    def __init__(self, scenario: Scenario, p_BoSo_B: np.ndarray | None) -> None:
        super().__init__()
        self.set_name("car_drives")
        self._scenario = scenario
        self._gain = shaft_gain(scenario.drive, scenario.car)
        self._radius = axle_statics(scenario.car, scenario.environment.gravity, "rear").wheel_height
        rolling = rolling_torques(scenario.car, scenario.environment.gravity)
        self._rolling = [rolling[wheel.split("_")[0]] for wheel in WHEELS]
        sizes = {"motion": MOTION_SIZE, "throttle": 1, "frame": 3}
        if p_BoSo_B is not None:
            sizes["last"] = 1 + MOTION_SIZE + DRIVES_SIZE
            sizes |= dict.fromkeys(TAIL_COMMANDS, TAIL_COMMAND.size) | {"wind_velocity": 3}
        self.input_ranges = _ranges(**sizes)
        self._parts = {name: slice(place.start, place.stop) for name, place in self.input_ranges.items()}
        self._inputs = self.DeclareVectorInputPort("inputs", sum(sizes.values()))
        tickets = {self.time_ticket(), self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("drives", DRIVES_SIZE, self._calc, prerequisites_of_calc=tickets)
        self._p_BoSo_B = None if p_BoSo_B is None else p_BoSo_B.tolist()
        if p_BoSo_B is not None:
            self._joints, self._lines = TailJoints.of_scenario(scenario), sail_strips(scenario.tail)
            inputs = {self.all_input_ports_ticket()}
            self.DeclareVectorOutputPort("wind_direction", 1, self._calc_wind_direction, prerequisites_of_calc=inputs)

    def _calc(self, context: Context, output: BasicVector) -> None:
        x, scenario = vector_of(self._inputs, context).tolist(), self._scenario
        now, (throttle,), frame = CarMotion.of(x), x[self._parts["throttle"]], x[self._parts["frame"]]
        rolling = [-most * math.tanh(w / ROLLING_RATE) for most, w in zip(self._rolling, now.wheel_rates, strict=True)]
        torque = shaft_torque(throttle, now.shaft_rate, scenario.drive, self._gain, self._radius, -sum(rolling))
        angle, rate = steering_motion(frame, context.get_time(), scenario.servo.rate)
        drives = [torque, *knuckle_motion(angle, rate, scenario.servo, scenario.car), *rolling]
        if self._p_BoSo_B is None:
            drives += [0.0] * (DRIVES_SIZE - len(drives))
        else:
            joints = self._joint_torques(now, x)
            drives += [motor + friction for motor, friction in joints]
            drives += self._air(now, x[self._parts["wind_velocity"]])
            drives += [motor for motor, _ in joints]
        output.SetFromVector(np.array(drives))

    def _joint_torques(self, now: CarMotion, x: list[float]) -> list[tuple[float, float]]:
        """Torque of the motor and of the friction on pitch and roll joint, N m."""
        stepped, *last = x[self._parts["last"]]
        before, torques = CarMotion.of(last), last[MOTION_SIZE:]
        step = self._scenario.simulation.step
        accelerations = [stepped * (rate - old) / step for rate, old in zip(now.rates, before.rates, strict=True)]
        place = DRIVES["joint_torques"]
        commands = [x[self._parts[name]] for name in TAIL_COMMANDS]
        return self._joints.torques(now.angles, now.rates, accelerations, torques[place.start : place.stop], commands)

    def _sail(self, now: CarMotion) -> SailMotion:
        assert self._p_BoSo_B is not None
        return sail_motion(now.quaternion, now.velocity, now.angles, now.rates, self._p_BoSo_B)

    def _air(self, now: CarMotion, wind: list[float]) -> tuple[float, ...]:
        """Force of the air on the tail as in `generalised_force`."""
        sail, density = self._sail(now), self._scenario.environment.air_density
        fx = fy = fz = mx = my = mz = 0.0
        for layout, law in self._lines:
            line = layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, wind)
            gx, gy, gz, kx, ky, kz = law.line_force(line, layout.distances, layout.areas, density)
            if layout.p_BoRo_B != (0.0, 0.0, 0.0):
                dx, dy, dz = cross(layout.root_in(sail.R_WS), (gx, gy, gz))
                kx, ky, kz = kx + dx, ky + dy, kz + dz
            fx, fy, fz, mx, my, mz = fx + gx, fy + gy, fz + gz, mx + kx, my + ky, mz + kz
        return generalised_force(sail, (fx, fy, fz), (mx, my, mz))

    def _calc_wind_direction(self, context: Context, output: BasicVector) -> None:
        x = vector_of(self._inputs, context).tolist()
        sail, (layout, _) = self._sail(CarMotion.of(x)), self._lines[0]
        line = layout.motion(sail.R_WS, sail.w_WS, sail.v_WSo, x[self._parts["wind_velocity"]])
        output[0] = wind_direction(line, layout.distances, layout.areas)


class SampledHold(LeafSystem):
    """A `ZeroOrderHold` beside a plant that samples its output ports.

    Such a plant steps in an unrestricted update, and Drake makes these before any discrete one of the same instant.

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
        state.get_mutable_discrete_state(int(self._held)).SetFromVector(vector_of(self._input, context))


class DrivenCar(NamedTuple):
    """A plant with its `CarDrives`.

    Attributes:
        system: the drives.
        commands: input ports by name, `throttle` and those of the tail, that are left to the caller.
        motion, last: ports that feed its inputs of that name.
    """

    system: CarDrives
    commands: dict[str, InputPort]
    motion: OutputPort
    last: OutputPort

    def drive(self, builder: DiagramBuilder, name: str, part: str) -> OutputPort:
        """A port with a part of `DRIVES`; adds one system of that name."""
        return select(builder, name, self.system.GetOutputPort("drives"), DRIVES[part])

    def last_drive(self, builder: DiagramBuilder, name: str, part: str) -> OutputPort:
        """The same at the plant's last step."""
        return select(builder, name, self.last, [1 + MOTION_SIZE + index for index in DRIVES[part]])

    def chassis_motion(self, builder: DiagramBuilder) -> OutputPort:
        """Motion of the chassis for its sensors, see `chassis_motion`."""
        both, before = stacked(builder, "motion_now_and_before", [self.motion, self.last]), MOTION_SIZE + 1
        old = [before + index for index in MOTION["velocity"]]
        return select(builder, "chassis_motion", both, [*range(MOTION["velocity"].stop), *old, MOTION_SIZE])


def add_car_drives(
    builder: DiagramBuilder, scenario: Scenario, car: CarPlant, frame: OutputPort, wind: OutputPort | None
) -> DrivenCar:
    """Adds a `CarDrives` and wires it to the plant.

    Args:
        builder: that owns the plant.
        frame: port of the `SteeringServo`.
        wind: v_WA in W (3), m/s; still air without it.
    """
    plant, p_BoSo_B = car.plant, None
    if car.tail is not None:
        chassis, sail = (plant.GetFrameByName(name) for name in ("chassis", "tail_sail"))
        p_BoSo_B = plant.CalcRelativeTransform(plant.CreateDefaultContext(), chassis, sail).translation()
        wind = wind or constant(builder, "still_air", [0.0, 0.0, 0.0])
    system = CarDrives(scenario, p_BoSo_B)
    builder.AddSystem(system)
    drives = system.GetOutputPort("drives")
    motion = transformed(builder, "motion", plant.get_state_output_port(), _motion_of_state(plant))
    this_step = stacked(builder, "this_step", [constant(builder, "has_stepped", [1.0]), motion, drives])
    hold = SampledHold if plant.has_sampled_output_ports() else ZeroOrderHold
    last = builder.AddNamedSystem("last_step", hold(scenario.simulation.step, this_step.size()))
    builder.Connect(this_step, last.get_input_port())
    sources = {"motion": motion, "frame": frame, "last": last.get_output_port(), "wind_velocity": wind}
    inputs = builder.AddNamedSystem("drives_inputs", Multiplexer([len(part) for part in system.input_ranges.values()]))
    builder.Connect(inputs.get_output_port(), system.get_input_port())
    ports = {name: inputs.get_input_port(index) for index, name in enumerate(system.input_ranges)}
    for name, source in sources.items():
        if source is not None and name in ports:
            builder.Connect(source, ports[name])
    for name, driven, place in _driven_ports(car):
        builder.Connect(transformed(builder, name, drives, place), driven)
    commands = {name: port for name, port in ports.items() if name not in sources}
    return DrivenCar(system, commands, motion, last.get_output_port())


def _motion_of_state(plant: MultibodyPlant) -> np.ndarray:
    """Matrix (20, n) from the plant's state to `MOTION`."""
    chassis, nq = plant.GetBodyByName("chassis"), plant.num_positions()
    q, v = chassis.floating_positions_start(), nq + chassis.floating_velocities_start_in_v()
    place = np.zeros((MOTION_SIZE, plant.num_multibody_states()))
    place[range(13), [*range(q, q + 7), *range(v, v + 6)]] = 1.0
    for index, joint in enumerate(_tail_joints(plant)):
        place[MOTION["angles"][index], joint.position_start()] = 1.0
        place[MOTION["rates"][index], nq + joint.velocity_start()] = 1.0
    place[MOTION["shaft_rate"][0], nq + plant.GetJointByName("drive_shaft_spin").velocity_start()] = 1.0
    for index, start in enumerate(_wheel_starts(plant)):
        place[MOTION["wheel_rates"][index], nq + start] = 1.0
    return place


def _wheel_starts(plant: MultibodyPlant) -> list[int]:
    return [plant.GetJointByName(f"{wheel}_spin").velocity_start() for wheel in WHEELS]


def _tail_joints(plant: MultibodyPlant) -> list[Joint]:
    """Pitch, roll and, of a free sail, its own joint; none without a tail."""
    joints = [plant.GetJointByName(name) for name in TAIL_JOINTS if plant.HasJointNamed(name)]
    return [joint for joint in joints if joint.num_velocities() > 0]


def _driven_ports(car: CarPlant) -> list[tuple[str, InputPort, np.ndarray]]:
    """Input ports of the plant, each with a name and the matrix from the drives to it."""
    plant, names = car.plant, car.actuated_joints
    count, steered = len(names), [names.index(f"front_{side}_steering") for side in ("left", "right")]
    torques, knuckles = np.zeros((plant.num_actuators(), DRIVES_SIZE)), np.zeros((2 * count, DRIVES_SIZE))
    torques[_actuation_start(plant, "drive_shaft_spin"), DRIVES["shaft_torque"]] = 1.0
    knuckles[[*steered, *(count + index for index in steered)], DRIVES["knuckles"]] = 1.0
    forces = np.zeros((plant.num_velocities(), DRIVES_SIZE))
    forces[_wheel_starts(plant), DRIVES["rolling"]] = 1.0
    if car.tail is not None:
        torques[[_actuation_start(plant, name) for name in TAIL_JOINTS[:2]], DRIVES["joint_torques"]] = 1.0
        v = plant.GetBodyByName("chassis").floating_velocities_start_in_v()
        forces[range(v, v + 6), DRIVES["air_on_chassis"]] = 1.0
        for index, joint in enumerate(_tail_joints(plant)):
            forces[joint.velocity_start(), DRIVES["air_on_joints"][index]] = 1.0
    return [
        ("actuation", plant.get_actuation_input_port(), torques),
        ("desired_steering", plant.get_desired_state_input_port(car.car), knuckles),
        ("applied_force", plant.get_applied_generalized_force_input_port(), forces),
    ]


def _actuation_start(plant: MultibodyPlant, joint: str) -> int:
    """Where the actuation of all actuators has that of a joint."""
    actuators = (plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices())
    return next(int(actuator.input_start()) for actuator in actuators if actuator.joint().name() == joint)
