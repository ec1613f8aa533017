"""A car that drives on the emulator until something goes wrong, and what was seen on its bus.

`python -m tests.hardware.emulator.fault_runs` measures the lines of
hardware/emulator/fault_table.csv.
"""

import gc
import math
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import PERIOD, CarCommand
from aerodima.hardware.car.wirings import wire_car
from aerodima.hardware.driving.arming import await_stop
from aerodima.hardware.driving.car_guard import CarGuard, Stage
from aerodima.hardware.driving.plain_loop import wait_until
from aerodima.hardware.protocol.ak70 import make_enter, make_exit
from aerodima.hardware.protocol.radio import OperatorPrompt, RadioMode
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.realtime import DRIVE_PRIORITY, prefer_realtime, restore_ordinary
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import STATUS
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed
from tests.hardware.emulator.fault_cases import AT, CASES, HELD, PITCH, ROLL
from tests.hardware.emulator.process_runs import CASES as PROCESS_CASES
from tests.hardware.emulator.process_runs import (
    REFUSED,
    acts_of,
    after,
    process_row,
    refused_row,
    run_process_case,
    run_refused_case,
    table_line,
)
from tests.hardware.emulator.process_runs import check as check_process
from tests.hardware.fake_can import wait_until as wait_for

SCENARIO = "turn_swing"
SETTINGS = ("simulation.step=0.004", "simulation.log_rate=250")
"""A car that takes a third of a processor instead of two thirds."""
RUN_OVER = "the run is over"
_AFTER = 0.2
"""s after the second motor was off in which exit frames are counted: those of ten cycles, or of the
watchdog."""
_LAST_WAIT = 2.0


class EndedEarlyError(AssertionError):
    """The drive had ended before the fault came, as it must on a computer that stands still; it
    showed nothing.
    """


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


def open_car(scenario, ports, wiring):
    """The car on the emulator, without the record of a watchdog test."""
    return wire_car(scenario, ports, wiring, lambda: None)


def drive_until_stopped(guard, run_time, command_at, breaker):
    """Arms, drives with the commands for `run_time` s, and lets the car stop."""

    def turn(condition, limit, command):
        begin = due = time.monotonic()
        while not condition():
            now = time.monotonic()
            if now - begin > limit:
                return False
            breaker.turn(guard)
            cycle = breaker.clock()
            guard.read(cycle, due if guard.stage is Stage.DRIVING else None)
            guard.write(command(now), cycle)
            due = max(due + PERIOD, now - 0.05)
            wait_until(due)
        return True

    def idle(_):
        return CarCommand()

    def chosen():
        return (
            guard.prompt is OperatorPrompt.SELECT_MODE
            and guard.reading.operator.mode is RadioMode.AUTO
        )

    if not turn(lambda: _heard(guard) and not guard.wiring.unwatched, 10.0, idle):
        raise EndedEarlyError(guard.reading.fault_text)
    guard.arm(time.monotonic())
    if not turn(lambda: chosen() or guard.finished, 5.0, idle) or guard.finished:
        raise EndedEarlyError(guard.reason or guard.reading.fault_text)
    began = time.monotonic()
    guard.drive(RadioMode.AUTO, began)
    turn(lambda: guard.finished, run_time, lambda now: command_at(now - began))
    guard.stop(RUN_OVER, breaker.clock())
    turn(lambda: guard.finished, 3.0, idle)


def _heard(guard):
    """Something has been read, every source but the motors has been heard, and none has a fault."""
    status = STATUS.read(guard.reading.status)
    faults = (status.sail_fault, status.imu_fault, status.speed_fault, status.operator_fault)
    return status.operator_age > 0.0 and not any(faults)


