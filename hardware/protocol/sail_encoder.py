"""Absolute encoder of the sail joint: words to angles (thesis 5.4.5).

The thesis reads 12 bits; the part it names, AEAT-6010, has 10 (ERRATA E30). Both are profiles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.workbench.errors import HardwareError

_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class EncoderProfile:
    """An absolute encoder whose word spans one turn.

    Attributes:
        name: how a user chooses it.
        bits: of the word.
        supply: V.
    """

    name: str
    bits: int
    supply: float

    @property
    def resolution(self) -> float:
        """One step, rad."""
        return _TURN / (1 << self.bits)


AEAT_6012 = EncoderProfile("aeat_6012", 12, 3.3)
AEAT_6010 = EncoderProfile("aeat_6010", 10, 5.0)
ENCODERS: Mapping[str, EncoderProfile] = MappingProxyType({part.name: part for part in (AEAT_6012, AEAT_6010)})


def encoder_profile(name: str) -> EncoderProfile:
    """The encoder of that name. Raises `HardwareError` that lists the known ones."""
    if name not in ENCODERS:
        raise HardwareError(f"sail encoder {name!r} is unknown; allowed: {', '.join(ENCODERS)}")
    return ENCODERS[name]


def decode_word(word: int, encoder: EncoderProfile) -> float:
    """Angle in [0, 2 pi) rad. Raises `FrameError` for a word that does not fit into the encoder's bits."""
    if isinstance(word, bool) or not isinstance(word, int) or not 0 <= word < 1 << encoder.bits:
        raise FrameError(f"sail encoder word {word!r}: {encoder.name} has {encoder.bits} bits")
    return word * encoder.resolution


def encode_angle(angle: float, encoder: EncoderProfile) -> int:
    """Word of an angle (rad, any turn), rounded to the nearest step. Raises `FrameError` for NaN and infinity."""
    if not math.isfinite(angle):
        raise FrameError(f"sail angle {angle!r}: must be finite")
    return math.floor(angle / encoder.resolution + 0.5) % (1 << encoder.bits)


def signed_angle(degrees: float) -> float:
    """The microcontroller's reading, 0 to 360 degrees, as rad in (-pi, pi]. Raises `FrameError` outside of it."""
    if not 0.0 <= degrees <= 360.0:  # also catches NaN
        raise FrameError(f"sail angle {degrees!r} degrees: allowed is 0 to 360")
    angle = math.radians(degrees)
    return angle if angle <= math.pi else angle - _TURN
