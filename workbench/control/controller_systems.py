"""Tail controller and driver of a car as Drake systems.

Each samples the station's signals at its rate, runs a law on them and holds its outputs until the
next tick. The law of the driver is a schedule in most manoeuvres.
"""

import math
from typing import Any

from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    LeafSystem,
    OutputPort,
    System,
)

from aerodima.workbench.control.driver_law import DriverLaw, DriverView, ScheduledDriver
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import DriverInput, Schedule
from aerodima.workbench.control.tail_law import AGE_LIMIT, Observation, TailLaw, observe
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.event_order import (
    EventPriority,
    declare_ticks,
    nominal_time,
    priority_before,
)
from aerodima.workbench.core.port_fields import PortFields
from aerodima.workbench.core.port_wiring import (
    DiscreteVector,
    add_and_connect,
    concatenate,
    vector_of,
)
from aerodima.workbench.core.ranges import check_range
from aerodima.workbench.scenario.signal_table import (
    IMU,
    PLANNED_TURN,
    SPEED,
    STATUS,
    STEERING_ANGLE,
    TAIL_COMMAND,
    TAIL_STATE,
)

POSE = PortFields("DriverPose", ("qw", "qx", "qy", "qz", "x", "y", "vx", "vy"))
"""Pose that the driver of a path sees: rotation of the car, place and velocity of Bo, in W; m,
m/s."""
STANDING = 0.1
"""Speed below which a car has no course of its own, m/s."""