def run_case(case, folder):
    """Drives on the emulator with the fault of a case."""
    entries = () if case.fault is None else (case.fault, *case.also)
    faults = [{"time": AT, **entry} for entry in entries]
    scenario = load_scenario(SCENARIO, list(SETTINGS))
    script = {"clock": "driving", "faults": faults, "operator": list(case.operator)}
    with EmulatorProcess(folder, scenario, case.wiring, script) as emulator:
        car = open_car(scenario, emulator.ports, case.wiring)
        guard = CarGuard(car, load_drive_safety())
        good = CarCommand(0.1, 0.3, PITCH, ROLL)
        breaker = case.breaker()

        def command_at(since):
            if since >= AT and breaker.struck is None:
                breaker.strike()
            if since < AT or case.broken_command is None:
                return good
            return (
                case.broken_command(since - AT)
                if callable(case.broken_command)
                else case.broken_command
            )

        prefer_realtime(DRIVE_PRIORITY)  # as the drive does
        try:
            car.start()
            breaker.begin(car, scenario, folder)
            gc.collect()
            gc.freeze()  # as the drive does: no pause of the collector within the run
            drive_until_stopped(guard, case.run_time, command_at, breaker)
        except ArithmeticError as error:  # as a drive does it
            reason = f"{type(error).__name__}: {error}"
            guard.stop(reason, time.monotonic(), "controller")
            await_stop(guard)
        finally:
            car.stop("over")
            restore_ordinary()
            gc.unfreeze()
        if case.of_the_computer and breaker.struck is None:
            raise EndedEarlyError(guard.reason)
        breaker.end()
        began = breaker.struck if case.of_the_computer else _fault_time(emulator.events, case)
        if began is None:
            raise EndedEarlyError(guard.reason)
        wait_for(lambda: not any(map(math.isnan, after(emulator, began))), _LAST_WAIT)
        time.sleep(_AFTER)
    return _outcome(guard.reason, began, emulator, emulator.traffic())


def _fault_time(events, case):
    name = "fault_on" if case.fault is not None else "script_begins"
    came = next((event["time_s"] for event in events if event["event"] == name), None)
    if came is None or case.fault is not None:
        return came
    return came + next(entry["time"] for entry in case.operator if entry.get("stop"))


def _outcome(reason, began, emulator, traffic):
    off, neutral = after(emulator, began)
    clock = time.time() - time.monotonic()
    sent = [
        (message.timestamp - clock - began, bytes(message.data))
        for message in traffic
        if not message.is_rx
    ]
    exits = sum(0.0 <= at <= off + _AFTER and data == make_exit(1).data for at, data in sent)
    enters = sum(at >= 0.0 and data == make_enter(1).data for at, data in sent)
    return Outcome(reason, off, neutral, exits, enters)


def check(case, found):
    """What the row promises; what was found."""
    if not case.stops:
        assert found.reason == RUN_OVER, found.reason
        return found
    assert case.reason in found.reason, found.reason
    assert found.reason != RUN_OVER
    assert found.motors_off <= case.within + HELD * case.held, found
    assert found.throttle_neutral <= (case.throttle_within or case.within), found
    assert found.exits >= 6, "several frames to each motor"
    assert found.entered_again == 0, "nothing is armed again by itself"
    return found


def row(case, found):
    """A line of the fault table."""
    if not case.stops:
        return table_line(case.name, case.wiring, "-", "-", "-", case.acts)
    off, neutral = (f"{value * 1000:.0f}" for value in (found.motors_off, found.throttle_neutral))
    return table_line(case.name, case.wiring, off, neutral, found.exits, acts_of(case))


KINDS = (
    (CASES, lambda case, folder: check(case, run_case(case, folder)), row),
    (
        PROCESS_CASES,
        lambda case, folder: check_process(case, run_process_case(case, folder)),
        process_row,
    ),
    (REFUSED, run_refused_case, refused_row),
)
"""Cases, what measures one in a folder, and what makes a line of that."""


def main():
    """Measures the cases whose names are given, or all, once, and prints the lines of the table."""
    chosen = [
        (case, measure, line)
        for cases, measure, line in KINDS
        for case in cases
        if not sys.argv[1:] or case.name in sys.argv[1:]
    ]
    for case, measure, line in chosen:
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = undisturbed(lambda place: measure(case, place), Path(folder))  # noqa: B023
                print(line(case, found), flush=True)
            except (AssertionError, HardwareError) as error:  # a computer that stands still
                text = f"not measured: {str(error)[:200]}"
                print(table_line(case.name, case.wiring, text), flush=True)


if __name__ == "__main__":
    main()
