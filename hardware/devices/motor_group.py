"""The motors of the tail on one bus: frames go to the motor that they name, and a fault of one
switches off all, or all but the first.
"""

from collections import deque
from collections.abc import Sequence

from aerodima.hardware.devices.device_states import FramePort, MotorFault, MotorState
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.devices.tail_motor import Motor
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.core.errors import HardwareError

_MAX_RECEIVED = 400
"""Number of frames that are kept: two seconds of two motors."""


class MotorGroup:
    """Motors of one bus.

    Args:
        settings: settings of the motors, in the order of `motors`.
        port: open bus; the caller closes it.

    Attributes:
        motors: motors of the bus, one for each of `settings`.
        received: newest frames with their arrival (s), for the check of the firmware profile.
    """

    def __init__(self, settings: Sequence[MotorSettings], port: FramePort) -> None:
        self.port = port
        self.motors = tuple(Motor(item, port) for item in settings)
        self._by_id = {motor.settings.motor_id: motor for motor in self.motors}
        self.received: deque[tuple[float, CanFrame]] = deque(maxlen=_MAX_RECEIVED)

    @property
    def fault_text(self) -> str:
        """Fault of the first motor that has one of its own, empty while there is none."""
        texts = [
            (motor.fault is MotorFault.OTHER_MOTOR, motor.fault_text)
            for motor in self.motors
            if motor.fault
        ]
        return min(texts, default=(False, ""))[1]

    @property
    def ready(self) -> bool:
        """Returns whether every motor takes commands."""
        return all(motor.state in (MotorState.HOLDING, MotorState.RUNNING) for motor in self.motors)

    @property
    def off_confirmed(self) -> bool:
        """Returns whether every motor has answered since it was switched off."""
        return all(motor.off_confirmed for motor in self.motors)

    def set_enter(self, now: float) -> None:
        """Begins to switch all motors on.

        Raises `HardwareError` if one is not off or the bus has a fault.
        """
        if self.port.fault:
            raise HardwareError(f"the bus has a fault: {self.port.fault_text}")
        for motor in self.motors:
            if motor.state is not MotorState.OFF:
                motor.set_enter(now)  # raises, before any other motor is switched on
        for motor in self.motors:
            motor.set_enter(now)

    def set_exit(self, now: float) -> None:
        """Switches all motors off."""
        for motor in self.motors:
            motor.set_exit(now)

    def step(self, now: float, holds_first: bool = False) -> None:
        """Runs one cycle: hands out what came in, checks the bus, lets every motor send what its
        state asks for; with `holds_first` a fault of another motor leaves the first one on.
        """
        for arrival, frame in self.port.poll():
            self.received.append((arrival, frame))
            motor = self._addressed(frame)
            if motor is not None:
                motor.receive(frame, arrival)
        if self.port.fault:
            for motor in self.motors:
                motor.set_fault(MotorFault.BUS, self.port.fault_text, now)
        for motor in self.motors:
            motor.step(now)
        self._switch_off_together(now, holds_first)

    def _addressed(self, frame: CanFrame) -> Motor | None:
        """Returns the motor that a frame names: by its first byte or its CAN id, of which the last
        byte counts if it is extended.
        """
        motor_id = frame.arbitration_id
        if frame.extended:
            motor_id &= 0xFF
        elif motor_id == 0 and frame.data:
            motor_id = frame.data[0]
        return self._by_id.get(motor_id)

    def _switch_off_together(self, now: float, holds_first: bool) -> None:
        others = self.motors[1:] if holds_first else self.motors
        for faulted in self.motors:
            if faulted.state is MotorState.FAULTED:
                text = f"switched off with {faulted.fault_text}"
                for motor in others:
                    motor.set_fault(MotorFault.OTHER_MOTOR, text, now)
