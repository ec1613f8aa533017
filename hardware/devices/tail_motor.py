"""One tail motor: explicit states between the bus and whoever commands the joint.

```
off -- set_enter --> entering -- replies --> holding <-- command --> running
 ^                      |                       |                      |
 |                      +----------- a fault ---+----------------------+--> faulted
 +-- exit frames sent -- exiting <-- set_exit, from every state
```

Entering sends zero gains, reads the position, tries with little torque which way the joint goes,
and holds from there with gains that come on slowly: these motors are known to jump to their last
command. A fault sends exit frames at once and goes on sending them; nothing leads out of it. The
frame that sets the zero is never sent.

One thread calls `receive` for every frame of this motor and `step` once per cycle, with the same
monotonic clock.
"""

import math
from dataclasses import replace

from aerodima.hardware.devices.device_states import ENERGISED, FramePort, MotorFault, MotorState
from aerodima.hardware.devices.direction_probe import DirectionProbe
from aerodima.hardware.devices.motor_limits import (
    MotorLoad,
    check_command,
    clip,
    limit_command,
    scale_gains,
    to_motor,
)
from aerodima.hardware.devices.motor_monitors import MAX_EXTRA, ReplyCount, TrackingMonitor
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.protocol.ak70 import (
    MitCommand,
    MitReply,
    decode_reply,
    make_command,
    make_enter,
    make_exit,
    make_neutral,
    unwrap,
)
from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import HardwareError

_REMIND = 0.1
"""Interval of the exit frames to a faulted motor after the first ones, s."""
_CAUGHT_UP = 1e-3
"""Distance at which the ramp to the first command ends, rad."""


