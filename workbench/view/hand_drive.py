"""A simulated car that somebody drives with sliders, keys or the gamepad of a Meshcat page.

There is no device, no bus and no arming: the diagram is that of `simulate`, with a schedule that
asks the driver instead of the clock. The run never skips: on a slow computer simulated time passes
more slowly, and the page shows how slowly.
"""

import math
import time as wall
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from aerodima.workbench.car.car_diagram import assemble, plant_facts
from aerodima.workbench.control.driver_law import ScheduledDriver, limited_driver
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import DriverInput, ThrottleLine, throttle_line
from aerodima.workbench.control.tail_law import LawStep, Observation, TailLaw
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.system_lifetime import break_reference_cycles
from aerodima.workbench.logs.recorder import RunRecorder, open_log, recorded_columns
from aerodima.workbench.logs.schema import DRIVEN_BY, run_metadata
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.view.viewer import WORLD, ChaseCamera

CONTROL_PERIOD = 0.02
"""Time of the run between two readings of the controls, s."""
DISPLAY_PERIOD = 0.1
"""Time of the run between two values shown, s: a page drawn in software falls behind with more."""
ACCELERATION = 3.0
"""Rate of change of the commanded speed, m/s2, which the car's tyres and drive can follow on a
floor with friction 0.5."""
TAIL_SPEED = 8.0
"""Largest commanded roll rate of a tail moved by hand, rad/s: the published swing (Table 6.4)."""
MIN_PACE = 0.9
"""Share of the wanted pace below which a message warns the driver."""
# Names of the sliders.
STEERING = "steering, deg"
SPEED = "wanted speed, m/s"
NEXT_TURN = "next turn: left 1, right -1"
TAIL = "tail roll, deg"
PACE = "pace wanted"
PACE_NOW = "pace now, 1 = real time"
SPEED_NOW = "speed now, m/s"
TIME_NOW = "time, s"
HEADING_NOW = "heading, deg, left +"
MAX_TIME = 3600.0
"""Time at which the slider of the time stops, s; the run goes on."""
# Names of the buttons.
STRAIGHT = "straight"
BY_HAND = "tail: hand or law"
PAUSE = "pause"
RESET = "reset"
END = "end"
KEYS = {STRAIGHT: "Space", BY_HAND: "KeyT", PAUSE: "KeyP", RESET: "KeyR", END: "Escape"}
"""Key of each button; the sliders have their keys in `MeshcatControls`."""
HELP = """arrow keys: steer, and speed wanted; space: wheels straight
P: pause; R: reset; Escape: end
Q, E: announce a left or a right turn to the tail's law
T: tail by hand or by its law; A, D: roll it by hand
gamepad: left stick steers, right stick rolls the tail
gamepad: the two triggers brake and accelerate"""
DEAD_ZONE = 0.08
"""Largest deflection of a stick that counts as none."""
# Axes and buttons of a gamepad in the standard layout of browsers
# (https://w3c.github.io/gamepad/#remapping).
LEFT_X = 0
"""Axis of the left stick, positive to the right."""
RIGHT_X = 2
"""Axis of the right stick, positive to the right."""
BRAKE = 6
"""Button of the left trigger, from 0 to 1."""
ACCELERATE = 7
"""Button of the right trigger, from 0 to 1."""
PAD_ACCELERATION = 4.0
"""Change of the wanted speed with a trigger fully pulled, m/s per second at real time."""


@dataclass
class ManualInput:
    """Present commands of the driver.

    Attributes:
        steering: steering angle, rad, positive to the left.
        speed: wanted speed, m/s.
        planned_turn: turn announced to the tail's law: +1 left, -1 right, 0 none.
        tail_roll: roll of a tail that is moved by hand, rad, positive to the right; NaN leaves the
            tail to its law.
        pace: seconds of the run per second; 0 is a pause.
        attempt: number of resets so far.
        over: whether the driver has ended the drive.
    """

    steering: float = 0.0
    speed: float = 0.0
    planned_turn: float = 0.0
    tail_roll: float = math.nan
    pace: float = 1.0
    attempt: int = 0
    over: bool = False


