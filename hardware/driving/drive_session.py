"""One drive from the checks to the log: check, arm, drive by sequence or by radio, disarm, write.

After anything in between (a fault, an exception, a signal, a failed start) the motors' exit frames
and throttle 0 go out, and the log is readable up to there.
"""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from aerodima.hardware.car.car_ports import CarPorts, read_ports
from aerodima.hardware.car.safety_settings import DriveSafety, load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import CarReading
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.driving.car_guard import CarGuard, Stage
from aerodima.hardware.driving.drive_checks import (
    Check,
    desk_checks,
    device_checks,
    motor_checks,
    refuse_failed,
    standstill_checks,
    watchdog_check,
)
from aerodima.hardware.driving.held_car import connect
from aerodima.hardware.driving.plain_loop import (
    AutoPilot,
    ControlPilot,
    ManualPilot,
    Pilot,
    PilotStep,
    idle_until,
    run_loop,
)
from aerodima.hardware.driving.run_journal import RunJournal, log_facts, open_run_journal
from aerodima.hardware.protocol.radio import Asks, RadioMode
from aerodima.workbench.control.driver_law import refuse_simulated_only
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import run_time
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.control.user_law import traceback_and_reason
from aerodima.workbench.core.atomic_write import make_folder, refuse_existing
from aerodima.workbench.core.errors import HardwareError, LogError, UserError
from aerodima.workbench.core.realtime import (
    DRIVE_PRIORITY,
    is_realtime,
    prefer_latency,
    prefer_realtime,
    restore_latency,
    restore_ordinary,
)
from aerodima.workbench.logs.schema import DIAGRAM, DRIVEN_BY, TAIL_LAW
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import STATUS, UNARMED_SOURCES

if TYPE_CHECKING:
    from aerodima.workbench.car.car_diagram import Build