class Motor:
    """A joint driven by one AK70-10.

    Args:
        settings: limits, id and signs of the motor.
        port: port that takes the frames.

    Attributes:
        state: state of the motor.
        fault: first fault of the motor; it stays.
        fault_text: the same fault in words.
        position: angle of the joint by the last reply, rad (unwrapped); NaN before the first.
        speed: speed of the joint by the last reply, rad/s; NaN before the first.
        torque: torque on the joint by the last reply, N m; NaN before the first.
        temperature: temperature of the motor, degrees Celsius; None if it does not report it.
        missed: number of cycles in a row without a reply.
        load: thermal load (I2t) of its winding.
        bad_frames: number of frames under this motor's id that were no valid reply.
    """

    def __init__(self, settings: MotorSettings, port: FramePort) -> None:
        self.settings = settings
        self._safety = settings.safety
        self._exit_frame = make_exit(settings.motor_id)
        self._neutral_frame = make_neutral(settings.motor_id, settings.profile)
        self._port = port
        self.state = MotorState.OFF
        self.fault = MotorFault.NONE
        self.fault_text = ""
        self.position = math.nan
        self.speed = math.nan
        self.torque = math.nan
        self.temperature: float | None = None
        self.missed = 0
        self.bad_frames = 0
        self._reply_time = -math.inf
        self._step_time: float | None = None
        self._state_time = 0.0
        self._exit_time = 0.0
        self._exits_left = 0
        self._unanswered = 0
        self._cycle_frames = 0
        self._cycle_replies = 0
        self._enter_replies = 0
        self.load = MotorLoad(settings.safety.rated_torque, settings.safety.overload)
        self._command: MitCommand | None = None
        self._tracking = TrackingMonitor(settings.safety)
        self._count = ReplyCount(settings.safety.stall_time)
        self._off_time = 0.0
        self._off_replies: int | None = None
        self._motor_angle: float | None = None
        self._hold_position = 0.0
        self._gain_time = 0.0
        self._probe: DirectionProbe | None = None
        self._command_time = 0.0
        self._ramp: float | None = None

    # -- what the caller asks for

    def set_enter(self, now: float) -> None:
        """Begins to switch the motor on. Raises `HardwareError` unless it is off."""
        if self.state is not MotorState.OFF:
            reason = f" ({self.fault_text})" if self.fault else ""
            raise HardwareError(
                f"{self.settings.name}: cannot be entered while {self.state.name.lower()}{reason}"
            )
        self._go(MotorState.ENTERING, now)
        self._motor_angle = None
        self._probe = None
        self._command = None
        self.missed = 0
        self._unanswered = 0
        self._enter_replies = 0
        self._count.clear()
        self._step_time = now
        enter = make_enter(self.settings.motor_id)
        for frame in (self._neutral_frame, enter, self._neutral_frame):
            self._send(frame, urgent=True)

    def set_command(self, command: MitCommand, now: float) -> None:
        """Limits a command of the joint and sends it, if the motor is holding or running.

        A command with NaN, infinity or a negative gain is a fault: what sends such things is
        broken.
        """
        if self.state not in (MotorState.HOLDING, MotorState.RUNNING):
            return
        if self.state is MotorState.HOLDING:
            self._go(MotorState.RUNNING, now)
            self._ramp = self.position
            self._command_time = now
        try:
            check_command(command)
            self._ramp = self._ramped(command, now)
            if self._ramp is not None:
                command = replace(command, position=self._ramp)
            self._send_command(self._limited(command, now))
        except HardwareError as error:
            self.set_fault(MotorFault.BAD_COMMAND, str(error), now)
            return
        self._command_time = now

    def set_hold(self, now: float, position: float | None = None) -> None:
        """Stops following commands and holds the present position, if running; holds `position`
        (rad) if one is given.
        """
        if self.state is MotorState.RUNNING:
            self._hold_position = self.position
            self._go(MotorState.HOLDING, now)
        if position is not None:
            self._hold_position = position

    def set_exit(self, now: float) -> None:
        """Switches the motor off, from every state: exit frames at once, and again in the following
        cycles.
        """
        if self.state is not MotorState.FAULTED:
            self._go(MotorState.EXITING, now)
            self._exits_left = self._safety.exit_cycles
        self._send_exits(now)

    def set_fault(self, fault: MotorFault, text: str, now: float) -> None:
        """Switches the motor off for a reason that stays. The first one counts."""
        if self.state not in ENERGISED:
            return
        self.fault = fault
        self.fault_text = f"{self.settings.name}: {text}"
        self._go(MotorState.FAULTED, now)
        self._send_exits(now)

    @property
    def off_confirmed(self) -> bool:
        """Returns whether the motor has answered since it was switched off; True for one that was
        never on.

        One reply may be an old one; as many are needed as for switching it on.
        """
        if self.state in ENERGISED:
            return False
        return self._off_replies is None or self._off_replies >= self._safety.enter_replies

    def off_overdue(self, now: float) -> bool:
        """Returns whether the motor was switched off a while ago and has not answered: the exit
        frames may not have arrived.
        """
        if self.state in ENERGISED or self.off_confirmed:
            return False
        return now - self._off_time > self._safety.exit_cycles * 0.01

    def age(self, now: float) -> float:
        """Returns the seconds since the last valid reply; infinite before the first."""
        return now - self._reply_time

    # -- frames

    def _limited(self, command: MitCommand, now: float) -> MitCommand:
        fraction = min(1.0, max(0.0, now - self._gain_time) / self._safety.gain_ramp)
        max_torque = self.load.allowed(self.settings.torque_limit)
        return limit_command(
            scale_gains(command, fraction), self.position, self.speed, self.settings, max_torque
        )

    def _send_command(self, limited: MitCommand) -> None:
        settings = self.settings
        frame = make_command(settings.motor_id, to_motor(limited, settings), settings.profile)
        self._command = limited
        self._send(frame)

    def _ramped(self, command: MitCommand, now: float) -> float | None:
        """Returns the next angle of the ramp (rad); None once the command is reached or has no
        position gain.
        """
        if self._ramp is None or command.kp == 0:
            return None
        travel = self._safety.ramp_speed * max(0.0, now - self._command_time)
        target = min(max(command.position, self.settings.low), self.settings.high)
        position = self._ramp + clip(target - self._ramp, travel)
        return None if abs(target - position) < _CAUGHT_UP else position

    # -- what comes from the bus

    def receive(self, frame: CanFrame, time: float) -> None:
        """Takes a frame that names this motor, which arrived at `time` (s, monotonic)."""
        # An exit frame of the Teensy or of another program is answered too.
        if frame == self._exit_frame:
            self._cycle_frames += 1
            return
        try:
            reply = decode_reply(frame, self.settings.profile)
        except FrameError as error:
            self.bad_frames += 1
            if frame.extended:
                self.set_fault(MotorFault.WRONG_FIRMWARE, str(error), time)
            return
        self._motor_angle, jump = self._unwrapped(reply.position, time)
        self.position = self.settings.joint_angle(self._motor_angle)
        self.speed = self.settings.direction * reply.velocity
        self.torque = self.settings.direction * reply.torque
        self.temperature = reply.temperature
        self.load.add(self.torque, time)
        self._reply_time = time
        self._cycle_replies += 1
        self._enter_replies += 1
        if self._off_replies is not None:
            self._off_replies += 1
        energised = self.state in (MotorState.HOLDING, MotorState.RUNNING) or (
            self.state is MotorState.ENTERING and self._probe is not None
        )
        failure = ""
        if energised and self._command is not None:
            failure = self._tracking.update(
                self._command, self.position, self.speed, self.torque, time
            )
        else:
            self._tracking.reset()
        self._check(reply, jump, time)
        if failure:
            self.set_fault(MotorFault.NOT_FOLLOWING, failure, time)

    def _unwrapped(self, reading: float, time: float) -> Pair:
        """Returns the motor angle of a reading, and by how much more it changed than the motor can
        turn, rad.
        """
        before = self._motor_angle
        if before is None:
            return reading, 0.0
        angle = unwrap(before, reading, self.settings.profile)
        possible = self.settings.jump_speed * max(0.0, time - self._reply_time)
        return angle, abs(angle - before) - possible

    def _check(self, reply: MitReply, jump: float, time: float) -> None:
        """Switches the motor off if the reply shows a reason; `_unwrapped` gives `jump`, rad."""
        settings = self.settings
        safety = self._safety
        if reply.fault:
            text = f"reports {settings.profile.fault_name(reply.fault)}"
            self.set_fault(MotorFault.MOTOR_REPORTED, text, time)
        if (reply.temperature or 0.0) > safety.temperature_limit:
            text = f"{reply.temperature} degC; allowed is {safety.temperature_limit:g}"
            self.set_fault(MotorFault.OVER_TEMPERATURE, text, time)
        if jump > safety.jump_margin:
            self.set_fault(MotorFault.POSITION_JUMP, f"position jumped by {jump:.3g} rad", time)
        if abs(self.speed) > safety.speed_limit:
            text = f"{self.speed:.3g} rad/s; allowed is {safety.speed_limit:g}"
            self.set_fault(MotorFault.OVER_SPEED, text, time)
        if self.load.share > safety.overload_share:
            text = f"overloaded: {100 * self.load.share:.0f} % of what its winding bears beyond "
            self.set_fault(MotorFault.OVERLOAD, f"{text}{safety.rated_torque:g} N m", time)
        beyond = max(settings.low - self.position, self.position - settings.high)
        if beyond > safety.range_margin:
            allowed = f"{settings.low:.3g} to {settings.high:.3g}"
            text = f"at {self.position:.3g} rad; allowed is {allowed}"
            self.set_fault(MotorFault.OUT_OF_RANGE, text, time)

    # -- once per cycle

    def step(self, now: float) -> None:
        """Checks what should have happened since the last cycle and sends what the state asks for.

        While running nothing is sent here: `set_command` does, later in the cycle.
        """
        self._check_cycle(now)
        if self.state is MotorState.ENTERING:
            self._enter(now)
        if (
            self.state is MotorState.RUNNING
            and now - self._command_time > self._safety.command_timeout
        ):
            self.set_hold(now)
        if self.state is MotorState.HOLDING:
            held = MitCommand(
                self._hold_position, 0.0, self.settings.hold_kp, self.settings.hold_kd, 0.0
            )
            self._send_command(self._limited(held, now))
        elif self.state is MotorState.EXITING:
            self._exit(now)
        elif self.state is MotorState.FAULTED:
            recent = now - self._state_time < self._safety.exit_cycles * 0.01
            if recent or now - self._exit_time >= _REMIND:
                self._send(self._exit_frame, urgent=True)
                self._exit_time = now

    def _check_cycle(self, now: float) -> None:
        gap = 0.0 if self._step_time is None else now - self._step_time
        self._step_time = now
        if self._cycle_replies:
            self._unanswered = 0
        else:
            self._unanswered += self._cycle_frames
        if not self._unanswered:
            self.missed = 0
        # A late loop catches up faster than a motor can answer.
        elif gap >= self._safety.reply_time:
            self.missed += 1
        self._count.add(self._cycle_frames, self._cycle_replies, now)
        self._cycle_frames = 0
        self._cycle_replies = 0
        safety = self._safety
        if gap < 0 or gap > safety.stall_time:
            self.set_fault(MotorFault.LOOP_STALLED, f"{gap:.3g} s between two cycles", now)
        elif self._count.extra > MAX_EXTRA:
            self.set_fault(
                MotorFault.DOUBLE_ID, f"two motors answer to the id {self.settings.motor_id}", now
            )
        elif (
            self.state is not MotorState.ENTERING or self._probe
        ) and self.missed >= safety.missed_replies:
            bad = f", {self.bad_frames} bad frames" if self.bad_frames else ""
            self.set_fault(MotorFault.NO_REPLY, f"no reply for {self.missed} cycles{bad}", now)

    def _enter(self, now: float) -> None:
        safety = self._safety
        if self._enter_replies >= safety.enter_replies:
            self._try_direction(now)
        elif now - self._state_time > safety.enter_timeout:
            bad = f" ({self.bad_frames} bad frames)" if self.bad_frames else ""
            self.set_fault(
                MotorFault.NO_REPLY, f"does not answer{bad}; is it powered, is its id right?", now
            )
        else:
            self._send(self._neutral_frame)

    def _try_direction(self, now: float) -> None:
        probe = self._probe or DirectionProbe(self.settings, now)
        self._probe = probe
        probe.step(self.position, self.speed, now)
        if probe.fault:
            self.set_fault(MotorFault.WRONG_DIRECTION, probe.fault, now)
        elif probe.passed:
            self._hold_position = self.position
            self._gain_time = now
            self._go(MotorState.HOLDING, now)
        else:
            push = MitCommand(self.position, 0.0, 0.0, 0.0, probe.torque)
            self._send_command(limit_command(push, self.position, self.speed, self.settings))

    def _exit(self, now: float) -> None:
        if self._exits_left == 0:
            self._go(MotorState.OFF, now)
            return
        self._exits_left -= 1
        self._send(self._exit_frame, urgent=True)

    def _send_exits(self, now: float) -> None:
        """Sends a neutral command, then exit frames: a motor may jump to its last command."""
        self._exit_time = now
        self._send(self._neutral_frame, urgent=True)
        for _ in range(self._safety.exit_burst):
            self._send(self._exit_frame, urgent=True)

    def _send(self, frame: CanFrame, urgent: bool = False) -> None:
        self._cycle_frames += 1
        try:
            self._port.send(frame, urgent)
        except Exception as error:  # whatever it is, the next exit frame must get its chance
            self.set_fault(MotorFault.BUS, f"sending failed: {error}", self._state_time)

    def _go(self, state: MotorState, now: float) -> None:
        if self.state in ENERGISED and state not in ENERGISED:
            self._off_time = now
            self._off_replies = 0
        self.state = state
        self._state_time = now
