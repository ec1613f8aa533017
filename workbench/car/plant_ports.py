"""Inputs and outputs of the car's plant in a step, as named vectors.

Drake decides where the parts of the plant's own vectors are. Two `Selector`s know these places:
`motion` cuts the state into the parts that drives and sensors read, `plant_inputs` puts torques and
forces together. A third system holds what the drives need from the last step.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
)
from pydrake.systems.primitives import ZeroOrderHold

from aerodima.workbench.car.ak70 import TAIL_JOINTS
from aerodima.workbench.car.car_plant import CarPlant
from aerodima.workbench.core.port_wiring import PortSlice, add_selector, constant, vector_of
from aerodima.workbench.scenario.signal_table import TAIL_STATE, WHEELS

STEPPED = range(1)
"""Place in `last_step` of a 1, which is 0 before the first step."""
LAST_VELOCITY = range(1, 7)
"""Place in `last_step` of angular velocity, rad/s, and velocity, m/s, of the chassis in W."""
LAST_RATES = range(7, 9)
"""Place in `last_step` of the rates of pitch and roll joint, rad/s."""
LAST_JOINT_TORQUES = range(9, 11)
"""Place in `last_step` of the torques of motor and friction together on these joints, N m."""
LAST_MOTOR_TORQUES = range(11, 13)
"""Place in `last_step` of the torques of the tail motors alone, N m."""
LAST_FRAME = range(13, 16)
"""Place in `last_step` of the frame of the steering servo."""


class SampledHold(LeafSystem):
    """A `ZeroOrderHold` beside a plant that samples its output ports.

    Such a plant steps in an unrestricted update, and Drake makes these before any discrete one of
    the same instant.

    Args:
        period: time between two updates, s.
        size: size of the vector that is held.
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


