"""Checked messages of a page, one JSON object each, and the state of car and console as the page
shows it.
"""

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from aerodima.hardware.console.operator_radio import REPORT_SILENCE, OperatorRadio
from aerodima.hardware.devices.device_states import MotorFault, SourceFault
from aerodima.hardware.protocol.radio import CarReport, OperatorCommand, RadioMode
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.scenario.signal_table import STATUS_SOURCES

MODES = {
    "rest": RadioMode.IDLE,
    "manual": RadioMode.MANUAL,
    "control": RadioMode.CONTROL,
    "auto": RadioMode.AUTO,
}
"""Modes of the radio, by their name on the page."""
_Angle = Annotated[float, Field(ge=-math.pi, le=math.pi)]
_MODE_NAMES = {mode: name for name, mode in MODES.items()}
_MOTORS = ("tail_pitch", "tail_roll")
_CAR_NUMBERS = ("yaw_rate", "roll", "speed")
_TAIL_NUMBERS = (*_MOTORS, "torque_pitch", "torque_roll")


class _Message(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PageHeartbeat(_Message):
    """Sign that the page lives, with what it asks for; sent every 50 ms.

    Attributes:
        count: count of the heartbeats, which grows by one with each.
        time: time on the page's clock, s.
        mode: name of the mode, one of `MODES`.
        throttle: commanded throttle, -1 to 1.
        steering: commanded steering angle, rad, positive to the left.
        pitch: commanded pitch angle of the tail, rad.
        roll: commanded roll angle of the tail, rad.
    """

    type: Literal["beat"]
    count: int = Field(ge=0)
    time: float
    mode: Literal["rest", "manual", "control", "auto"] = "rest"
    throttle: float = Field(default=0.0, ge=-1.0, le=1.0)
    steering: _Angle = 0.0
    pitch: _Angle = 0.0
    roll: _Angle = 0.0

    @property
    def command(self) -> OperatorCommand:
        """The command that a frame of the radio carries."""
        return OperatorCommand(
            MODES[self.mode], self.throttle, self.steering, self.pitch, self.roll
        )


class Stop(_Message):
    """Emergency stop; `by` says what was pressed."""

    type: Literal["stop"]
    by: Literal["button", "key", "gamepad"]


class Logging(_Message):
    """Request to switch the recording on or off."""

    type: Literal["log"]
    on: bool


class Request(_Message):
    """Request to forget the emergency stop, to take control, or to arm or disarm a car that the
    console started.
    """

    type: Literal["reset", "take", "arm", "disarm"]


Message = PageHeartbeat | Stop | Logging | Request
_MESSAGE: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def read_message(text: str) -> Message:
    """Reads a message; raises a `UserError` of one line for anything else."""
    try:
        return _MESSAGE.validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "message"
        raise UserError(f"{place}: {first['msg']}") from None


class HeartbeatClock:
    """Filter that separates heartbeats that were held up on their way from new ones.

    After a stall everything that waited comes at once. The clock of a page has an unknown offset:
    the shortest delay seen so far counts as none, and is forgotten slowly.
    """

    LATEST = 0.15
    """Delay beyond which a heartbeat is not passed on, s; the car stops 0.25 s after the last one
    that is."""
    _FORGET = 1e-3
    """Rate at which the offset is forgotten, s per s: far above the drift between two clocks of one
    computer."""

    def __init__(self) -> None:
        self._offset = math.inf
        self._before = -math.inf

    def in_time(self, sent: float, now: float) -> bool:
        """Returns whether a heartbeat sent at the page's time `sent` and received at `now` (s) is
        passed on.
        """
        if math.isfinite(self._offset):
            self._offset += self._FORGET * (now - self._before)
        self._before = now
        self._offset = min(self._offset, now - sent)
        return now - sent - self._offset <= self.LATEST


def radio_state(radio: OperatorRadio, now: float) -> Json:
    """Returns what is known of the car, as plain data without NaN or infinity (None instead).

    Ages are in s, angles in rad, rates in rad/s, torques in N m, speed in m/s. `link_age` is the
    operator's age that the car reports, plus the age of that report.
    """
    age = radio.report_age(now)
    report = radio.report
    fault = radio.fault(now)
    current = report is not None and age <= REPORT_SILENCE and not fault
    return {
        "fault": fault,
        "stopped_by": radio.stopped_by,
        "confirmed": radio.confirmed,
        "mode": _MODE_NAMES[radio.mode],
        "heard": current,
        "armed": radio.armed(now),
        "report_age": _finite(age),
        "link_age": None if report is None else _finite(age + report.operator_age),
        "report": _report_state(report) if report is not None else None,
    }


def _report_state(report: CarReport) -> Json:
    faults = []
    for source, code in zip(STATUS_SOURCES, report.faults, strict=True):
        # 1 says "not fitted", but of a motor it is a fault.
        motor = source in _MOTORS and report.has_tail
        if code == SourceFault.NONE or (code == SourceFault.NOT_FITTED and not motor):
            continue
        faults.append({"source": source.replace("_", " "), "fault": _fault_name(source, code)})
    state = {
        "stopped": report.stopped,
        "mode": _MODE_NAMES[report.mode],
        "has_tail": report.has_tail,
        "faults": faults,
        "text": report.text,
    }
    for name in (*_CAR_NUMBERS, *_TAIL_NUMBERS):
        known = report.has_tail or name in _CAR_NUMBERS
        state[name] = _finite(getattr(report, name)) if known else None
    return state


def _fault_name(source: str, code: int) -> str:
    codes: type[MotorFault | SourceFault] = MotorFault if source in _MOTORS else SourceFault
    try:
        return codes(code).name.lower().replace("_", " ")
    except ValueError:
        return f"fault {code}"


def _finite(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None
