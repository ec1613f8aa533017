"""One drive from the checks to the log: check, arm, drive by sequence or by radio, disarm, write.

After anything in between (a fault, an exception, a signal, a failed start) the motors' exit frames
and throttle 0 go out, and the log is readable up to there.
"""

from __future__ import annotations

import math
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from aerodima.hardware.car.car_ports import CarPorts, emulator_delay, read_ports
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.driving.arming import (
    arm_motors,
    await_operator,
    await_permission,
    await_stop,
    check_standstill,
    may_arm,
)
from aerodima.hardware.driving.car_guard import CarGuard
from aerodima.hardware.driving.drive_checks import (
    Check,
    device_checks,
    motor_checks,
    preflight_checks,
    report,
)
from aerodima.hardware.driving.drive_result import HOUR, DriveOptions, DriveResult
from aerodima.hardware.driving.held_car import connect
from aerodima.hardware.driving.interrupts import (
    TimedPilot,
    end_time_limit,
    leave,
    stop_on_exit,
    stop_on_signals,
    time_limit,
)
from aerodima.hardware.driving.loop_delay import with_delay
from aerodima.hardware.driving.plain_loop import (
    AutoPilot,
    ControlPilot,
    ManualPilot,
    Pilot,
    idle_until,
    run_loop,
)
from aerodima.hardware.driving.run_journal import RunJournal, log_facts, open_run_journal
from aerodima.hardware.driving.speaker import Say, Speaker
from aerodima.hardware.driving.stop_posture import GONE
from aerodima.hardware.protocol.radio import RadioMode
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
from aerodima.workbench.core.terminal import await_reader, say_error
from aerodima.workbench.logs.schema import DIAGRAM, DRIVEN_BY, TAIL_LAW
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import UNARMED_SOURCES

if TYPE_CHECKING:
    from aerodima.workbench.car.car_diagram import Build

RUN_OVER = "the run is over"
_LATE_BEFORE = 1.0
"""Time before a stop in which an emulator that fell behind may be its cause, s."""
_WARM_UP_TIME = 10.0
"""Longest time for building and warming up the controller, s; a first tick may import modules."""
_LATE_ANSWERS = (*GONE, SourceFault.NO_SAMPLE_YET, SourceFault.NO_FIX)
"""Faults of a device that may still answer, or find its fix. A Teensy that received nothing yet
reports that its watchdog has acted; an IMU that is being set up counts as lost."""


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
    say: Say = say_error,
) -> DriveResult:
    """Drives the car with a diagram of your own: check, arm, drive, disarm, write the log.

    Guard, limits, watchdogs, signals and log are those of the scenario's own driver and tail law
    (`build` None). Once a 10 ms tick the diagram advances; a controller that is too slow, raises,
    or commands what is not finite stops the car, and its traceback is printed once. AUTO runs the
    diagram, MANUAL and CONTROL drive by radio.

    Args:
        build: function that builds the diagram, as `aerodima.workbench.simulate` takes it; called
            once, before the motors are on.
        scenario: scenario of the car; it says how long the run is.
        ports: path of the ports file, or the ports read from it; of an emulated car its `ports`.
        log: path of the Parquet file to write, with a column for each number that the diagram
            exports or logs.
        wiring: name of the wiring, one of `aerodima.hardware.car.wiring.WIRINGS`.
        arm: whether to arm without asking on the terminal.
        dry_run: whether never to arm; the diagram then runs with the car switched off.
        force: whether to replace an existing log.
        traffic: path of a new `.blf` file that records every frame on the adapter; not with
            `teensy_bridge`.
        say: function that receives every check, what is waited for, and the traceback of an error
            in the diagram.

    Raises:
        UserError: a check failed, a device or the record of a watchdog test is missing, the diagram
            cannot be built or fails before the car is armed, the log cannot be written; the motors
            are off by then.
    """
    car_ports = read_ports(ports)
    options = DriveOptions(log, force, dry_run, confirm=None if arm else may_arm)
    car = connect(car_ports, scenario, wiring, traffic)
    return DriveSession(car, scenario, car_ports, options, say, build=build).complete()