class PlantPorts:
    """Ports of a car's plant by the parts of their vectors.

    The systems are `last_step`, `motion` and `plant_inputs`.

    Args:
        builder: builder of the diagram that holds the plant.
        car: car with its plant.

    Attributes:
        last_step: port (16) of the values held from the last step; its parts are named above.
        zero: element of a port that is 0.
    """

    def __init__(self, builder: DiagramBuilder, car: CarPlant) -> None:
        self._builder = builder
        self._car = car
        plant = car.plant
        if plant.has_sampled_output_ports():
            hold: Any = SampledHold
        else:
            hold = ZeroOrderHold
        self._hold = builder.AddNamedSystem("last_step", hold(plant.time_step(), LAST_FRAME.stop))
        self.last_step = self._hold.get_output_port()
        constants = constant(builder, "zero_and_one", [0.0, 1.0])
        self.zero: PortSlice = (constants, [0])
        self._one: PortSlice = (constants, [1])
        self._motion = add_selector(builder, "motion", self._parts())

    def motion(self, part: str) -> OutputPort:
        """Returns a part of the motion as a port.

        chassis_motion (20): see `CHASSIS_MOTION_SIZE`; velocity (6): angular velocity, rad/s, and
        velocity, m/s, of the chassis in W; spins (5): rates of shaft and `WHEELS`, rad/s;
        last_frame (4): 1, or 0 before the first step, and the servo's frame. With a tail,
        tail_joints (4): angles, rad, then rates, rad/s, of pitch and roll; tail_rates (2): the
        rates alone; <joint>_state (2): angle and rate of one of `TAIL_JOINTS`; <joint>_motion (6):
        see `TailMotor`; tail_motion (16): see `TailAerodynamics`; sail_turn (1): angle of the
        sail's joint, rad; last_tail_torque (2): torques of the motors in the last step, N m.
        Without a tail, tail_torque (2) and tail_state (6), which are 0.
        """
        return self._motion.GetOutputPort(part)

    def _parts(self) -> dict[str, list[PortSlice]]:
        plant = self._car.plant
        state = plant.get_state_output_port()
        last = self.last_step
        nq = plant.num_positions()
        chassis = plant.GetBodyByName("chassis")
        q = chassis.floating_positions_start()
        v = nq + chassis.floating_velocities_start_in_v()
        shaft = plant.GetJointByName("drive_shaft_spin").velocity_start()
        spins = [nq + start for start in (shaft, *_wheel_starts(plant))]
        velocity: PortSlice = (state, range(v, v + 6))
        parts: dict[str, list[PortSlice]] = {
            "chassis_motion": [
                (state, range(q, q + 7)),
                velocity,
                (last, LAST_VELOCITY),
                (last, STEPPED),
            ],
            "velocity": [velocity],
            "spins": [(state, spins)],
            "last_frame": [(last, STEPPED), (last, LAST_FRAME)],
        }
        if self._car.tail is None:
            parts["tail_torque"] = [self.zero] * len(TAIL_JOINTS)
            parts["tail_state"] = [self.zero] * TAIL_STATE.size
            return parts
        parts["last_tail_torque"] = [(last, LAST_MOTOR_TORQUES)]
        joints = _tail_joints(plant)
        angles: list[PortSlice] = [(state, [place]) for place, _ in joints]
        rates: list[PortSlice] = [(state, [nq + place]) for _, place in joints]
        for index, joint in enumerate(TAIL_JOINTS):
            parts[f"{joint}_state"] = [angles[index], rates[index]]
            parts[f"{joint}_motion"] = [
                angles[index],
                rates[index],
                (last, STEPPED),
                (last, [LAST_RATES[index]]),
                (last, [LAST_JOINT_TORQUES[index]]),
                angles[1],
            ]
        parts["tail_joints"] = [*angles[:2], *rates[:2]]
        parts["tail_rates"] = rates[:2]
        if len(joints) == 2:  # a locked sail
            angles.append(self.zero)
            rates.append(self.zero)
        parts["sail_turn"] = angles[2:]
        parts["tail_motion"] = [(state, range(q, q + 4)), velocity, *angles, *rates]
        return parts

    def drive(
        self,
        torques: OutputPort,
        steering: OutputPort,
        motor_torques: OutputPort | None = None,
        joint_torques: OutputPort | None = None,
        air: OutputPort | None = None,
    ) -> None:
        """Connects the plant's inputs to what drives it, and holds what the next step needs.

        Args:
            torques: port of a `DriveTrain`.
            steering: port of a `SteeringServo`.
            motor_torques: port of the motor torques on pitch and roll, N m; only with a tail, as
                the ports that follow.
            joint_torques: port of the torques of motor and friction together, N m.
            air: port `force` of `TailAerodynamics`.
        """
        car = self._car
        plant = car.plant
        names = plant.GetActuatorNames(car.car)
        steered = [names.index(f"front_{side}_steering") for side in ("left", "right")]
        knuckles = [*steered, *(len(names) + index for index in steered)]
        actuation = {_actuation_start(plant, "drive_shaft_spin"): (torques, [0])}
        wanted = {place: (steering, [row]) for row, place in enumerate(knuckles)}
        forces = {start: (torques, [1 + wheel]) for wheel, start in enumerate(_wheel_starts(plant))}
        held: list[PortSlice] = [self._one, self.motion("velocity")]
        if motor_torques is None or joint_torques is None or air is None:
            held += [self.zero] * 6
        else:
            for row, joint in enumerate(TAIL_JOINTS):
                actuation[_actuation_start(plant, joint)] = (joint_torques, [row])
            v = plant.GetBodyByName("chassis").floating_velocities_start_in_v()
            places = [*range(v, v + 6), *(place for _, place in _tail_joints(plant))]
            forces |= {place: (air, [row]) for row, place in enumerate(places)}
            held += [self.motion("tail_rates"), joint_torques, motor_torques]
        held.append((steering, range(4, 7)))
        targets: dict[str, tuple[InputPort, Sequence[PortSlice]]] = {
            "actuation": self._filled(plant.get_actuation_input_port(), actuation),
            "desired_state": self._filled(plant.get_desired_state_input_port(car.car), wanted),
            "generalized_force": self._filled(
                plant.get_applied_generalized_force_input_port(), forces
            ),
            "last_step": (self._hold.get_input_port(), held),
        }
        outputs = {name: parts for name, (_, parts) in targets.items()}
        inputs = add_selector(self._builder, "plant_inputs", outputs)
        for name, (port, _) in targets.items():
            self._builder.Connect(inputs.GetOutputPort(name), port)

    def _filled(
        self, port: InputPort, elements: Mapping[int, PortSlice]
    ) -> tuple[InputPort, list[PortSlice]]:
        """Lists the parts of an input port: these elements at their places, 0 at all others."""
        return port, [elements.get(place, self.zero) for place in range(port.size())]


def tail_rate_places(plant: MultibodyPlant) -> list[int]:
    """Returns the places of the rates of `TAIL_JOINTS` in the plant's state [q; v]."""
    joints = [plant.GetJointByName(name) for name in TAIL_JOINTS]
    return [plant.num_positions() + joint.velocity_start() for joint in joints]


def _wheel_starts(plant: MultibodyPlant) -> list[int]:
    return [int(plant.GetJointByName(f"{wheel}_spin").velocity_start()) for wheel in WHEELS]


def _tail_joints(plant: MultibodyPlant) -> list[tuple[int, int]]:
    """Returns the places of angle and rate of pitch, roll and, with a free sail, its joint."""
    joints = [plant.GetJointByName(name) for name in (*TAIL_JOINTS, "tail_sail_turn")]
    return [
        (int(joint.position_start()), int(joint.velocity_start()))
        for joint in joints
        if joint.num_velocities() > 0
    ]


def _actuation_start(plant: MultibodyPlant, joint: str) -> int:
    """Returns the place of a joint's actuation among that of all actuators."""
    return int(plant.GetJointActuatorByName(joint).input_start())
