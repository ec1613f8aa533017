"""A classic CAN data frame as plain data: protocol and motor depend on no CAN library."""

from dataclasses import dataclass

from aerodima.workbench.core.errors import HardwareError

STANDARD_IDS = 1 << 11
"""Number of identifiers of 11 bits (ISO 11898-1)."""
EXTENDED_IDS = 1 << 29
"""Number of identifiers of 29 bits (ISO 11898-1)."""
MAX_BYTES = 8
"""Largest number of data bytes in a classic frame."""


class FrameError(HardwareError, ValueError):
    """Error for bytes that are no valid frame of the protocol, or values that none can carry."""


def check_field(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Raises `FrameError` for a value that its field cannot carry, NaN included; `low` and `high`
    are allowed.
    """
    if not low <= value <= high:
        raise FrameError(f"{name} {value!r}: allowed is {low:g} to {high:g} {unit}".rstrip())


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One data frame.

    Attributes:
        arbitration_id: identifier of 11 bits, or of 29 with `extended`.
        data: data bytes, at most 8.
        extended: whether the identifier has 29 bits.
    """

    arbitration_id: int
    data: bytes
    extended: bool = False

    def __post_init__(self) -> None:
        ids = EXTENDED_IDS if self.extended else STANDARD_IDS
        if not 0 <= self.arbitration_id < ids:
            raise FrameError(f"CAN id {self.arbitration_id:#x}: allowed is 0 to {ids - 1:#x}")
        check_field("CAN frame length", len(self.data), 0, MAX_BYTES, "bytes")

    def __str__(self) -> str:
        digits = 8 if self.extended else 3
        return f"{self.arbitration_id:0{digits}X}#{self.data.hex().upper()}"


TimedFrames = list[tuple[float, CanFrame]]
"""Frames, each with its time of arrival, s on `time.monotonic`."""
