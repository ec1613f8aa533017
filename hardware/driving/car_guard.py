"""The guard between pilot and cables: it decides what reaches the car, and when the car stops.

```
 READY -- arm, by hand --> ARMED -- drive --> DRIVING    (a reason to stop before that: STOPPED)
                             |                   |
                             +-- held first -----+--> HOLDING (throttle 0, tail held)
                             |                             | at rest, or after `max_tail_hold`
                             +-- at once --------------> EXITING (exit frames)
                                                           | after `after_exit`
                                                        STOPPED
```
Every reason means throttle 0 and steering 0 in the same cycle, and stays. `stop_posture` says which
causes switch the motors off at once, and which keep them on first: for `tail_hold` at least, and
while the car moves for `max_tail_hold` at most. A roll motor that has a fault is off meanwhile.

A switch that is at AUTO, MANUAL or CONTROL during arming moves nothing: the operator must report
IDLE once the motors hold, and the car obeys only what is chosen after that.
"""

import math
from array import array
from collections import deque
from dataclasses import replace
from enum import IntEnum

from aerodima.hardware.car.safety_settings import DriveSafety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import PERIOD, UNSOUND, CarCommand, CarReading
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_monitors import Debounce
from aerodima.hardware.driving.drive_limits import DriveLimits
from aerodima.hardware.driving.loop_delay import least_delay, with_delay
from aerodima.hardware.driving.stop_posture import (
    GONE,
    Posture,
    StopCause,
    fault_causes,
    posture_after,
)
from aerodima.hardware.protocol.radio import OperatorPrompt, RadioMode
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.signal_table import TAIL_STATE

_RATES = [TAIL_STATE.index("pitch_rate"), TAIL_STATE.index("roll_rate")]
_AFTERMATH = 30
"""Number of cycles after a delay of the loop in which devices seem silent because of it."""


class Stage(IntEnum):
    """Stage of the car between ready and stopped."""

    READY = 0
    ARMED = 1
    DRIVING = 2
    HOLDING = 3
    EXITING = 4
    STOPPED = 5


_LIVE = (Stage.ARMED, Stage.DRIVING, Stage.HOLDING)