@dataclass
class ManualSchedule:
    """A `Schedule` that follows a driver; the speed is ramped, so that the wheels do not spin.

    Args:
        line: line that gives the throttle for a speed.
        limit: largest steering angle, rad.
        command: present commands of the driver, replaced from outside.
    """

    line: ThrottleLine
    limit: float
    command: ManualInput = field(default_factory=ManualInput)
    _speed: float = 0.0
    _time: float = 0.0

    def at(self, time: float) -> DriverInput:
        """Returns the inputs at `time` s; must be called in the order of time."""
        command = self.command
        elapsed = time - self._time
        change = _clip(command.speed - self._speed, ACCELERATION * elapsed)
        self._speed += change
        self._time = time
        acceleration = 0.0
        if elapsed > 0.0:
            acceleration = change / elapsed
        throttle = self.line.throttle(self._speed, acceleration)
        return DriverInput(_clip(command.steering, self.limit), throttle, command.planned_turn)


def _clip(value: float, limit: float) -> float:
    """Limits the magnitude of a number; NaN stays."""
    return float(np.clip(value, -limit, limit))


class ManualOverrideLaw:
    """A `TailLaw` that moves the tail's roll to where the driver wants it, or leaves the tail to
    another law.

    By hand the tail moves from where it is, at `TAIL_SPEED` at most, with the gains that hold it.

    Args:
        law: law that moves the tail when the driver does not.
        schedule: schedule whose command shows which of the two moves the tail.
        gains: position and rate gain, N m/rad and N m s/rad.
    """

    def __init__(self, law: TailLaw, schedule: ManualSchedule, gains: Pair) -> None:
        self._law = law
        self._schedule = schedule
        self._gains = gains
        self.rate = law.rate
        self.memory_size = law.memory_size + 1

    def start(self) -> FloatArray:
        """Joins the memory of the law and the last angle set by hand, NaN before there is one."""
        return np.append(self._law.start(), math.nan)

    def step(self, memory: FloatArray, observation: Observation) -> LawStep:
        """Steps the law, and moves the tail by hand; see `TailLaw`."""
        after, pitch, roll, state = self._law.step(memory[:-1], observation)
        wanted = self._schedule.command.tail_roll
        angle = memory[-1]
        if math.isnan(angle):
            angle = observation.roll_angle
        angle += _clip(wanted - angle, TAIL_SPEED / self.rate)
        if not math.isnan(angle):
            roll = np.array([angle, 0.0, *self._gains, 0.0])
        return np.append(after, angle), pitch, roll, state


def drive_by_hand(
    scenario: Scenario,
    controls: "MeshcatControls",
    *,
    log: Path | None = None,
    meshcat: Meshcat | None = None,
    length: float = math.inf,
    force: bool = False,
    say: Callable[[str], None] = print,
) -> list[Path]:
    """Simulates a car that is driven by hand until the driver ends it; returns the logs
    that were written.

    Args:
        scenario: scenario of the car; its manoeuvre is not used.
        controls: controls of the driver.
        log: path of the Parquet file of the first attempt; after a reset the next attempt goes to
            `NAME_2.parquet`, and so on.
        meshcat: Meshcat that shows the car from behind.
        length: simulated time after which an attempt ends, s.
        force: whether existing logs are replaced.
        say: function that receives what the driver must know.

    Raises:
        UserError: the scenario makes no valid car, a log exists.
    """
    written: list[Path] = []
    for attempt in count(1):
        path = log
        if log is not None and attempt > 1:
            path = log.with_stem(f"{log.stem}_{attempt}")
        schedule = ManualSchedule(throttle_line(scenario), scenario.servo.limit)
        if meshcat is not None:
            meshcat.Delete(f"{WORLD}/visualizer")
        gains = scenario.controller.hold_gains
        hand = ManualOverrideLaw(law_of_scenario(scenario), schedule, gains)
        driver = limited_driver(ScheduledDriver(schedule), scenario)
        car = assemble(scenario, meshcat=meshcat, tail_law=hand, schedule=driver)
        extra = {**plant_facts(car.station), DRIVEN_BY: "hand (simulation)"}
        metadata = run_metadata(scenario.resolved(), scenario.seed, extra=extra)
        with (
            break_reference_cycles(car.builder),
            open_log(path, recorded_columns(car.signals), metadata, force) as rows,
        ):
            settings = scenario.simulation
            RunRecorder.add_to_builder(
                car.builder, rows, car.signals, settings.log_rate, settings.step
            )
            simulator = Simulator(car.builder.Build())
            simulator.Initialize()
            again = _drive(
                simulator, ChaseCamera(car.station, meshcat), controls, schedule, length, say
            )
        if path is not None:
            written.append(path)
        if not again:
            break
    return written