_HOUR = 3600.0
"""s; the longest drive by radio."""
_SETTLE = 0.5
"""s with the motors holding before their replies are judged."""
RUN_OVER = "the run is over"
_REST_NOTICE = 0.5
"""s in which a switch at IDLE is received; after that the drive prints what it waits for."""
_REHEARSAL_TIME = 10.0
"""s; a first tick may import what it needs."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True)
class DriveResult:
    """How a drive ended.

    Attributes:
        reason: `RUN_OVER`, or why it was stopped.
        orderly: the run came to its end, or the operator ended it without an emergency and reported
            until then.
        log: the run log, elsewhere than was asked for when that place took none; None when none was
            written.
        signal: number of the signal that ended it; 0 for none.
        traffic_error: why the log of the CAN traffic is not whole; empty if it is, or if there is
            none.
    """

    reason: str
    orderly: bool
    log: Path | None
    signal: int = 0
    traffic_error: str = ""


@dataclass(frozen=True)
class DriveOptions:
    """How to drive.

    Attributes:
        log: the run log to be written.
        force: replace it.
        dry_run: never arm; the sequence runs with the car switched off.
        with_drake: the diagram in Drake's simulator, otherwise the plain loop.
        confirm: asks somebody beside the car whether it may be armed; None arms without asking.
        wait_for_operator: s until the operator must have chosen AUTO or MANUAL, out of IDLE.
        law_name: for the log, of a tail law that the scenario does not name; empty for one that it
            names.
    """

    log: str | Path
    force: bool = False
    dry_run: bool = False
    with_drake: bool = True
    confirm: Callable[[], bool] | None = None
    wait_for_operator: float = _HOUR
    law_name: str = ""


def _say_on_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def drive(
    build: Build | None,
    scenario: Scenario,
    ports: str | Path | CarPorts,
    log: str | Path,
    *,
    wiring: str = "teensy_bridge",
    arm: bool = False,
    dry_run: bool = False,
    force: bool = False,
    traffic: str | Path | None = None,
    say: Callable[[str], None] = _say_on_stderr,
) -> DriveResult:
    """Drives the car with a diagram of your own: check, arm, drive, disarm, write the log.

    Guard, limits, watchdogs, signals and log are those of the scenario's own driver and tail law
    (`build` None). Once a 10 ms tick the diagram advances; a controller that is too slow, raises,
    or commands what is not finite stops the car, and its traceback is printed once. AUTO runs the
    diagram, MANUAL and CONTROL drive by radio.

    Args:
        build: as `aerodima.workbench.simulate` takes it; called once, before the motors are on.
        scenario: of the car; says how long the run is.
        ports: the ports file, or what is in it; of an emulated car its `ports`.
        log: the Parquet file to be, with a column for each number that the diagram exports or logs.
        wiring: of `aerodima.hardware.car.wiring.WIRINGS`.
        arm: arm without asking on the terminal.
        dry_run: never arm; the diagram runs with the car switched off.
        force: replace an existing log.
        traffic: a new `.blf` file for every frame on the adapter; not with `teensy_bridge`.
        say: receives every check, what is waited for, and the traceback of an error in the diagram.

    Raises:
        UserError: a check failed, a device or the record of a watchdog test is missing, the diagram
            cannot be built or fails before the car is armed, the log cannot be written; the motors
            are off by then.
    """
    refuse_existing(Path(log), force, LogError)
    make_folder(Path(log).parent, LogError)
    if isinstance(ports, CarPorts):
        there = ports
    else:
        there = read_ports(ports)
    options = DriveOptions(log, force, dry_run, confirm=None if arm else _asked)
    return run_drive(
        connect(there, scenario, wiring, traffic), scenario, there, options, say, build=build
    )


def _asked() -> bool:
    return input("keep clear of the tail; type arm to switch the motors on: ") == "arm"


def run_drive(
    car: WiredCar,
    scenario: Scenario,
    ports: CarPorts,
    options: DriveOptions,
    say: Callable[[str], None] = _say_on_stderr,
    *,
    law: TailLaw | None = None,
    build: Build | None = None,
) -> DriveResult:
    """Drives a scenario on a car of `connect` that is not started yet.

    Args:
        say: receives every check and what is waited for.
        law: of the tail; by default the one that the scenario names.
        build: see `drive`.

    Raises:
        UserError: a check failed, a device is missing, the log cannot be written; the motors are
            off by then.
    """
    safety = load_drive_safety()
    law = law or law_of_scenario(scenario)
    refuse_simulated_only(scenario, own_driver=build is not None)
    _tell(desk_checks(scenario, Path(options.log).parent, safety), say)
    if not options.dry_run:
        car.authorise()
    guard = CarGuard(car, safety, has_tail=scenario.tail.mode != "none")

    def stop(name: str) -> None:
        guard.stop(name, time.monotonic(), hard=True)

    with _stop_on_signals(stop) as came:
        scheduling = prefer_realtime(DRIVE_PRIORITY)
        say(str(Check("scheduling", True if is_realtime() else None, scheduling)))
        try:
            car.start()
            result = _on_open_devices(
                _Drive(car, guard, scenario, law, ports, options, safety, say, build), came
            )
        except HardwareError:
            if came:  # before the run began: what follows from the signal is no error of its own
                return DriveResult(guard.reason, False, None, came[0])
            raise
        finally:
            car.stop(guard.reason or "the drive is over")
            restore_latency()
            restore_ordinary()
    return replace(result, traffic_error=car.traffic_error)


class TickTimeout(BaseException):
    """Raised within a controller that takes too long; of no kind that it may want to catch."""


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Raises `TickTimeout` within the block, and again, once it takes longer; what no signal
    reaches goes on.
    """
    signal.setitimer(signal.ITIMER_REAL, seconds, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


class _TimedPilot(Pilot):
    """A pilot whose tick is interrupted when it takes too long."""

    def __init__(self, pilot: Pilot, longest: float) -> None:
        self.start, self._step, self._longest = pilot.start, pilot.step, longest  # type: ignore[method-assign]

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """See `Pilot`."""
        with _at_most(self._longest):
            return self._step(time, reading)


@contextmanager
def _stop_on_signals(stop: Callable[[str], None]) -> Iterator[list[int]]:
    """Calls `stop` with the name of a signal, which asks the loop to stop; the list holds the
    numbers that came.
    """
    came: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        came.append(number)
        stop(signal.Signals(number).name)

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise TickTimeout("the controller does not come to an end")

    before = {number: signal.signal(number, handle) for number in _SIGNALS}
    before[signal.SIGALRM] = signal.signal(signal.SIGALRM, interrupt)
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass
class _Drive:
    car: WiredCar
    guard: CarGuard
    scenario: Scenario
    law: TailLaw
    ports: CarPorts
    options: DriveOptions
    safety: DriveSafety
    say: Callable[[str], None]
    build: Build | None


def _on_open_devices(drive: _Drive, came: list[int]) -> DriveResult:
    guard = drive.guard
    options = drive.options
    _wait_for_devices(drive)
    checks = device_checks(guard.reading, drive.car.gps_time, drive.safety)
    checks.append(watchdog_check(drive.car.name, drive.car.unwatched))
    _tell(checks, drive.say, refuse=not options.dry_run)
    pilot, own = _prepare(drive)
    journal = open_run_journal(
        Path(options.log), drive.scenario, drive.car.name, options.force, own, drive.say
    )
    try:
        if options.dry_run:
            mode = RadioMode.AUTO
        else:
            mode = _arm_and_choose(drive)
    except BaseException:
        journal.discard()
        raise
    if came or guard.finished:
        _let_stop(guard)
        journal.discard()
        return DriveResult(guard.reason, False, None, came[0] if came else 0)
    log = _logged_run(drive, journal, pilot(mode), mode)
    orderly = not guard.hard and (guard.reason == RUN_OVER or guard.left)
    return DriveResult(guard.reason, orderly, log, came[0] if came else 0)


def _wait_for_devices(drive: _Drive) -> None:
    """Until `UNARMED_SOURCES` and the watchdog are heard; what is still silent then is named by the
    checks.
    """
    faults = [STATUS.index(f"{source}_fault") for source in UNARMED_SOURCES]
    # A Teensy that heard nothing yet reports that its watchdog has acted; an IMU that is being set
    # up counts as lost.
    waiting = (
        SourceFault.NO_SAMPLE_YET,
        SourceFault.SILENT,
        SourceFault.REPORTED,
        SourceFault.LOST,
    )
    idle_until(
        drive.guard,
        lambda: (
            not (
                any(drive.guard.reading.status[index] in waiting for index in faults)
                or drive.car.unwatched
            )
        ),
        drive.safety.answer_timeout,
    )


def _arm_and_choose(drive: _Drive) -> RadioMode:
    idle_until(drive.guard, lambda: False, 0.1)  # what came while the diagram was built
    _ask(drive)
    _look_at_standing_car(drive)
    _arm(drive)
    return _wait_for_operator(drive)


def _look_at_standing_car(drive: _Drive) -> None:
    """Refuses a car that is moved, lies on its side, or whose IMU has frozen."""
    seen: dict[float, Bno055Sample] = {}
    imu = None if drive.car.devices is None else drive.car.devices.imu

    def collect() -> bool:
        if imu is not None and imu.newest is not None:
            seen[imu.newest[0]] = imu.newest[1]
        return False

    idle_until(drive.guard, collect, drive.safety.still_time)
    _tell(standstill_checks(list(seen.values()), drive.guard.reading.imu, drive.safety), drive.say)


def _ask(drive: _Drive) -> None:
    """Waits for the answer with the loop turning, so that no device falls silent meanwhile."""
    confirm = drive.options.confirm
    if confirm is None:
        return
    answers: list[bool] = []
    threading.Thread(target=lambda: answers.append(confirm()), name="confirm", daemon=True).start()
    idle_until(drive.guard, lambda: bool(answers or drive.guard.reason), _HOUR)
    if drive.guard.reason or not answers or not answers[0]:
        raise HardwareError(
            f"not armed: {drive.guard.reason or 'nobody said that the car may be armed'}"
        )


def _arm(drive: _Drive) -> None:
    guard = drive.guard
    say = drive.say
    say("arming: keep clear of the tail")
    guard.arm(time.monotonic())
    if not idle_until(guard, lambda: guard.ready, drive.safety.arm_timeout):
        reason = (
            guard.reason or f"the motors do not take commands within {drive.safety.arm_timeout:g} s"
        )
        guard.stop(reason, time.monotonic(), hard=True)
        _let_stop(guard)
        raise HardwareError(f"arming failed: {reason}")
    if drive.scenario.tail.mode != "none":
        idle_until(guard, lambda: False, _SETTLE)
        checks = motor_checks(drive.car, drive.scenario, drive.ports, drive.safety)
        try:
            _tell(checks, say)
        except HardwareError as error:
            guard.stop(str(error), time.monotonic(), hard=True)
            _let_stop(guard)
            raise
    say("armed")


def _wait_for_operator(drive: _Drive) -> RadioMode:
    guard = drive.guard
    wanted = (RadioMode.AUTO, RadioMode.MANUAL, RadioMode.CONTROL)
    end = time.monotonic() + drive.options.wait_for_operator
    if not idle_until(
        guard,
        lambda: guard.asks is not Asks.REST,
        min(_REST_NOTICE, drive.options.wait_for_operator),
    ):
        stands = guard.reading.operator.mode.name
        drive.say(
            f"the operator's switch stands on {stands}: put it in IDLE first; nothing is obeyed "
            "before"
        )
        idle_until(guard, lambda: guard.asks is not Asks.REST, end - time.monotonic())
    if guard.asks is Asks.CHOICE:
        drive.say(
            "waiting for the operator: AUTO runs the sequence, MANUAL and CONTROL drive by radio"
        )
    chosen = idle_until(
        guard,
        lambda: guard.asks is Asks.CHOICE and guard.reading.operator.mode in wanted,
        end - time.monotonic(),
    )
    if not chosen and not guard.reason:
        reason = (
            "chose neither AUTO nor MANUAL nor CONTROL"
            if guard.rested
            else "did not put the switch in IDLE"
        )
        guard.stop(f"the operator {reason}", time.monotonic())
    if not chosen:
        _let_stop(guard)
        return RadioMode.IDLE
    mode = guard.reading.operator.mode
    guard.drive(mode, time.monotonic())
    drive.say(f"driving: {mode.name}")
    return mode


def _logged_run(drive: _Drive, journal: RunJournal, pilot: Pilot, mode: RadioMode) -> Path:
    """The run with its log, then the end of it; the log is closed whatever happened."""
    guard = drive.guard
    stopped = math.nan
    by_hand = mode is not RadioMode.AUTO
    scenario = drive.scenario
    if by_hand:
        journal.add_facts({DRIVEN_BY: f"hand ({mode.name})"})
    begin = time.monotonic()
    busy = time.process_time()
    try:
        timed = _TimedPilot(pilot, drive.safety.longest_tick)
        stopped = run_loop(
            guard, timed, scenario, _HOUR if by_hand else run_time(scenario), journal
        )
        guard.stop(RUN_OVER, time.monotonic())
        _let_stop(guard)
    except BaseException as error:
        guard.stop(f"{type(error).__name__}: {error}", time.monotonic(), hard=True)
        drive.car.stop(guard.reason)  # before anything else: writing a log may take its time
        if isinstance(error, HardwareError | LogError) or not isinstance(
            error, Exception | TickTimeout
        ):
            raise
        text, guard.reason = traceback_and_reason(error)
        drive.say(str(error) if isinstance(error, UserError) else text)
    finally:
        share = (time.process_time() - busy) / (time.monotonic() - begin)
        journal.add_facts(
            {
                **log_facts(guard.reason, stopped, guard.cycle_times, guard.overruns),
                "cpu_share": share,
            }
        )
        journal.add_facts({"slow_ticks": len(guard.slow_ticks)})
        if drive.build is not None:
            from aerodima.workbench.car.car_diagram import build_name

            journal.add_facts({DIAGRAM: build_name(drive.build)})
        if drive.options.law_name:
            journal.add_facts({TAIL_LAW: drive.options.law_name})
        path = journal.close()
    return path


def _prepare(drive: _Drive) -> tuple[Callable[[RadioMode], Pilot], list[str]]:
    """Builds what takes time; a function that gives the pilot of a mode, and the columns of a
    diagram's own.
    """
    scenario = drive.scenario
    law = drive.law
    own = list[str]()
    if not drive.options.with_drake:
        sequence: Pilot = AutoPilot(scenario, law)
    else:
        try:
            with _at_most(_REHEARSAL_TIME):
                sequence, own = _diagram(drive)
        except UserError:
            raise
        except (Exception, TickTimeout) as error:
            text, reason = traceback_and_reason(error)
            drive.say(text)
            raise HardwareError(f"the diagram fails before the car is armed: {reason}") from None

    def pilot(mode: RadioMode) -> Pilot:
        if mode is RadioMode.AUTO:
            return sequence
        if mode is RadioMode.MANUAL:
            return ManualPilot(scenario)
        return ControlPilot(scenario, law)

    prefer_latency()
    return pilot, own


def _diagram(drive: _Drive) -> tuple[Pilot, list[str]]:
    from aerodima.hardware.driving.drive_diagram import DiagramPilot

    pilot = DiagramPilot(drive.scenario, drive.law, drive.build)
    longest = pilot.rehearse(drive.guard.reading)
    slow = drive.safety.slow_tick
    text = f"a tick of it takes {longest * 1000:.1f} ms; more than {slow * 1000:g} ms are slow"
    drive.say(str(Check("diagram", True if longest <= slow else None, text)))
    return pilot, pilot.columns


def _let_stop(guard: CarGuard) -> None:
    """Turns the loop until the motors are off; one that was never armed has nothing to wait for."""
    if guard.stage is not Stage.READY:
        idle_until(guard, lambda: guard.finished, 5.0)


def _tell(checks: list[Check], say: Callable[[str], None], refuse: bool = True) -> None:
    for check in checks:
        say(str(check))
    if refuse:
        refuse_failed(checks)