class CarGuard:
    """Guard of one car in one loop.

    Args:
        wiring: the wired car, started before the first cycle.
        safety: limits at which the car stops.
        has_tail: whether the car has tail motors; it then drives only while they are armed.

    Attributes:
        stage: stage of the car; see the diagram at the top of this module.
        reason: reason why the car stopped; empty before.
        hard: whether that reason switched the motors off at once.
        stop_time: instant at which that reason came, s; NaN before.
        posture: posture of the tail since then, for how long, and how that ended, in words; empty
            before.
        least_delay: least delay of the computer that explains the reason, s; infinite where none
            does.
        left: whether the operator left the mode and went on reporting while the car was being
            stopped. One who falls silent then has not chosen to end the drive: the console sends
            the car to rest when its page has gone.
        reading: reading of the last cycle.
        sent: command of the last cycle as it went to the car; None before the car is armed.
        was_idle: whether the operator has reported IDLE since the car took commands.
        lateness: lateness of the last cycle, s; 0 for a cycle without a due time.
        overruns: number of cycles that came later than `safety.overrun`.
        cycle_times: times of the cycles in which the car drove, s on `time.monotonic`.
        slow_ticks: times of the ticks in which the controller was slow, s on `time.monotonic`.
    """

    def __init__(self, wiring: WiredCar, safety: DriveSafety, has_tail: bool = True) -> None:
        self.wiring = wiring
        self._safety = safety
        self._limits = DriveLimits(safety)
        self._has_tail = has_tail
        self.stage = Stage.READY
        self.reason = ""
        self.hard = False
        self.stop_time = math.nan
        self.posture = ""
        self._moves = False
        self.least_delay = math.inf
        self.left = False
        self.reading = CarReading()
        self.sent: CarCommand | None = None
        self.lateness = 0.0
        self.overruns = 0
        self._overruns_in_a_row = 0
        self._read_time = math.inf
        self._delays: deque[float] = deque(maxlen=_AFTERMATH)
        self.cycle_times = array("d")
        self.slow_ticks = array("d")
        self._steering = 0.0
        self._since = 0.0
        self._was_armed = False
        self.was_idle = False
        self._readiness = Debounce()
        self._mode = RadioMode.AUTO

    @property
    def finished(self) -> bool:
        """Returns whether the motors are off and stay off."""
        return self.stage is Stage.STOPPED

    @property
    def ready(self) -> bool:
        """Returns whether the car takes commands."""
        return self.stage is Stage.ARMED and (
            not self._has_tail or self.reading.named_status.armed == 1.0
        )

    @property
    def prompt(self) -> OperatorPrompt:
        """Returns what the operator must do before the car drives."""
        if not self.ready or self.reason:
            return OperatorPrompt.NONE
        return OperatorPrompt.SELECT_MODE if self.was_idle else OperatorPrompt.RETURN_TO_IDLE

    # -- by hand

    def arm(self, now: float) -> None:
        """Switches the motors on.

        Raises:
            HardwareError: the car is not ready, there is a reason to stop, a device is silent, or
                there is no watchdog test.
        """
        if self.stage is not Stage.READY:
            because = f" ({self.reason})" if self.reason else ""
            raise HardwareError(
                f"the car cannot be armed: it is {self.stage.name.lower()}{because}"
            )
        reasons = self._reasons(self.reading)
        if reasons:
            raise HardwareError(f"the car cannot be armed: {next(iter(reasons.values()))}")
        self.wiring.arm()
        self._go_unless_stopped(Stage.ARMED, now)

    def drive(self, mode: RadioMode, now: float) -> None:
        """Lets commands through from now on, for as long as the operator stays in `mode`.

        Raises:
            HardwareError: the car does not take commands, or the operator has not reported IDLE
                since it began to take them.
        """
        if not self.ready:
            raise HardwareError(
                f"the car cannot drive: it is not armed{f' ({self.reason})' if self.reason else ''}"
            )
        if not self.was_idle:
            raise HardwareError(
                "the car cannot drive: the operator was not heard in IDLE since it was armed"
            )
        self._mode = mode
        self._go_unless_stopped(Stage.DRIVING, now)

    def stop(self, reason: str, now: float, *causes: StopCause) -> None:
        """Begins to stop, in that posture of the causes that gives up most; the tail is held where
        there is no cause.

        The first reason counts; later causes may give up more, and are added where they switch off
        the motors of a car that moves.

        A car that is not armed yet is stopped at once, and cannot be armed any more.
        """
        postures = [posture_after(cause, self._moves) for cause in causes]
        posture = max(postures, default=Posture.HELD)
        if not self.reason:
            self.reason = reason
            self.hard = posture is Posture.OFF
            self.stop_time = now
        elif posture is Posture.OFF and self.stage is Stage.HOLDING and self._moves:
            self.hard = True
            self.reason += f"; then {reason}"
        if self.stage is Stage.READY:
            self._go(Stage.STOPPED, now)
        elif self.stage in _LIVE and posture is Posture.OFF:
            self._exit(now)
        elif self.stage in _LIVE:
            if self.stage is not Stage.HOLDING:
                self.wiring.hold(now, self._moves)
                self.posture = "pitch held, roll to the middle" if self._moves else "tail held"
                self._go(Stage.HOLDING, now)
            if self.reading.named_status.tail_roll_fault:
                self.posture = "pitch held, roll limp"

    # -- once per cycle

    def read(self, now: float, due: float | None = None) -> CarReading:
        """Runs the first half of a cycle: reads the car, and stops it where that is needed.

        Args:
            now: time of the cycle, s on `time.monotonic`.
            due: time at which the cycle was due, on the same clock; None outside a run.
        """
        self._check_clock(now, due)
        self.reading = self.wiring.read(now)
        self._judge(now)
        self._check_idle(now)
        self.wiring.prompt = self.prompt
        if self._has_tail:
            self.wiring.posture = self.posture
        longest = self._safety.max_tail_hold if self._moves else self._safety.tail_hold
        if self.stage is Stage.HOLDING and now - self._since >= longest:
            self._exit(now)
        elif self.stage is Stage.EXITING and now - self._since >= self._safety.after_exit:
            self._go(Stage.STOPPED, now)
        return self.reading

    def write(self, command: CarCommand, now: float) -> None:
        """Runs the second half: sends the command if the car drives, otherwise one of all zeros."""
        if self.stage is Stage.DRIVING and not command.sound:
            self.stop(f"the controller commands {UNSOUND}", now, "controller")
        if self.stage is Stage.DRIVING:
            command = replace(command, throttle=self._limits.throttle(command.throttle, now))
        else:
            command = CarCommand()
        self._steering = command.steering_angle
        if self.stage is not Stage.READY:
            self.sent = command
        self.wiring.write(command, now)

    def note_computing(self, spent: float, now: float) -> None:
        """Notes the computing time `spent` of a controller's tick, s; too many slow ticks within a
        second stop the car.
        """
        if spent <= self._safety.slow_tick:
            return
        self.slow_ticks.append(now)
        limit = self._safety.most_slow_ticks
        slow = sum(time > now - 1.0 for time in self.slow_ticks[-limit:])
        if slow == limit and self.stage in _LIVE:
            count = f"{slow} ticks within a second beyond {self._safety.slow_tick * 1000:g} ms"
            self.stop(
                f"the controller is too slow: {count}, the last {spent * 1000:.0f} ms",
                now,
                "controller",
            )

    def _check_clock(self, now: float, due: float | None) -> None:
        self.lateness = 0.0 if due is None else now - due
        self._delays.append(max(self.lateness, now - self._read_time - PERIOD))
        self._read_time = now
        if self.stage is Stage.DRIVING:
            self.cycle_times.append(now)
        late = self.lateness > self._safety.overrun
        self.overruns += late
        if late:
            self._overruns_in_a_row += 1
        else:
            self._overruns_in_a_row = 0
        if self._overruns_in_a_row >= self._safety.most_overruns and self.stage in _LIVE:
            text = with_delay(f"{self._overruns_in_a_row} late cycles in a row", self.lateness)
            self.stop(text, now, "late loop")

    def _check_idle(self, now: float) -> None:
        """Notes an IDLE that was given after the car was ready; the newest command may be older."""
        ready_for = self._readiness.update(self.ready, now)
        age = self.reading.named_status.operator_age
        idle = self.reading.operator.mode is RadioMode.IDLE
        if self.ready and idle and age < ready_for:
            self.was_idle = True

    def _judge(self, now: float) -> None:
        reading = self.reading
        status = reading.named_status
        self._moves = self._has_tail and self._limits.moves(reading, now)
        self.wiring.holds_pitch = self._moves and self.stage in _LIVE
        reasons = self._reasons(reading)
        least = least_delay(reading, self._has_tail)
        fallen = self._limits.tilt(reading, now)
        fallen = fallen or self._limits.straight(reading, self._steering, now)
        speed = self._limits.speed(reading, now)
        armed = status.armed == 1.0
        if fallen:
            reasons["fallen"] = fallen
        if speed:
            reasons["speed"] = speed
        if self._has_tail and self._was_armed and not (armed or status.tail_roll_fault):
            reasons["motors off"] = "the tail motors are off"
        self._was_armed = armed
        if self.stage is Stage.DRIVING and not reasons and reading.operator.mode is not self._mode:
            mode = reading.operator.mode.name
            reasons["mode"] = f"the operator left {self._mode.name} for {mode}"
            self.left = True
        elif self.left and status.operator_fault in GONE:
            self.left = False
            self.reason += " and was not heard any more"
        # The stop latches before the car is armed too.
        stopped = status.operator_fault == SourceFault.STOPPED
        if reasons and (self.stage in _LIVE or (stopped and self.stage is Stage.READY)):
            if not self.reason:
                self.least_delay = least
            reason = with_delay(next(iter(reasons.values())), max(self._delays), least)
            self.stop(reason, now, *reasons)

    def _reasons(self, reading: CarReading) -> dict[StopCause, str]:
        """Returns why the car must stop because of its devices, with the worst fault in words."""
        causes = fault_causes(reading.status[1::2], self._has_tail)
        reasons = dict.fromkeys(causes, reading.fault_text or "a device has a fault")
        # Replies of the MIT mode carry neither voltage nor current of the pack: the least current
        # is that of the mechanical power at the lowest voltage allowed.
        current = reading.tail_torque @ reading.tail_state[_RATES] / self._safety.least_voltage
        fuse = self._safety.fuse
        if current > fuse:
            reasons["current"] = f"the tail motors draw {current:.0f} A; the fuse has {fuse:g} A"
        return reasons

    def _go_unless_stopped(self, stage: Stage, now: float) -> None:
        """Enters a stage by hand; exits at once if a signal has come in between."""
        self._go(stage, now)
        if self.reason:
            self._exit(now)

    def _exit(self, now: float) -> None:
        state = "while the car moves" if self._moves else "at rest"
        if self.stage is Stage.HOLDING:
            self.posture += f" for {now - self._since:.2f} s, motors off {state}"
        else:
            self.posture = "motors off at once"
        self.wiring.disarm(now)
        self._go(Stage.EXITING, now)

    def _go(self, stage: Stage, now: float) -> None:
        self.stage = stage
        self._since = now
