"""Whole drives as processes of their own, killed, stopped or tipped over: the rows of the fault
table that need one.
"""

import csv
import io
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from aerodima.hardware.car.car_ports import JOINTS, PORTS_FILE
from aerodima.hardware.car.safety_settings import load_drive_safety, load_teensy_timing
from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8, decode_reply
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.scenario.scenario import load_scenario
from tests.hardware import own_diagram
from tests.hardware.emulator.emulator_process import EmulatorProcess
from tests.hardware.fake_can import wait_until

SETTINGS = ("simulation.step=0.004", "simulation.log_rate=250")
MARGIN = 0.1
"""s; for processes that share a busy computer."""
_CONFIRMED = 1.0
"""s within which a stop is reported to the console."""
_HELD = load_drive_safety().max_tail_hold
_FIRMWARE, _LONGEST = load_teensy_timing().watchdog_timeout, load_drive_safety().longest_tick


@dataclass
class Found:
    """Times in s since the cause; NaN: never. status: exit status of the drive; None while it lives
    or was killed.

    confirmed: whether a console took its stop as confirmed within `_CONFIRMED`; None without a
    console.
    """

    motors_off: float
    throttle_neutral: float
    status: int | None
    said: str
    confirmed: bool | None = None


@dataclass(frozen=True)
class ProcessCase:
    """A row. within: s from the cause to motors off and neutral throttle. cause: done to the drive;
    it returns when.
    """

    name: str
    wiring: str
    cause: Callable[[subprocess.Popen[str], EmulatorProcess], float]
    within: float
    acts: str
    scenario: str = "turn_swing"
    settings: tuple[str, ...] = SETTINGS
    operator: tuple[dict, ...] = ({"time": 0.0, "mode": "auto_when_asked"},)
    reason: str = ""
    throttle_within: float = 0.0
    """0: as `within`."""
    faults: tuple[dict, ...] = ()
    confirmed: bool | None = None
    """Given: somebody at the console drives, and its stop is confirmed or not."""
    held: bool = False
    """The tail is held first: the motors go off up to `_HELD` later."""
    diagram: str = ""
    """Function of `tests/hardware/own_diagram.py` that drives; empty: the scenario's own law,
    without Drake."""


def kill(number):
    """A signal to the drive alone."""

    def cause(process, _):
        os.kill(process.pid, number)
        return time.monotonic()

    return cause


def stop_for_a_while(process, _):
    """SIGSTOP, and 0.3 s later SIGCONT."""
    since = time.monotonic()
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(0.3)
    os.kill(process.pid, signal.SIGCONT)
    return since


