"""A car that drives on the emulator until something goes wrong, and what was seen on its bus.

`python -m tests.hardware.emulator.fault_runs` measures the fault table of hardware/README.md.
"""

from __future__ import annotations

import gc
import math
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import can
import numpy as np

from hardware.drive.guard import CarGuard, Stage
from hardware.drive.loop import PERIOD, wait_until
from hardware.emulator.script import JOINTS
from hardware.protocol.ak70 import make_enter, make_exit
from hardware.protocol.car_report import Asks
from hardware.protocol.radio import RadioMode
from hardware.watchdog.process import WatchdogProcess
from hardware.wiring.base import WIRINGS, CarCommand
from hardware.wiring.car_ports import CarPorts
from hardware.wiring.direct_can import direct_can
from hardware.wiring.drive_safety import load_drive_safety
from hardware.wiring.teensy_bridge import teensy_bridge
from tests.hardware.emulator.breakers import Breaker, ClockJumps, ControllerRaises, DiskFull, ReceiverDies
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed
from workbench.ports import STATUS
from workbench.scenario import Scenario, load_scenario

SCENARIO = "turn_swing"
_PITCH = np.array([0.0, 0.0, 17.0, 5.0, 0.0])
_ROLL = np.array([-math.pi / 2, 0.0, 17.0, 5.0, 0.0])
RUN_OVER = "the run is over"
AT = 1.0
"""When the fault comes: s after the throttle was first opened, which is when the car drives."""
_AFTER = 0.2
"""s after the second motor was off in which exit frames are counted: those of ten cycles, or of the watchdog."""
_LAST_WAIT = 2.0


ASKED = {"time": 0.0, "mode": "auto_when_asked"}


@dataclass(frozen=True)
class Case:
    """A fault of the table, and what must follow.

    Attributes:
        fault: entry of the script without its time; None: `break_command` or the operator.
        stops: whether the car must stop. within: s from the fault to the motors off, as long as the cause allows.
        reason: part of the reason that the drive gives.
        breaker: what breaks in the computer itself. broken_command: what the controller commands from then on.
    """

    name: str
    wiring: str
    fault: dict | None = None
    stops: bool = True
    within: float = 0.3
    reason: str = ""
    operator: tuple[dict, ...] = (ASKED,)
    breaker: Callable[[], Breaker] = Breaker
    broken_command: CarCommand | None = None

    @property
    def of_the_computer(self) -> bool:
        """Whether nothing of the emulated car breaks."""
        return self.broken_command is not None or self.breaker is not Breaker


class EndedEarlyError(AssertionError):
    """The drive had ended before the fault came, as it must on a computer that stands still; it showed nothing."""


@dataclass
class Outcome:
    """What a run came to. Times in s since the fault; NaN: never.

    Attributes:
        motors_off: when the second motor was off. throttle_neutral: when the pulse was.
        exits: exit frames on the bus after the fault. entered_again: enter frames after the fault.
    """

    reason: str
    motors_off: float
    throttle_neutral: float
    exits: int
    entered_again: int
    events: list[dict] = field(repr=False)


def open_car(scenario: Scenario, ports: CarPorts, wiring: str):
    """The wiring of a scenario, allowed to arm."""
    if wiring == "teensy_bridge":
        return teensy_bridge(scenario, ports, lambda: None)
    return direct_can(scenario, ports, lambda: None, lambda can: WatchdogProcess(can, ports.motor_ids))


def drive_until_stopped(
    guard: CarGuard, run_time: float, command_at: Callable[[float], CarCommand], breaker: Breaker
) -> None:
    """Arms, drives with the commands for `run_time` s, and lets the car stop."""

    def turn(condition: Callable[[], bool], limit: float, command: Callable[[float], CarCommand]) -> bool:
        begin = due = time.monotonic()
        while not condition():
            now = time.monotonic()
            if now - begin > limit:
                return False
            breaker.turn(guard)
            guard.exchange(command(now), breaker.clock(), due if guard.stage is Stage.DRIVING else None)
            due = max(due + PERIOD, now - 0.05)
            wait_until(due)
        return True

    def idle(_: float) -> CarCommand:
        return CarCommand()

    def chosen() -> bool:
        return guard.asks is Asks.CHOICE and guard.reading.operator.mode is RadioMode.AUTO

    if not turn(lambda: _heard(guard), 10.0, idle):
        raise EndedEarlyError(guard.reading.fault_text)
    guard.arm(time.monotonic())
    if not turn(lambda: chosen() or guard.finished, 5.0, idle) or guard.finished:
        raise EndedEarlyError(guard.reason or guard.reading.fault_text)
    began = time.monotonic()
    guard.drive(RadioMode.AUTO, began)
    turn(lambda: guard.finished, run_time, lambda now: command_at(now - began))
    guard.stop(RUN_OVER, breaker.clock())
    turn(lambda: guard.finished, 3.0, idle)


