"""The emulator's loop: one thread that answers the ports and advances the simulated car in real
time.

Devices answer as soon as bytes come; the car advances in the scenario's step. When the computer is
late the car catches up and the largest delay is reported.
"""

import json
import os
import select
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerodima.hardware.car.car_ports import (
    EVENTS_FILE,
    JOINTS,
    PORTS_FILE,
    PORTS_FOLDER,
    READY_FILE,
    READY_SCHEMA,
    SCHEMA,
    SERIAL_DEVICES,
    TRAFFIC_FILE,
    TRUTH_FILE,
    ports_from_dict,
)
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import WiringName
from aerodima.hardware.emulator.emulated_bus import (
    EmulatedBus,
    EmulatedMotor,
    PtyPort,
    SlcanAdapter,
)
from aerodima.hardware.emulator.emulated_devices import (
    CAR,
    EmulatedAir,
    EmulatedGps,
    EmulatedImu,
    EmulatedOperator,
    EmulatedTeensy,
)
from aerodima.hardware.emulator.emulated_plant import EmulatedCar
from aerodima.hardware.emulator.fault_script import (
    Device,
    EventLog,
    FaultBoard,
    Script,
)
from aerodima.hardware.firmware.teensy_firmware import firmware_settings
from aerodima.hardware.transport.can_adapter import TrafficLog
from aerodima.workbench.core.atomic_write import make_folder, write_atomically
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.realtime import EMULATOR_PRIORITY, prefer_latency, prefer_realtime
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.view.viewer import open_meshcat

_POLL_PERIOD = 0.001
"""Longest time between two runs of the firmware's loop, and two checks of the script, s."""
_PASS_ON = 0.0001
"""Idle time before the car computes, s. A thread of the kernel passes on what was written to a
port, at ordinary priority: it would wait behind the car on the same processor."""
_SAMPLE_PERIOD = 0.01
"""Time between two updates of what GPS and sail measure, s: the period of the 100 Hz loop."""
_LATE = 0.01
"""Delay of the emulated car behind the clock beyond which it is noted among the events, s."""


@dataclass(frozen=True)
class EmulatorSettings:
    """Settings of an emulator.

    Attributes:
        scenario: scenario of the car.
        wiring: wiring whose devices are emulated.
        folder: new or empty folder for the ports, logs and files of the emulator.
        script: script of faults and of the operator.
        duration: time after which the emulator ends by itself, s; None for ever.
        console: whether the operator's module has a port for `aerodima console`; the script's
            operator is then silent.
        view: whether to show the car in Meshcat; the address is in ready.json.
        parent: id of the process that started the emulator, with which it ends; None: it does not
            depend on one.
    """

    scenario: Scenario
    wiring: WiringName
    folder: Path
    script: Script
    duration: float | None = None
    console: bool = False
    view: bool = False
    parent: int | None = None


def with_a_rest(scenario: Scenario) -> Scenario:
    """Returns a scenario whose limp tail rests at the controller's limit of its roll at the latest:
    nobody is there to lift it off the ground before the motors are armed.
    """
    if not scenario.has_tail:
        return scenario
    stop = min(scenario.tail.roll_stop, scenario.tail.roll_limit)
    return scenario.varied(tail={"roll_stop": stop})