class TailController(LeafSystem):
    """Runs a tail law at a fixed rate on what the station reports; commands are held between ticks.

    A signal that is older than `age_limit`, or whose fault code is not zero, reaches the law as
    unknown: the IMU as "not valid", a tail angle as NaN. All memory is discrete state, so a reset
    context repeats a run.

    Input ports:
        tail_state (6), imu (9), status (13): signals as the station gives them, see
            `aerodima.workbench.scenario.signal_table`.
        planned_turn (1): turn that the driver announces, +1 left, -1 right, 0 none.
        speed (1, optional): speed from the station, m/s; unknown when not connected.
        steering_angle (1, optional): command of the driver, rad; unknown when not connected.
    Output ports:
        tail_pitch_command (5), tail_roll_command (5): `signal_table.TAIL_COMMAND`, in rad, rad/s,
            N m/rad, N m s/rad, N m.
        state (1): number of the law's state.

    Args:
        law: a `TailLaw`; `law_of_scenario(scenario)` is the one that a scenario names.
        age_limit: age beyond which a signal counts as silent, s.
        stage: stage of the ticks where the controller drives a simulated car
            (`aerodima.workbench.core.event_order`).
        idle: whether the controller never ticks and gives no command: for a car without tail, on
            which ticks cost time and have no effect.

    Raises:
        UserError: rate or age limit out of range; at a tick, a command that is not five finite
            numbers.
    """

    def __init__(
        self,
        law: TailLaw,
        age_limit: float = AGE_LIMIT,
        stage: EventPriority | None = None,
        idle: bool = False,
    ) -> None:
        super().__init__()
        check_range("controller.rate", law.rate, 0.0, math.inf, "Hz", above_low=True)
        check_range("controller.age_limit", age_limit, 0.0, math.inf, "s", above_low=True)
        self.set_name("tail_controller")
        self._law = law
        self._age_limit = age_limit
        self._tail_state = self.DeclareVectorInputPort("tail_state", TAIL_STATE.size)
        self._imu = self.DeclareVectorInputPort("imu", IMU.size)
        self._status = self.DeclareVectorInputPort("status", STATUS.size)
        self._planned_turn = self.DeclareVectorInputPort("planned_turn", PLANNED_TURN.size)
        self._speed = self.DeclareVectorInputPort("speed", SPEED.size)
        self._steering = self.DeclareVectorInputPort("steering_angle", STEERING_ANGLE.size)
        self._memory = DiscreteVector(self, law.start())
        self._pitch_command = DiscreteVector(
            self, TAIL_COMMAND.zeros(), output="tail_pitch_command"
        )
        self._roll_command = DiscreteVector(self, TAIL_COMMAND.zeros(), output="tail_roll_command")
        self._state = DiscreteVector(self, [0.0], output="state")
        if not idle:
            declare_ticks(self, law.rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        scenario: Any,
        *,
        station: System,
        driver: System,
        law: TailLaw | None = None,
        idle: bool = False,
    ) -> "TailController":
        """Adds a law, by default the scenario's, between the ports of a station and a driver."""
        stage = priority_before(station, EventPriority.CONTROLLER)
        inputs = {
            port: station.GetOutputPort(port) for port in ("tail_state", "imu", "status", "speed")
        }
        inputs |= {port: driver.GetOutputPort(port) for port in ("planned_turn", "steering_angle")}
        law = law or law_of_scenario(scenario)
        controller = add_and_connect(builder, cls(law, stage=stage, idle=idle), **inputs)
        for port in ("tail_pitch_command", "tail_roll_command"):
            builder.Connect(controller.GetOutputPort(port), station.GetInputPort(port))
        return controller

    def observe(self, context: Context) -> Observation:
        """Returns what the law is given at this instant."""
        tail = vector_of(self._tail_state, context)
        imu = vector_of(self._imu, context)
        status = vector_of(self._status, context)
        planned_turn = vector_of(self._planned_turn, context)
        if self._speed.HasValue(context):
            speed = vector_of(self._speed, context)
        else:
            speed = None
        steering_angle = math.nan
        if self._steering.HasValue(context):
            steering_angle = float(vector_of(self._steering, context)[0])
        return observe(
            nominal_time(context.get_time(), self._law.rate),
            tail,
            imu,
            status,
            float(planned_turn[0]),
            speed,
            self._age_limit,
            steering_angle=steering_angle,
        )

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        memory, pitch_command, roll_command, state = self._law.step(
            self._memory.read(context), self.observe(context)
        )
        time = context.get_time()
        self._check_command(time, "pitch", pitch_command)
        self._check_command(time, "roll", roll_command)
        self._memory.write(discrete_state, memory)
        self._pitch_command.write(discrete_state, pitch_command)
        self._roll_command.write(discrete_state, roll_command)
        self._state.write(discrete_state, [float(state)])

    def _check_command(self, time: float, joint: str, command: FloatArray) -> None:
        """Raises UserError for a command that is not five finite numbers."""
        if len(command) != TAIL_COMMAND.size or not math.isfinite(sum(command)):
            raise UserError(
                f"{type(self._law).__name__}.step at {time:g} s: {joint} command: "
                f"{list(map(float, command))}; must be {TAIL_COMMAND.size} finite numbers"
            )