def _heard(guard: CarGuard) -> bool:
    """Something has been read, every source but the motors has been heard, and none has a fault."""
    status = STATUS.read(guard.reading.status)
    faults = (status.sail_fault, status.imu_fault, status.speed_fault, status.operator_fault)
    return status.operator_age > 0.0 and not any(faults)


def run_case(case: Case, folder: Path, run_time: float = AT + 2.5) -> Outcome:
    """Drives on the emulator with the fault of a case."""
    faults = [] if case.fault is None else [{"time": AT, **case.fault}]
    scenario = load_scenario(SCENARIO)
    script = {"clock": "driving", "faults": faults, "operator": list(case.operator)}
    with EmulatorProcess(folder, scenario, case.wiring, script) as emulator:
        car = open_car(scenario, emulator.ports, case.wiring)
        guard = CarGuard(car, load_drive_safety())
        good = CarCommand(0.1, 0.3, _PITCH, _ROLL)
        breaker = case.breaker()

        def command_at(since: float) -> CarCommand:
            if since >= AT and breaker.struck is None:
                breaker.strike()
            return good if since < AT or case.broken_command is None else case.broken_command

        try:
            car.start()
            breaker.begin(car, scenario, folder)
            gc.collect()
            gc.freeze()  # as the drive does: no pause of the collector within the run
            drive_until_stopped(guard, run_time, command_at, breaker)
        except ArithmeticError as error:  # as a drive does it
            guard.stop(f"{type(error).__name__}: {error}", time.monotonic(), hard=True)
        finally:
            car.stop("over")
            gc.unfreeze()
        if case.of_the_computer and breaker.struck is None:
            raise EndedEarlyError(guard.reason)
        breaker.end()
        _wait_for_end(emulator)
        reason = guard.reason
    events = emulator.events
    began = breaker.struck if case.of_the_computer else _fault_time(events, case)
    if began is None:
        raise EndedEarlyError(reason)
    return _outcome(reason, began, events, emulator.traffic())


def _wait_for_end(emulator: EmulatorProcess) -> None:
    """Until both motors are off and the throttle is neutral, whoever does it, and for what may come after that."""
    end = time.monotonic() + _LAST_WAIT
    while time.monotonic() < end:
        last = {event["event"] + event.get("joint", ""): event["time_s"] for event in emulator.events}
        off = all(last.get(f"off{joint}", 0.0) > last.get(f"entered{joint}", 0.0) for joint in JOINTS)
        if off and last.get("throttle_neutral", 0.0) > last.get("throttle_on", 0.0):
            break
        time.sleep(0.02)
    time.sleep(_AFTER)


def _fault_time(events: list[dict], case: Case) -> float | None:
    name = "fault_on" if case.fault is not None else "script_begins"
    came = next((event["time_s"] for event in events if event["event"] == name), None)
    if came is None or case.fault is not None:
        return came
    return came + next(entry["time"] for entry in case.operator if entry.get("stop"))


def _outcome(reason: str, began: float, events: list[dict], traffic: list[can.Message]) -> Outcome:
    def when(name: str, joint: str | None = None) -> float:
        found = [e["time_s"] for e in events if e["event"] == name and e.get("joint") == joint and e["time_s"] >= began]
        return found[0] - began if found else math.nan

    clock = time.time() - time.monotonic()
    off = float(np.max([when("off", joint) for joint in JOINTS]))
    sent = [(message.timestamp - clock - began, bytes(message.data)) for message in traffic if not message.is_rx]
    exits = sum(0.0 <= at <= off + _AFTER and data == make_exit(1).data for at, data in sent)
    enters = sum(at >= 0.0 and data == make_enter(1).data for at, data in sent)
    return Outcome(reason, off, when("throttle_neutral"), exits, enters, events)


def _motor(name: str, wiring: str = "direct_can", **keys) -> Case:
    return Case(name.replace("_", " "), wiring, {"fault": name, "part": "tail_roll"}, **keys)


def _device(device: str, name: str, wiring: str, duration: float | None = None, **keys) -> Case:
    fault = {"fault": name, "part": device} | ({} if duration is None else {"duration": duration})
    return Case(f"{device} {name}", wiring, fault, **keys)


