"""Steps from a car that is ready to one that drives: permission, standstill, motors, operator.

Every step runs the loop of the guard, so that no device falls silent.
"""

import threading
import time
from collections.abc import Callable

from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.driving.car_guard import CarGuard, Stage
from aerodima.hardware.driving.drive_checks import report, standstill_checks
from aerodima.hardware.driving.plain_loop import idle_until
from aerodima.hardware.driving.speaker import Say
from aerodima.hardware.protocol.radio import OperatorPrompt, RadioMode
from aerodima.workbench.control.user_law import in_words
from aerodima.workbench.core import terminal
from aerodima.workbench.core.errors import HardwareError

_PERMISSION_TIME = 3600.0
"""Longest wait for a permission, s."""
_SETTLE_TIME = 0.5
"""Time for which the motors hold before their replies are judged, s."""
_IDLE_NOTICE = 0.5
"""Time in which a switch at IDLE is received, s; after it the drive prints what it waits for."""
_STOP_TIME = 5.0
"""Longest wait until the motors are off, s."""


def typed(question: str) -> str:
    """Returns what is typed in answer to a question; empty where nobody is there to answer."""
    terminal.say(f"{question}:")  # `input` would wait for a terminal that takes no output
    try:
        return input().strip()
    except EOFError:
        return ""


def may_arm() -> bool:
    """Returns whether somebody at the terminal allows the motors to be switched on."""
    return typed("keep clear of the tail; type arm to switch the motors on") == "arm"


def await_permission(guard: CarGuard, confirm: Callable[[], bool] | None) -> None:
    """Waits for the answer of `confirm`, which runs on a thread of its own; None asks nobody.

    Raises:
        HardwareError: the car may not be armed, or has a reason to stop.
    """
    if confirm is None:
        return
    answers: list[bool] = []
    refusal = "nobody said that the car may be armed"

    def ask() -> None:
        nonlocal refusal
        try:
            answers.append(confirm())
        except Exception as error:
            refusal = f"asking failed: {in_words(error)}"
            answers.append(False)

    threading.Thread(target=ask, name="confirm", daemon=True).start()
    idle_until(guard, lambda: bool(answers or guard.reason), _PERMISSION_TIME)
    if guard.reason or not answers or not answers[0]:
        raise HardwareError(f"not armed: {guard.reason or refusal}")


def check_standstill(guard: CarGuard, safety: DriveSafety, say: Say) -> None:
    """Raises `HardwareError` for a car that is moved, lies on its side, or whose IMU has frozen."""
    samples: dict[float, Bno055Sample] = {}

    def collect() -> bool:
        devices = guard.wiring.devices
        if devices is not None and devices.imu.newest is not None:
            taken, sample = devices.imu.newest
            samples[taken] = sample
        return False

    idle_until(guard, collect, safety.still_time)
    report(standstill_checks(list(samples.values()), guard.reading.imu, safety), say)


def arm_motors(guard: CarGuard, timeout: float, check: Callable[[], None] | None) -> None:
    """Arms the motors, and calls `check`, if there is one, once they hold.

    Raises:
        HardwareError: the motors do not take commands within `timeout` s, or `check` raises it;
            they are off by then.
    """
    guard.arm(time.monotonic())
    if not idle_until(guard, lambda: guard.ready, timeout):
        failure = guard.reason or f"the motors do not take commands within {timeout:g} s"
        guard.stop(failure, time.monotonic(), "arming")
        await_stop(guard)
        raise HardwareError(f"arming failed: {failure}")
    if check is None:
        return
    idle_until(guard, lambda: False, _SETTLE_TIME)
    try:
        check()
    except HardwareError as error:
        guard.stop(str(error), time.monotonic(), "arming")
        await_stop(guard)
        raise


def await_operator(guard: CarGuard, timeout: float, say: Say) -> RadioMode:
    """Waits until the operator has been in IDLE and has chosen a mode, and lets the car drive.

    Returns:
        Mode that was chosen; IDLE if the car has stopped, after `timeout` s or for another reason.
    """
    end = time.monotonic() + timeout

    def has_been_idle() -> bool:
        return guard.prompt is not OperatorPrompt.RETURN_TO_IDLE

    def has_chosen() -> bool:
        mode = guard.reading.operator.mode
        return guard.prompt is OperatorPrompt.SELECT_MODE and mode is not RadioMode.IDLE

    if not idle_until(guard, has_been_idle, min(_IDLE_NOTICE, timeout)):
        position = guard.reading.operator.mode.name
        say(
            f"the operator's switch stands on {position}: put it in IDLE first; nothing is obeyed "
            "before"
        )
        idle_until(guard, has_been_idle, end - time.monotonic())
    if guard.prompt is OperatorPrompt.SELECT_MODE:
        say("waiting for the operator: AUTO runs the sequence, MANUAL and CONTROL drive by radio")
    if idle_until(guard, has_chosen, end - time.monotonic()):
        mode = guard.reading.operator.mode
        guard.drive(mode, time.monotonic())
        say(f"driving: {mode.name}")
        return mode
    if not guard.reason:
        if guard.was_idle:
            failure = "chose neither AUTO nor MANUAL nor CONTROL"
        else:
            failure = "did not put the switch in IDLE"
        guard.stop(f"the operator {failure}", time.monotonic())
    await_stop(guard)
    return RadioMode.IDLE


def await_stop(guard: CarGuard) -> None:
    """Runs the loop until the motors are off; returns at once if the car was never armed."""
    if guard.stage is not Stage.READY:
        idle_until(guard, lambda: guard.finished, _STOP_TIME)