class TurnDriver(LeafSystem):
    """Steering, throttle and announced turn of a driver, sampled at a fixed rate and held in
    between.

    Drives every manoeuvre of `aerodima.workbench.control.manoeuvre` and `driver_law`. A
    schedule looks at nothing but the time, and the system has no input ports then. All memory is
    discrete state.

    Input ports, each only if the law names it among its `sources`:
        imu (9): signals of the IMU as the station gives them.
        pose (8): `POSE` of a simulated car.
    Output ports:
        steering_angle (1): steering angle, rad, positive to the left.
        throttle (1): throttle, -1 to 1.
        planned_turn (1): announced turn, +1 left, -1 right, 0 none.

    Args:
        driver: a `DriverLaw`, such as `make_driver(scenario)`, or a schedule, such as
            `make_schedule(scenario)`.
        rate: rate of the ticks, Hz.
        stage: stage of the ticks where the driver drives a simulated car
            (`aerodima.workbench.core.event_order`).

    Raises:
        UserError: rate out of range.
    """

    def __init__(
        self, driver: DriverLaw | Schedule, rate: float = 100.0, stage: EventPriority | None = None
    ) -> None:
        super().__init__()
        check_range("controller.rate", rate, 0.0, math.inf, "Hz", above_low=True)
        self.set_name("driver")
        self._law: DriverLaw
        if isinstance(driver, Schedule):
            self._law = ScheduledDriver(driver)
        else:
            self._law = driver
        self._rate = rate
        sizes = {"imu": IMU.size, "pose": POSE.size}
        self._sources = {
            name: self.DeclareVectorInputPort(name, sizes[name]) for name in self._law.sources
        }
        _, inputs = self._law.step(self._law.start(), DriverView(0.0))
        self._outputs = [
            DiscreteVector(self, [value], output=name)
            for name, value in zip(DriverInput._fields, inputs, strict=True)
        ]
        self._memory = DiscreteVector(self, self._law.start())
        declare_ticks(self, rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls,
        builder: DiagramBuilder,
        driver: DriverLaw | Schedule,
        rate: float = 100.0,
        *,
        station: System,
        controller_rate: float | None = None,
    ) -> "TurnDriver":
        """Adds a driver and connects its steering, throttle and inputs to the station.

        Beside a tail controller of the same rate, Hz, it ticks at the controller's instant: the
        controller sees the driver as it was before, and one instant is cheaper than two.

        Raises:
            UserError: the driver needs the pose, which only the station of a simulated car has.
        """
        priority = EventPriority.DRIVER
        if controller_rate == rate:
            priority = EventPriority.CONTROLLER
        system = cls(driver, rate, priority_before(station, priority))
        builder.AddSystem(system)
        for port in ("steering_angle", "throttle"):
            builder.Connect(system.GetOutputPort(port), station.GetInputPort(port))
        for name, source in system._sources.items():
            if name == "pose":
                output = _pose(builder, station)
            else:
                output = station.GetOutputPort(name)
            builder.Connect(output, source)
        return system

    def view(self, context: Context) -> DriverView:
        """Returns what the law is given at this instant."""
        view = DriverView(nominal_time(context.get_time(), self._rate))
        if "imu" in self._sources:
            imu = IMU.read(vector_of(self._sources["imu"], context))
            view = view._replace(yaw_rate=imu.gyro_z, roll=imu.roll, roll_rate=imu.gyro_x)
        if "pose" in self._sources:
            pose = POSE.read(vector_of(self._sources["pose"], context))
            sine = 2.0 * (pose.qw * pose.qz + pose.qx * pose.qy)
            cosine = 1.0 - 2.0 * (pose.qy**2 + pose.qz**2)
            heading = math.atan2(sine, cosine)
            course = heading
            speed = math.hypot(pose.vx, pose.vy)
            if speed > STANDING:
                course = math.atan2(pose.vy, pose.vx)
            view = view._replace(
                position=(pose.x, pose.y), heading=heading, course=course, speed=speed
            )
        return view

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        memory, inputs = self._law.step(self._memory.read(context), self.view(context))
        self._memory.write(discrete_state, memory)
        for output, value in zip(self._outputs, inputs, strict=True):
            output.write(discrete_state, [value])


def _pose(builder: DiagramBuilder, station: System) -> OutputPort:
    """Adds one system, in C++, with the `POSE` of a simulated car; returns its port."""
    if not (isinstance(station, Diagram) and station.HasSubsystemNamed("plant")):
        raise UserError(
            "driver: follows a path by the pose of the car; allowed with a simulated car only"
        )
    plant: Any = station.GetSubsystemByName("plant")
    chassis = plant.GetBodyByName("chassis")
    q = chassis.floating_positions_start()
    v = plant.num_positions() + chassis.floating_velocities_start_in_v()
    places = [*range(q, q + 6), v + 3, v + 4]
    return concatenate(
        builder, "driver_pose", [(station.GetOutputPort("plant_state_truth"), places)]
    )