def _reply_lost(name: str, wiring: str, stops: bool, **extra) -> Case:
    return Case(
        f"reply lost {name}",
        wiring,
        {"fault": "reply_lost", "part": "tail_roll", **extra},
        stops,
        reason="no reply" * stops,
    )


_SOFT = load_drive_safety().tail_hold
CASES = (
    _reply_lost("once", "direct_can", False, count=1),
    _reply_lost("for 100 ms", "direct_can", True, duration=0.1),
    _reply_lost("for ever", "direct_can", True),
    _reply_lost("once", "teensy_bridge", False, count=1),
    _reply_lost("for ever", "teensy_bridge", True),
    _motor("reply_corrupted", reason="no reply"),
    _motor("reply_short", reason="no reply"),
    _motor("reply_long", reason="no reply"),
    _motor("foreign_id", reason="no reply"),
    _motor("double_id"),
    _motor("v3_frame", reason="V3 firmware"),
    _motor("over_temperature", reason="95"),
    _motor("motor_fault", reason="over-current"),
    _motor("encoder_jump", reason="jumped"),
    _motor("out_of_range", reason="allowed is", within=1.3),
    _motor("motor_fault", "teensy_bridge", reason="over-current"),
    _motor("encoder_jump", "teensy_bridge", reason="jumped"),
    Case("bus off", "direct_can", {"fault": "bus_off"}, reason="no reply", within=0.5),
    Case("bus off for 0.4 s", "teensy_bridge", {"fault": "bus_off", "duration": 0.4}, reason="no reply", within=0.7),
    _device("can", "unplugged", "direct_can", 0.5, within=0.9),
    _device("can", "silent", "direct_can", reason="no reply"),
    _device("can", "serial_noise", "direct_can"),
    _device("teensy", "unplugged", "teensy_bridge"),
    _device("teensy", "unplugged", "direct_can"),
    _device("teensy", "silent", "teensy_bridge"),
    _device("teensy", "silent", "direct_can"),
    _device("teensy", "serial_noise", "teensy_bridge"),
    Case("Teensy hung", "teensy_bridge", {"fault": "teensy_hung"}, within=0.9),
    Case("Teensy hung", "direct_can", {"fault": "teensy_hung"}),
    _device("imu", "silent", "direct_can", reason="IMU", within=0.3 + _SOFT),
    _device("gps", "silent", "direct_can", reason="GPS", within=1.3 + _SOFT),
    _device("radio", "silent", "direct_can", reason="radio", within=0.5 + _SOFT),
    _device("radio", "silent", "teensy_bridge", reason="radio", within=0.5 + _SOFT),
    *(
        Case("operator stop", wiring, None, operator=(ASKED, {"time": AT, "stop": True}), reason="emergency")
        for wiring in WIRINGS
    ),
    Case("commanded NaN", "direct_can", None, broken_command=CarCommand(math.nan, 0.3, _PITCH, _ROLL), reason="NaN"),
    Case(
        "commanded NaN",
        "teensy_bridge",
        None,
        broken_command=CarCommand(0.1, 0.3, _PITCH, math.nan * _ROLL),
        reason="NaN",
    ),
)


CASES += tuple(
    Case(name, wiring, None, breaker=breaker, reason=reason, within=within)
    for wiring in WIRINGS
    for name, breaker, reason, within in (
        ("exception in the controller", ControllerRaises, "ZeroDivisionError", 0.3),
        ("clock jumps ahead", lambda: ClockJumps(3600.0), "between two cycles", 0.3),
        ("clock jumps back", lambda: ClockJumps(-3600.0), "between two cycles", 0.3),
        ("log disk full", DiskFull, "cannot be written", 1.5 + _SOFT),
        ("receive thread dies", ReceiverDies, "", 0.3),
    )
)


def _measured(case: Case) -> Outcome:
    with tempfile.TemporaryDirectory() as folder:
        return undisturbed(lambda place: run_case(case, place), Path(folder))


def main() -> None:
    """Measures every case once and prints the rows of the table."""
    print("| fault | wiring | motors off | throttle neutral | FD frames | the drive says |")
    print("|---|---|---|---|---|---|", flush=True)
    wanted = sys.argv[1:]
    for case in CASES:
        if wanted and not any(f"{case.name}-{case.wiring}".startswith(word) for word in wanted):
            continue
        found = _measured(case)
        times = [
            f"{value * 1000:.0f} ms" if math.isfinite(value) else "-"
            for value in (found.motors_off, found.throttle_neutral)
        ]
        print(f"| {case.name} | {case.wiring} | {times[0]} | {times[1]} | {found.exits} | {found.reason} |", flush=True)


if __name__ == "__main__":
    main()