class DriveSession:
    """One drive of a car: `check`, `arm`, `run`, and `stop` in every case, as `complete` does.

    Args:
        car: car made by `connect`, not started yet.
        scenario: scenario of the car; it says how long the run is.
        ports: ports of the car.
        options: options of the drive.
        say: function that receives every check and what is waited for.
        law: tail law; by default the one that the scenario names.
        build: function that builds the diagram; see `drive`.

    Attributes:
        signals: numbers of the signals received, in order.
        result: result of the drive, once it is stopped.
    """

    def __init__(
        self,
        car: WiredCar,
        scenario: Scenario,
        ports: CarPorts,
        options: DriveOptions,
        say: Say,
        *,
        law: TailLaw | None = None,
        build: Build | None = None,
    ) -> None:
        self._safety = load_drive_safety()
        self._law = law or law_of_scenario(scenario)
        self._car = car
        self._guard = CarGuard(car, self._safety, has_tail=scenario.has_tail)
        self._scenario = scenario
        self._ports = ports
        self._options = options
        self._path = Path(options.log).absolute()  # a controller may change the working folder
        self._say = Speaker(say)
        self._build = build
        self._resources = ExitStack()
        self._mode = RadioMode.AUTO
        self._journal: RunJournal | None = None
        self._log: Path | None = None
        self.signals: list[int] = []
        self.result = DriveResult("", False, None)

    def complete(self) -> DriveResult:
        """Checks, arms and runs, and stops in every case; returns how the drive ended.

        Raises:
            UserError: a check failed, a device is missing, the log cannot be written; the motors
                are off by then.
        """
        try:
            self.check()
            if self.arm():
                self.run()
        except HardwareError as error:
            self._resources.close()
            if not self.signals:  # otherwise it follows from the signal
                raise HardwareError(self._with_cause(str(error))) from None
        finally:
            self.stop()
        return self.result

    # -- check

    def check(self) -> None:
        """Checks scenario and computer, opens the devices, checks them, and builds what drives.

        Raises:
            UserError: a check failed (in a dry run: before the devices are open), a device cannot
                be opened, the diagram cannot be built.
        """
        scenario = self._scenario
        refuse_existing(self._path, self._options.force, LogError)
        make_folder(self._path.parent, LogError)
        refuse_simulated_only(scenario, user_driver=self._build is not None)
        report(preflight_checks(scenario, self._path.parent, self._safety), self._say)
        if not self._options.dry_run:
            self._car.authorise()
        self.signals = self._resources.enter_context(
            stop_on_signals(self._stop_hard, self._give_up)
        )
        self._resources.enter_context(stop_on_exit(self._stop_hard))
        scheduling = prefer_realtime(DRIVE_PRIORITY)
        self._resources.callback(restore_ordinary)
        self._resources.callback(restore_latency)
        self._say(str(Check("scheduling", True if is_realtime() else None, scheduling)))
        self._resources.callback(self._stop_car)
        self._car.start()
        idle_until(self._guard, self._answers, self._safety.answer_timeout)
        # A device that had not answered when the operator stopped the car is not to blame.
        if self._guard.finished and not self._options.dry_run:
            raise HardwareError(self._guard.reason)
        checks = device_checks(self._car, self._guard.reading, self._safety)
        report(checks, self._say, refuse=not self._options.dry_run)
        self._sequence, self._columns = self._make_sequence()
        prefer_latency()

    def _stop_hard(self, reason: str) -> None:
        self._guard.stop(reason, time.monotonic(), "signal")

    def _give_up(self, cause: str) -> None:
        """Ends drive and program while a controller runs that no interrupt brings to an end."""
        guard = self._guard
        try:
            self._stop_hard(cause)
            self._car.stop(guard.reason)
            if self._journal is not None:
                stopped = guard.stop_time - (guard.cycle_times or [math.nan])[0]
                self._add_facts(self._journal, stopped)
                self._say(f"log: {self._journal.close()}")
        except LogError as error:
            self._say(str(error))
        finally:
            self._say(f"error: the drive ends at once: {guard.reason}")
            self._say.flush()
            await_reader()
            leave(1)

    def _stop_car(self) -> None:
        self._car.stop(self._guard.reason or "the drive is over")

    def _answers(self) -> bool:
        """Returns whether `UNARMED_SOURCES` and the watchdog answer; the checks name what is
        silent.
        """
        status = self._guard.reading.named_status._asdict()
        late = any(status[f"{source}_fault"] in _LATE_ANSWERS for source in UNARMED_SOURCES)
        return not late and not self._car.unwatched

    def _make_sequence(self) -> tuple[Pilot, list[str]]:
        """Builds the pilot of AUTO, which takes time, and warms it up; returns it with a diagram's
        own columns.
        """
        try:
            with time_limit(_WARM_UP_TIME):
                if not self._options.with_drake:
                    return AutoPilot(self._scenario, self._law), []
                from aerodima.hardware.driving.drive_diagram import DiagramPilot

                pilot = DiagramPilot(self._scenario, self._law, self._build)
                slowest = pilot.warm_up(self._guard.reading)
        except UserError:
            raise
        except BaseException as error:  # SystemExit too: it would end the program with status 0
            end_time_limit()
            text, reason = traceback_and_reason(error)
            self._say(text)
            raise HardwareError(f"the controller fails before the car is armed: {reason}") from None
        slow = self._safety.slow_tick
        text = f"a tick of it takes {slowest * 1000:.1f} ms; more than {slow * 1000:g} ms are slow"
        self._say(str(Check("diagram", True if slowest <= slow else None, text)))
        return pilot, pilot.columns

    # -- arm

    def arm(self) -> bool:
        """Opens the log, arms the motors and waits for the operator; a dry run only opens the log.

        Returns:
            Whether the car drives; otherwise it has stopped, and no log is kept.

        Raises:
            UserError: the log cannot be opened, nobody allows the car to be armed, a check failed,
                the motors do not answer.
        """
        self._journal = open_run_journal(
            self._path,
            self._scenario,
            self._car.name,
            self._options.force,
            self._columns,
            self._say,
        )
        drives = False
        try:
            if not self._options.dry_run:
                self._mode = self._arm_motors()
            drives = not self.signals and not self._guard.finished
            if not drives:
                await_stop(self._guard)
        finally:
            if not drives:
                self._stop_car()  # first: a slow disk may hold up the rest
                self._journal.discard()
        return drives

    def _arm_motors(self) -> RadioMode:
        """Arms the motors of a car that stands still; returns the mode that the operator chose."""
        guard = self._guard
        idle_until(guard, lambda: False, 0.1)  # what came while the diagram was built
        await_permission(guard, self._options.confirm)
        check_standstill(guard, self._safety, self._say)
        self._say("arming: keep clear of the tail")

        check = self._check_motors if self._car.motors else None
        arm_motors(guard, self._safety.arm_timeout, check)
        self._say("armed")
        return await_operator(guard, self._options.wait_for_operator, self._say)

    def _check_motors(self) -> None:
        checks = motor_checks(self._car, self._scenario, self._ports, self._safety)
        report(checks, self._say)

    # -- run

    def run(self) -> None:
        """Drives to the end of the run and writes the log, whatever happens."""
        guard = self._guard
        journal = self._journal
        assert journal is not None  # opened by `arm`
        by_radio = self._mode is not RadioMode.AUTO
        length = HOUR if by_radio else run_time(self._scenario)
        stopped = math.nan
        begin = time.monotonic()
        busy = time.process_time()
        try:
            pilot = TimedPilot(self._make_pilot(), self._safety.longest_tick)
            stopped = run_loop(guard, pilot, self._scenario, length, journal)
            guard.stop(RUN_OVER, time.monotonic())
            await_stop(guard)
        except BaseException as error:
            end_time_limit()
            guard.stop(type(error).__name__, time.monotonic(), "controller")
            with suppress(Exception):  # whatever it is, the motors must go off
                await_stop(guard)
            self._car.stop(guard.reason)  # before anything else: writing a log may take its time
            guard.hard = True  # though the operator may have ended the drive before
            # No signal raises: SystemExit and the like are the controller's, and end no program.
            text, guard.reason = traceback_and_reason(error)
            self._say(str(error) if isinstance(error, UserError) else text)
        finally:
            share = (time.process_time() - busy) / (time.monotonic() - begin)
            guard.reason = self._with_cause(guard.reason)
            journal.add_facts({"cpu_share": share})
            self._add_facts(journal, stopped)
            try:
                self._log = journal.close()
            except LogError as error:
                raise LogError(f"{error}; the car was stopped: {guard.reason}") from None

    def _with_cause(self, reason: str) -> str:
        """Returns the reason of a stop, the first time with an emulated car's delay as cause."""
        guard = self._guard
        delay = emulator_delay(self._ports.teensy.path, guard.stop_time - _LATE_BEFORE)
        least, guard.least_delay = guard.least_delay, math.inf
        return with_delay(reason, delay, least)

    def _make_pilot(self) -> Pilot:
        if self._mode is RadioMode.AUTO:
            return self._sequence
        if self._mode is RadioMode.MANUAL:
            return ManualPilot(self._scenario)
        return ControlPilot(self._scenario, self._law)

    def _add_facts(self, journal: RunJournal, stopped: float) -> None:
        """Writes to the log who drove and how it went; `stopped` is the stop time, s, or NaN."""
        guard = self._guard
        facts = log_facts(guard.reason, stopped, guard.cycle_times, guard.overruns)
        facts["slow_ticks"] = len(guard.slow_ticks)
        if self._mode is not RadioMode.AUTO:
            facts[DRIVEN_BY] = f"hand ({self._mode.name})"
        if self._build is not None:
            from aerodima.workbench.car.car_diagram import build_name

            facts[DIAGRAM] = build_name(self._build)
        if self._options.law_name:
            facts[TAIL_LAW] = self._options.law_name
        facts["ending"] = self._car.posture
        journal.add_facts(facts)

    # -- stop

    def stop(self) -> None:
        """Switches the motors off, closes the devices, and restores signals and scheduling."""
        guard = self._guard
        self._resources.close()
        guard.reason = self._with_cause(guard.reason)
        orderly = not guard.hard and (guard.reason == RUN_OVER or guard.left)
        self._say.flush()
        self.result = DriveResult(
            guard.reason,
            orderly and self._log is not None,
            self._log,
            self.signals[0] if self.signals else 0,
            self._car.traffic_error,
            self._car.posture,
        )
