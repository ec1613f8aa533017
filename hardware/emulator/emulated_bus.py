"""The CAN bus of the car: frames to the motors, their answers back, every one of them in the traffic log."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import can

from aerodima.hardware.emulator.emulated_motor import EmulatedMotor
from aerodima.hardware.emulator.fault_board import FaultBoard
from aerodima.hardware.emulator.fault_script import Fault
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.hardware.transport.traffic_log import TrafficLog


class EmulatedBus:
    """Whoever owns the bus gives it frames and gets the answers; a second node may hear all and send too.

    Bus-off is a state of the owner's controller: nothing goes out and nothing comes in until its channel is opened anew
    or the fault ends.

    Attributes:
        frames: carried so far, answers included.
        watch: hears every frame of the owner and of the motors, when a second node is on the bus.
        to_owner: hears what the second node sends, and what the motors answer to it.
    """

    def __init__(self, motors: Sequence[EmulatedMotor], board: FaultBoard, log: TrafficLog) -> None:
        self._motors = {motor.motor_id: motor for motor in motors}
        self._board, self._log = board, log
        self._healed = False
        self.frames = 0
        self.watch: Callable[[CanFrame], None] | None = None
        self.to_owner: Callable[[CanFrame], None] | None = None

    @property
    def off(self) -> bool:
        """Whether the owner's controller is off the bus."""
        return self._board.entry(Fault.BUS_OFF) is not None and not self._healed

    def reopened(self) -> None:
        """The owner has opened its channel anew."""
        self._healed = self._board.entry(Fault.BUS_OFF) is not None

    def carry(self, frame: CanFrame) -> list[CanFrame]:
        """Takes a frame of the owner; the motors' answers."""
        if self.off:
            return []
        answers = self._pass_on(frame)
        if self.watch is not None:
            for heard in (frame, *answers):
                self.watch(heard)
        return answers

    def carry_from_watch(self, frame: CanFrame) -> None:
        """Takes a frame of the second node."""
        for heard in (frame, *self._pass_on(frame)):
            if self.to_owner is not None and not self.off:
                self.to_owner(heard)

    def _pass_on(self, frame: CanFrame) -> list[CanFrame]:
        self._note(frame, received=False)
        motor = None if frame.extended else self._motors.get(frame.arbitration_id)
        answers = motor.receive(frame.data) if motor is not None and len(frame.data) == 8 else []
        for answer in answers:
            self._note(answer, received=True)
        return answers

    def _note(self, frame: CanFrame, received: bool) -> None:
        self.frames += 1
        self._log.add(
            can.Message(
                timestamp=time.time(),
                arbitration_id=frame.arbitration_id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_rx=received,
            )
        )