class Emulator:
    """All devices behind the ports and the simulated car, until `stop`.

    Raises:
        HardwareError: no compiler for the firmware, a folder that holds something or cannot be
            used, no pseudo-terminals.
    """

    def __init__(self, settings: EmulatorSettings) -> None:
        self._settings = settings
        self._folder = settings.folder
        self._mounting = load_mounting()
        _claim(self._folder)
        self._events = EventLog(self._folder / EVENTS_FILE)
        self._board = FaultBoard(settings.script, self._events)
        self._log = TrafficLog.create(self._folder / TRAFFIC_FILE)
        self._end = False
        self.largest_delay = 0.0
        self._lag = 0.0
        self._make_devices()
        truth = self._folder / TRUTH_FILE
        facts = {"emulated": settings.wiring}
        self._view = open_meshcat() if settings.view else None
        self._car = EmulatedCar(with_a_rest(settings.scenario), truth, facts, self._view)
        self._sample_due = 0.0
        self._tipped = False
        self._tipping_angle = load_drive_safety().attitude_limit
        self._begin = time.monotonic()

    def _make_devices(self) -> None:
        settings = self._settings
        board = self._board
        plugs = self._folder / PORTS_FOLDER
        watched = settings.wiring == "watched_can"
        names: list[Device] = [*SERIAL_DEVICES]
        self._car_ports = _serial_ports(plugs)
        if watched:
            names.append("can")
            # A pseudo-terminal does not restart when it is opened.
            self._car_ports["can"] = {
                "interface": "slcan",
                "channel": str(plugs / "can"),
                "options": {"sleep_after_open": 0.0},
            }
        if settings.console:
            names.append("console")
            self._car_ports["console"] = {"path": str(plugs / "console"), "receiver": CAR}
        self._ports = {name: PtyPort(plugs / name) for name in names}
        ports = ports_from_dict(self._car_ports)
        directions = (self._mounting.tail_pitch_direction, self._mounting.tail_roll_direction)
        self._motors = [
            EmulatedMotor(joint, motor_id, board, self._events, direction=direction)
            for joint, motor_id, direction in zip(JOINTS, ports.motor_ids, directions, strict=True)
            if settings.scenario.has_tail
        ]
        bus = EmulatedBus(self._motors, board, self._log)
        self._adapter = SlcanAdapter(bus, board)
        bus.to_owner = self._adapter.receive
        self._teensy = EmulatedTeensy(
            firmware_settings(settings.wiring, ports, settings.scenario),
            bus,
            board,
            self._events,
            time.monotonic(),
            watches=watched,
        )
        self._imu = EmulatedImu(self._mounting, board)
        self._gps = EmulatedGps(settings.scenario.gps.rate, board)
        entries = () if settings.console else settings.script.operator
        self._operator = EmulatedOperator(entries, board)
        self._air = EmulatedAir(board)

    def stop(self) -> None:
        """Ends the loop; safe in a signal handler."""
        self._end = True

    def run(self, ready: Callable[[], None]) -> Json:
        """Serves until `stop`, or the end of the duration or of the parent; returns the facts of
        the run, which the last event holds too.

        Args:
            ready: function that is called when serving begins.
        """
        step = self._settings.scenario.simulation.step
        self._advance(step)  # the first step takes twenty times as long as the others
        self._events.add("scheduling", applies=prefer_realtime(EMULATOR_PRIORITY))
        # a garbage collection of all of Drake's objects would stop the car for 30 ms
        prefer_latency()
        self._begin = time.monotonic() - step
        self._board.begin("start", self._begin)
        self._write_ready()
        ready()
        tick = 1
        while not self._end and self._settings.parent in (None, os.getppid()):
            due = self._begin + (tick + 1) * step
            self._serve(due)
            self._note_delay(time.monotonic() - due)
            tick += 1
            self._advance(tick * step)
            if self._settings.duration is not None and tick * step >= self._settings.duration:
                break
        return self._close()

    def _note_delay(self, delay: float) -> None:
        """Notes each time that the car falls behind and catches up, as an event `late` with the
        largest delay.
        """
        self.largest_delay = max(self.largest_delay, delay)
        if delay > _LATE:
            self._lag = max(self._lag, delay)
        elif self._lag:
            self._events.add("late", delay_s=round(self._lag, 6))
            self._lag = 0.0

    def _serve(self, due: float) -> None:
        """Answers the ports until `due` and until nothing has come for `_PASS_ON`."""
        while True:
            now = time.monotonic()
            self._update_faults(now)
            self._write("teensy", self._teensy.update(now))
            self._write("can", self._adapter.poll())
            self._write("imu", self._imu.poll(now))
            self._write("radio", self._operator.update(now))
            open_ports = [port for port in self._ports.values() if port.plugged]
            readable, _, _ = select.select(
                open_ports, [], [], min(_POLL_PERIOD, max(_PASS_ON, due - now))
            )
            came = False
            for name, port in self._ports.items():
                if port in readable and (data := port.read()):
                    came = True
                    self._receive(name, data)
            if not came and time.monotonic() >= due:
                return

    def _receive(self, name: Device, data: bytes) -> None:
        """Gives a device its bytes; `_serve` fetches the answers that are not written here."""
        now = time.monotonic()
        if name == "teensy":
            self._teensy.feed(data, now)
        elif name == "can":
            self._write("can", self._adapter.feed(data))
        elif name == "imu":
            self._imu.set_reading(self._car.output("imu"))
            self._imu.feed(data, now)
        elif name == "console":
            self._write("radio", self._air.to_car(data))
        elif name == "radio" and "console" in self._ports:
            self._write("console", self._air.to_console(data))
        elif name == "radio":
            self._operator.receive(data)

    def _write(self, name: Device, data: bytes) -> None:
        if data:
            self._ports[name].write(data)

    def _update_faults(self, now: float) -> None:
        if any(motor.entered for motor in self._motors):
            self._board.begin("entered", now)
        if self._teensy.driving:
            self._board.begin("driving", now)
        board = self._board
        board.update(now)
        for name, port in self._ports.items():
            link = port.link
            if board.entry("renamed", name):
                link = link.with_name(f"{name}_1")
            unpowered = name == "teensy" and board.entry("teensy_unpowered")
            if unpowered or board.entry("unplugged", name):
                port.unplug()
            elif port.link != link:
                port.unplug()
                port.plug(link)
            else:
                port.plug()

    def _advance(self, time_s: float) -> None:
        car = self._car
        state = self._teensy.state
        car.command("steering_angle", self._mounting.steering_angle(state.servo))
        car.command("throttle", self._mounting.throttle(state.throttle))
        for motor in self._motors:
            # `vars` keeps the order of the fields; `astuple` would copy deeply.
            car.command(f"{motor.joint}_command", *vars(motor.joint_command).values())
        car.advance(time_s)
        if self._motors:
            joints = car.joints()
            torques = car.output("tail_torque")
            for index, motor in enumerate(self._motors):
                angle = float(joints[index])
                motor.set_joint(angle, float(joints[2 + index]), float(torques[index]))
        if time_s >= self._sample_due:
            self._sample_due += _SAMPLE_PERIOD
            self._sample(time_s)

    def _sample(self, time_s: float) -> None:
        """Updates what GPS and sail measure; the slower GPS keeps its own pace.

        A car that tips over is an event.
        """
        car = self._car
        tipped = bool(np.max(np.abs(car.output("imu")[:2])) > self._tipping_angle)
        if tipped and not self._tipped:
            self._events.add("tipped")
        self._tipped = tipped
        self._write("gps", self._gps.update(float(car.output("speed")[0]), time_s))
        if car.has_tail:
            self._teensy.set_sail(self._mounting.encoder_angle(float(car.output("tail_state")[2])))

    def _write_ready(self) -> None:
        settings = self._settings
        _write_json(self._folder / PORTS_FILE, self._car_ports)
        ready = {
            "schema": READY_SCHEMA,
            "pid": os.getpid(),
            "wiring": settings.wiring,
            "ports": str(self._folder / PORTS_FILE),
            "begin_monotonic_s": self._begin,
            "view": None if self._view is None else self._view.web_url(),
        }
        _write_json(self._folder / READY_FILE, ready)
        self._events.add("ready")

    def _close(self) -> Json:
        for port in self._ports.values():
            port.unplug()
        self._car.close()
        self._log.close()
        facts = {
            "simulated_s": round(self._car.time, 6),
            "largest_delay_s": round(self.largest_delay, 6),
            "rejected_strings": self._teensy.state.rejected,
            "traffic_log_error": self._log.error,
        }
        self._events.add("ended", **facts)
        self._events.close()
        return facts


def run_emulator(settings: EmulatorSettings, ready: Callable[[], None] = lambda: None) -> Json:
    """Runs an emulator until SIGINT, SIGTERM or its end; returns the facts of the run.

    Errors are those of `Emulator`; `ready` is that of `Emulator.run`.
    """
    emulator = Emulator(settings)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: emulator.stop())
    return emulator.run(ready)


def _serial_ports(plugs: Path) -> Json:
    """Returns the ports of the emulated car, except those that only some cars have."""
    motors: Json = {joint: {"motor_id": number} for number, joint in enumerate(JOINTS, start=1)}
    return {
        "schema": SCHEMA,
        **{name: {"path": str(plugs / name)} for name in SERIAL_DEVICES},
        **motors,
    }


def _claim(folder: Path) -> None:
    make_folder(folder, HardwareError)
    if any(folder.iterdir()):
        raise HardwareError(f"{folder}: is not empty; an emulator writes into a folder of its own")
    make_folder(folder / PORTS_FOLDER, HardwareError)


def _write_json(path: Path, content: Json) -> None:
    """Writes the whole file or none: other programs wait for it."""
    write_atomically(path, json.dumps(content, indent=1) + "\n", False, HardwareError)
