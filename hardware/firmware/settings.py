"""Numbers of the Teensy's firmware, from the parameters: for the core on this computer and for the sketch alike."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.protocol.ak70 import check_motor_id
from hardware.protocol.ak70_profiles import FirmwareProfile
from hardware.protocol.sail_encoder import AEAT_6012, EncoderProfile
from hardware.protocol.teensy import StringForm
from hardware.wiring.base import WIRINGS
from workbench.errors import HardwareError
from workbench.parameter_files import load_section
from workbench.quantity import QuantityModel, quantity
from workbench.resources import model_path


class TeensyTiming(QuantityModel):
    """When the watchdog of the Teensy acts, and what it sends then."""

    watchdog_timeout: float = quantity("s", "without a valid string, after which it acts", ge=0.1, le=0.25)
    exit_burst: int = quantity("1", "exit frames per motor at once", ge=1, le=10)
    exit_cycles: int = quantity("1", "further exit frames per motor", ge=1, le=1000)
    exit_cycle: float = quantity("s", "interval of these", gt=0, le=0.1)
    reminder: float = quantity("s", "interval of the exit frames after that", gt=0, le=1)
    reply_wait: float = quantity("s", "how long a reply string waits for the motors", gt=0, le=0.01)


def load_teensy_timing() -> TeensyTiming:
    """The values of `models/parameters/hardware/teensy_firmware.yaml`; `ScenarioError` names what is wrong in it."""
    return load_section(model_path("parameters/hardware/teensy_firmware.yaml"), TeensyTiming)


@dataclass(frozen=True)
class FirmwareSettings:
    """What one Teensy is built for.

    Attributes:
        wiring: in `direct_can` the Teensy does not touch the CAN bus.
        profile: of the motors. encoder: of the sail. form: of the strings. timing: of its watchdog and its replies.
        motor_ids: pitch and roll; switched off when the Teensy starts.

    Raises:
        HardwareError: unknown wiring; an id that is not allowed, or one id for both motors.
    """

    wiring: str
    profile: FirmwareProfile
    timing: TeensyTiming
    motor_ids: tuple[int, int] = (1, 2)
    encoder: EncoderProfile = AEAT_6012
    form: StringForm = StringForm.CHECKED

    def __post_init__(self) -> None:
        if self.wiring not in WIRINGS:
            raise HardwareError(f"wiring {self.wiring!r} is unknown; allowed: {', '.join(WIRINGS)}")
        for motor_id in self.motor_ids:
            check_motor_id(motor_id)
        if self.motor_ids[0] == self.motor_ids[1]:
            raise HardwareError(f"both motors have the id {self.motor_ids[0]}: each needs its own")

    @property
    def owns_can(self) -> bool:
        """Whether the motors hang on the Teensy."""
        return self.wiring == "teensy_bridge"


def milliseconds(seconds: float) -> int:
    """The firmware's clock counts milliseconds."""
    return round(seconds * 1000.0)