def _drive(
    simulator: Simulator,
    camera: ChaseCamera,
    controls: "MeshcatControls",
    schedule: ManualSchedule,
    length: float,
    say: Callable[[str], None],
) -> bool:
    """Simulates one drive from standstill; returns whether another one is wanted."""
    context = simulator.get_context()
    attempt = controls.poll().attempt
    warned = False
    pace = 1.0
    clock = wall.monotonic()
    start = 0.0
    shown = -math.inf
    while context.get_time() < length:
        command = controls.poll()
        if command.over or command.attempt != attempt:
            return not command.over
        if command.pace <= 0.0:
            wall.sleep(CONTROL_PERIOD)
            clock = wall.monotonic()
            start = context.get_time()
            continue
        schedule.command = command
        begun = wall.monotonic()
        simulator.AdvanceTo(min(context.get_time() + CONTROL_PERIOD, length))
        speed, heading = camera.follow(context)
        wall.sleep(max(0.0, CONTROL_PERIOD / command.pace - (wall.monotonic() - begun)))
        time = context.get_time()
        if time - start >= 1.0:
            now = wall.monotonic()
            pace = (time - start) / (now - clock)
            clock = now
            start = time
            if pace < MIN_PACE * command.pace and not warned:
                warned = True
                say(
                    f"this computer keeps up at {pace:.2f} of real time, not {command.pace:g}: the "
                    "run slows down"
                )
        if time - shown >= DISPLAY_PERIOD - CONTROL_PERIOD / 2:
            shown = time
            controls.show(time, speed, heading, pace)
    return False


