"""States and faults of the car's devices, as codes on the port `status`, and what a motor needs to
send its frames.
"""

from enum import IntEnum
from typing import Protocol

from aerodima.hardware.protocol.can_frame import CanFrame, TimedFrames


class SourceFault(IntEnum):
    """Fault codes of sail, imu, speed and operator in `status`; tail motors have `MotorFault`."""

    NONE = 0
    NOT_FITTED = 1
    """The car does not have the part; the simulated station reports it likewise."""
    NO_SAMPLE_YET = 2
    SILENT = 3
    LOST = 4
    """The port of the device has gone."""
    REPORTED = 5
    """The device itself reports a fault: error of the IMU, watchdog of the Teensy."""
    NO_FIX = 6
    """The GPS receiver lives but knows no speed."""
    STOPPED = 7
    """The operator asked for an emergency stop."""


class MotorState(IntEnum):
    """State of a motor as the computer commands it; its replies tell what it does."""

    OFF = 0
    ENTERING = 1
    HOLDING = 2
    RUNNING = 3
    FAULTED = 4
    EXITING = 5


class MotorFault(IntEnum):
    """Reason why a motor was switched off; the code of the station's `status` port."""

    NONE = 0
    NO_REPLY = 1
    MOTOR_REPORTED = 2
    OVER_TEMPERATURE = 3
    OVER_SPEED = 4
    OUT_OF_RANGE = 5
    POSITION_JUMP = 6
    BAD_COMMAND = 7
    WRONG_FIRMWARE = 8
    DOUBLE_ID = 9
    BUS = 10
    LOOP_STALLED = 11
    OTHER_MOTOR = 12
    OVERLOAD = 13
    NOT_FOLLOWING = 14
    WRONG_DIRECTION = 15


ENERGISED = (MotorState.ENTERING, MotorState.HOLDING, MotorState.RUNNING)
"""States in which the motor may make torque."""


class FramePort(Protocol):
    """Port of a bus as motors need it: `CanBus` and the Teensy's bridge are such ports.

    None of these calls blocks or raises.
    """

    @property
    def fault(self) -> int:
        """Fault code; 0 while the bus can be trusted."""

    @property
    def fault_text(self) -> str:
        """The fault in words."""

    def send(self, frame: CanFrame, urgent: bool = False) -> bool:
        """Takes a frame and returns at once; see `CanBus.send`."""

    def poll(self) -> TimedFrames:
        """Returns the frames since the last call with their time of arrival, s, monotonic."""

    def flush(self) -> bool:
        """Waits for a short while until all frames have left; returns whether they have."""