def second_console(process, emulator):
    """Another console on the same module is refused; the first one goes on driving and stops the
    car.
    """
    command = ["console", "--ports", str(emulator.folder / PORTS_FILE), "--port", "0"]
    record = ["--record", str(emulator.folder / "second.jsonl")]
    second = subprocess.run(
        [sys.executable, "-m", "aerodima", *command, *record],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert second.returncode != 0
    assert "a console" in second.stderr, second.stderr
    return presses_stop(process, emulator)


def tips_over(process, emulator):
    """Waits until the simulated car itself has rolled beyond the limit, as its events say."""
    del process
    assert wait_until(lambda: emulator.named("tipped"), 20.0), "the car stays on its wheels"
    return float(emulator.named("tipped")[0]["time_s"])


def presses_stop(process, emulator):
    """The operator at the console, after a second of driving: the fault is on by then, where there
    is one.
    """
    del process
    time.sleep(1.0)
    return emulator.operator.press_stop()


def breaks(process, emulator):
    """Waits until the diagram breaks by itself."""
    del process
    path = emulator.folder.parent / "broke"
    assert wait_until(path.exists, 20.0), "nothing breaks"
    return float(path.read_text())


_FAST_TURN = (*SETTINGS, "manoeuvre.speed=3.9")
_MANUAL = (
    {"time": 0.0, "mode": "manual_when_asked", "throttle": 0.34},
    {"time": 3.5, "mode": "manual_when_asked", "throttle": 0.34, "steering": 0.52},
)


def _on_both(name, cause, within, acts, **keys):
    return tuple(ProcessCase(name, wiring, cause, within, acts, **keys) for wiring in WIRINGS)


def _rollover(mode, **keys):
    scenario = {"scenario": "turn_none", "settings": _FAST_TURN, "reason": "degrees"}
    return _on_both(f"rollover in {mode}", tips_over, 0.3, "drive", **scenario, **keys)


def _console(name, acts, cause=presses_stop, faults=()):
    stopped = {"reason": "emergency stop", "faults": faults, "confirmed": not faults}
    return _on_both(name, cause, 0.3, acts, **stopped)


def _diagram(name, function, within, reason, acts, held=True):
    return _on_both(name, breaks, within, acts, reason=reason, diagram=function, held=held)


_STOPPED = "drive stopped for 300 ms and continued"
_IN_TIME = _FIRMWARE + MARGIN
CASES = (
    *_on_both("SIGKILL of the drive process", kill(signal.SIGKILL), _IN_TIME, "firmware"),
    *_on_both("drive process hangs (SIGSTOP)", kill(signal.SIGSTOP), _IN_TIME, "firmware"),
    *(
        ProcessCase(
            _STOPPED, wiring, stop_for_a_while, _IN_TIME, "firmware; the drive ends", reason=reason
        )
        for wiring, reason in (
            ("teensy_bridge", "the Teensy"),
            ("watched_can", "tail"),
        )
    ),
    *_rollover("AUTO"),
    *_rollover("MANUAL", operator=_MANUAL),
    *_console("emergency stop at the console", "drive; confirmed"),
    *_console(
        "foreign confirmation",
        "drive; not confirmed",
        faults=({"time": 0.5, "fault": "foreign_module"},),
    ),
    *_console("two consoles", "drive; second console refused", second_console),
    *_diagram(
        "exception in a diagram", "raises", 0.3, "ZeroDivisionError: in my controller", "drive"
    ),
    *_diagram("NaN from a diagram", "commands_nan", 0.3, "NaN", "drive"),
    *_diagram(
        "diagram stalls for 50 ms in every tick", "stalls", 0.5, "ms", "drive: five slow ticks"
    ),
    *_diagram(
        "infinite loop in a diagram",
        "hangs",
        _LONGEST + MARGIN,
        "TickTimeout",
        "drive: interrupts it",
    ),
    *_diagram(
        "infinite loop that cannot be interrupted",
        "hangs_for_good",
        _IN_TIME,
        "",
        "firmware",
        False,
    ),
)


@dataclass(frozen=True)
class RefusedCase:
    """A car that must not be armed. fault: entry of the script, on before the drive. reason: what
    the drive says.

    damage: done to the settings between the checks and the arming, in place of a fault. enters: the
    motors are switched on, with little torque.
    """

    name: str
    wiring: str
    fault: dict | None
    reason: str
    damage: Callable[[EmulatorProcess, Path], None] | None = None
    enters: bool = False


def cut_settings(emulator, record):
    """The ports file and the record of the watchdog test lose their second half."""
    for path in (emulator.folder / PORTS_FILE, record):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


REFUSED: tuple[RefusedCase, ...] = tuple(
    RefusedCase(name, wiring, *rest)
    for name, *rest in (
        ("no GPS fix before arming", {"fault": "fix_lost"}, "speed: the GPS has no fix"),
        ("frozen IMU before arming", {"fault": "frozen", "part": "imu"}, "IMU"),
        (
            "car on its side before arming",
            {"fault": "tipped_over"},
            "90 degrees",
        ),
        (
            "settings damaged between check and arming",
            None,
            "watched_can.json|teensy_bridge.json",
            cut_settings,
        ),
        *(
            (
                f"{what} of the {joint} motor reversed before arming",
                entry,
                f"tail {joint}",
                None,
                True,
            )
            for what, fault in (("feedback", "feedback_reversed"), ("sign", "motor_reversed"))
            for joint in ("pitch", "roll")
            for entry in [{"fault": fault, "part": f"tail_{joint}"}]
        ),
    )
    for wiring in WIRINGS
)


_TESTED_WITHIN = 8.0
"""s after the start of the emulator, at which the fault comes on: the watchdog test needs a car
that is well."""


def run_refused_case(case, folder):
    """Tries to drive; neither motors nor throttle may come on.

    The most torque that the motors made, N m.
    """
    car = load_scenario("turn_swing", list(SETTINGS))
    script = {
        "clock": "start",
        "faults": [{"time": _TESTED_WITHIN, **case.fault}] if case.fault else [],
    }
    with EmulatorProcess(folder, car, case.wiring, script) as emulator:
        begun = time.monotonic()
        _, record = run_watchdog_test(
            car, emulator.ports, emulator.wiring, lambda _: True, "emulator"
        )
        rest = begun + _TESTED_WITHIN - time.monotonic()
        assert rest > 0.0, "the watchdog test met the fault"
        time.sleep(rest)
        before = len(emulator.named("entered"))
        process = _start(emulator, folder, "turn_swing", SETTINGS, arm=case.damage is None)
        if case.damage is not None:
            for line in process.stdout:
                if "watchdog: " in line:  # the last check before the question
                    break
            case.damage(emulator, record)
        said = process.communicate("arm\n" if case.damage else None, timeout=60.0)[0]
        assert process.returncode not in (0, None), said
        assert re.search(case.reason, said), said
        assert len(emulator.named("entered")) - before == (2 if case.enters else 0)
        assert not emulator.named("throttle_on")
    return _largest_torque(emulator) if case.enters else 0.0


def _largest_torque(emulator):
    """In the replies of the last arming, N m."""
    since = (
        max(event["time_s"] for event in emulator.named("entered"))
        + time.time()
        - time.monotonic()
        - 0.05
    )
    replies = [
        decode_reply(CanFrame(message.arbitration_id, bytes(message.data)), AK70_10_V1_0_8)
        for message in emulator.traffic()
        if message.is_rx and message.timestamp >= since
    ]
    most = max(abs(reply.torque) for reply in replies)
    assert most < 2.5, f"{most:.1f} N m before it was refused"
    return most


def _start(
    emulator,
    folder,
    scenario,
    settings,
    arm=True,
    diagram="",
):
    words = [word for setting in settings for word in ("--set", setting)]
    ports = str(emulator.folder / PORTS_FILE)
    log = str(folder / "drive.parquet")
    command = [
        "drive",
        "run",
        scenario,
        *words,
        "--ports",
        ports,
        "--wiring",
        emulator.wiring,
        "--out",
        log,
    ]
    driver = ["--diagram", f"{own_diagram.__file__}:{diagram}"] if diagram else ["--no-drake"]
    return subprocess.Popen(
        [sys.executable, "-m", "aerodima", *command, *driver, *(["--arm"] if arm else [])],
        env={**os.environ, own_diagram.BROKE_FILE: str(folder / "broke")},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def acts_of(case):
    """What acts, and whether it holds the tail before the motors go off."""
    return case.acts if not case.held or "held" in case.acts else f"{case.acts}, held"


def table_line(*cells):
    """A line of hardware/emulator/fault_table.csv."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="").writerow(cells)
    return stream.getvalue()


def refused_row(case, torque):
    """A line of the fault table."""
    found = f"{torque:.1f} N m" if case.enters else "never on"
    return table_line(
        case.name,
        case.wiring,
        found,
        "never on",
        "seen" if case.enters else "-",
        "drive: not armed",
    )


@contextmanager
def driving(emulator, folder, case, car):
    """A drive process that drives, after a watchdog test of its wiring on this emulator."""
    if car.tail.mode != "none":
        run_watchdog_test(car, emulator.ports, emulator.wiring, lambda _: True, "emulator")
    entered = len(emulator.named("entered"))
    process = _start(emulator, folder, case.scenario, case.settings, diagram=case.diagram)
    try:
        seen = []
        for line in process.stdout:
            seen.append(line)
            if line.startswith("driving"):
                break
        if car.tail.mode != "none":
            assert len(emulator.named("entered")) == entered + 2, "".join(seen)
        assert wait_until(lambda: emulator.named("throttle_on"), 5.0), "the throttle stays neutral"
        yield process
    finally:
        process.kill()
        process.wait()


def after(emulator, since, joints=JOINTS):
    """Seconds from `since` to both motors off (0 without motors) and to the neutral throttle; NaN:
    not yet.
    """
    found = {}
    for event in emulator.events:
        if event["time_s"] >= since:
            found.setdefault(event["event"] + event.get("joint", ""), event["time_s"] - since)
    off = max((found.get(f"off{joint}", math.nan) for joint in joints), default=0.0)
    return off, found.get("throttle_neutral", math.nan)


def run_process_case(case, folder):
    """Drives, lets the cause come, and looks what became of the car."""
    car = load_scenario(case.scenario, list(case.settings))
    joints = JOINTS if car.tail.mode != "none" else ()
    script = {"clock": "driving", "faults": list(case.faults), "operator": list(case.operator)}
    console = case.confirmed is not None
    with (
        EmulatorProcess(folder, car, case.wiring, script, console) as emulator,
        driving(emulator, folder, case, car) as process,
    ):
        since = case.cause(process, emulator)
        wait_until(
            lambda: not any(math.isnan(value) for value in after(emulator, since, joints)),
            2.0 + _HELD,
        )
        off, neutral = after(emulator, since, joints)
        entered = len(emulator.named("entered"))
        status = None
        said = ""
        if case.reason:
            said = process.stdout.read()
            status = process.wait(30.0)
        else:
            time.sleep(0.5)
        confirmed = emulator.operator.confirmed(since + _CONFIRMED) if emulator.operator else None
        assert len(emulator.named("entered")) == entered, "nothing is armed again by itself"
    return Found(off, neutral, status, said, confirmed)


def check(case, found):
    """What the row promises; what was found."""
    assert found.motors_off <= case.within + _HELD * case.held, found
    assert found.throttle_neutral <= (case.throttle_within or case.within), found
    assert found.confirmed is case.confirmed, found
    if case.reason:
        assert case.reason in found.said, found.said
        assert found.status not in (0, None), found
    return found


def process_row(case, found):
    """A line of the fault table."""
    off, neutral = (f"{value * 1000:.0f}" for value in (found.motors_off, found.throttle_neutral))
    return table_line(case.name, case.wiring, off, neutral, "seen", acts_of(case))