class MeshcatControls:
    """The driver's controls in a Meshcat page.

    A gamepad that is in use takes precedence over sliders and keys.

    Args:
        meshcat: Meshcat that gets the sliders and buttons.
        scenario: scenario of the car, which gives its steering limit and top speed.
        pace: seconds of the run per second at the start.
        say: function that receives a line when a gamepad comes or goes.
    """

    def __init__(
        self, meshcat: Meshcat, scenario: Scenario, pace: float, say: Callable[[str], None] = print
    ) -> None:
        self._meshcat = meshcat
        self._say = say
        self._limit = math.degrees(scenario.servo.limit)
        line = throttle_line(scenario)
        self._top = math.floor(2.0 * (line.gain + line.offset)) / 2.0
        self._pad = False
        self._steering = 0.0
        self._pad_speed = 0.0
        meshcat.AddSlider(STEERING, -self._limit, self._limit, 3.0, 0.0, "ArrowRight", "ArrowLeft")
        meshcat.AddSlider(SPEED, 0.0, self._top, 0.25, 0.0, "ArrowDown", "ArrowUp")
        meshcat.AddSlider(NEXT_TURN, -1.0, 1.0, 1.0, 0.0, "KeyE", "KeyQ")
        meshcat.AddSlider(TAIL, -120.0, 120.0, 5.0, 0.0, "KeyA", "KeyD")
        meshcat.AddSlider(PACE, 0.1, 1.0, 0.1, pace)
        meshcat.AddSlider(PACE_NOW, 0.0, 1.0, 0.01, 0.0)
        meshcat.AddSlider(SPEED_NOW, 0.0, math.ceil(self._top), 0.01, 0.0)
        meshcat.AddSlider(TIME_NOW, 0.0, MAX_TIME, 0.1, 0.0)
        meshcat.AddSlider(HEADING_NOW, -180.0, 180.0, 1.0, 0.0)
        for name, key in KEYS.items():
            meshcat.AddButton(name, key)
        self._straightened = 0

    def poll(self) -> ManualInput:
        """Reads what the driver asks for now."""
        meshcat = self._meshcat
        clicks = meshcat.GetButtonClicks(STRAIGHT)
        if clicks != self._straightened:
            self._straightened = clicks
            meshcat.SetSliderValue(STEERING, 0.0)
        if not self._read_pad():
            self._steering = math.radians(meshcat.GetSliderValue(STEERING))
        speed = self._pad_speed if self._pad else meshcat.GetSliderValue(SPEED)
        tail_roll = math.nan
        if meshcat.GetButtonClicks(BY_HAND) % 2 == 1:
            tail_roll = math.radians(meshcat.GetSliderValue(TAIL))
        pace = 0.0
        if meshcat.GetButtonClicks(PAUSE) % 2 == 0:
            pace = meshcat.GetSliderValue(PACE)
        return ManualInput(
            steering=self._steering,
            speed=speed,
            planned_turn=meshcat.GetSliderValue(NEXT_TURN),
            tail_roll=tail_roll,
            pace=pace,
            attempt=meshcat.GetButtonClicks(RESET),
            over=meshcat.GetButtonClicks(END) > 0,
        )

    def show(self, time: float, speed: float, heading: float, pace: float) -> None:
        """Shows the state of the run on the sliders, the pace in Meshcat's own chart too.

        Args:
            time: simulated time since this attempt began, s.
            speed: speed over ground, m/s.
            heading: heading relative to the start, rad, positive to the left, from -pi to pi.
            pace: seconds of the run per second.
        """
        meshcat = self._meshcat
        meshcat.SetSliderValue(PACE_NOW, min(pace, 1.0))
        meshcat.SetSliderValue(SPEED_NOW, speed)
        meshcat.SetSliderValue(HEADING_NOW, math.degrees(heading))
        meshcat.SetSliderValue(TIME_NOW, min(time, MAX_TIME))
        meshcat.SetRealtimeRate(pace)

    def _read_pad(self) -> bool:
        """Reads the gamepad; returns whether there is one."""
        meshcat = self._meshcat
        pad = meshcat.GetGamepad()
        complete = len(pad.axes) > RIGHT_X and len(pad.button_values) > ACCELERATE
        there = pad.index is not None and complete
        if there != self._pad:
            self._pad = there
            self._pad_speed = meshcat.GetSliderValue(SPEED)
            if there:
                self._say("gamepad: it drives now")
            else:
                self._say("the gamepad is gone: wheels straight, wanted speed 0")
                meshcat.SetSliderValue(STEERING, 0.0)
                meshcat.SetSliderValue(SPEED, 0.0)
        if not there:
            return False
        left = 0.0
        if abs(pad.axes[LEFT_X]) > DEAD_ZONE:
            left = pad.axes[LEFT_X]
        self._steering = -math.radians(self._limit) * left
        pulled = pad.button_values[ACCELERATE] - pad.button_values[BRAKE]
        speed = self._pad_speed + PAD_ACCELERATION * pulled * CONTROL_PERIOD
        self._pad_speed = min(self._top, max(0.0, speed))
        meshcat.SetSliderValue(SPEED, self._pad_speed)
        right = pad.axes[RIGHT_X]
        if abs(right) > DEAD_ZONE:
            meshcat.SetSliderValue(TAIL, 120.0 * right)
        return True
