"""The heartbeat on the CAN bus of the wiring `watched_can`, and the Teensy's answer to it.

Standard ids 7A0 (computer) and 7A1 (Teensy), 4 bytes: AD, state or status, counter, check (the inverse of the
exclusive-or of the two before it). A motor cannot take one for a command: its ids end at 3F, and its commands have 8
bytes; both ids are of low priority, so that no frame of a motor waits for one.
"""

from __future__ import annotations

from enum import IntEnum

from aerodima.hardware.protocol.can_frame import CanFrame, FrameError
from aerodima.hardware.protocol.teensy import TeensyStatus

BEAT_ID, ANSWER_ID = 0x7A0, 0x7A1
_MAGIC = 0xAD


class BeatState(IntEnum):
    """What the computer says. TRIP: switch the motors off, I cannot."""

    OFF = 0
    ARMED = 1
    TRIP = 2


def make_beat(state: BeatState, counter: int) -> CanFrame:
    """The heartbeat; the counter is taken modulo 256 and must differ from frame to frame."""
    return _make(BEAT_ID, int(state), counter)


def make_answer(status: TeensyStatus, counter: int) -> CanFrame:
    """The Teensy's answer; for emulators and tests."""
    return _make(ANSWER_ID, int(status), counter)


def decode_answer(frame: CanFrame) -> tuple[TeensyStatus, int]:
    """Status of the Teensy and the counter of the beat that it answers. Raises `FrameError` for any other frame."""
    status, counter = _open(frame, ANSWER_ID)
    if status not in tuple(TeensyStatus):
        raise FrameError(f"{frame}: status {status}; allowed is 0 to {max(TeensyStatus)}")
    return TeensyStatus(status), counter


def decode_beat(frame: CanFrame) -> tuple[BeatState, int]:
    """State and counter of a heartbeat; for tests. Raises `FrameError` for any other frame."""
    state, counter = _open(frame, BEAT_ID)
    if state not in tuple(BeatState):
        raise FrameError(f"{frame}: state {state}; allowed is 0 to {max(BeatState)}")
    return BeatState(state), counter


def _make(identifier: int, second: int, counter: int) -> CanFrame:
    counter %= 256
    return CanFrame(identifier, bytes([_MAGIC, second, counter, ~(second ^ counter) & 0xFF]))


def _open(frame: CanFrame, identifier: int) -> tuple[int, int]:
    data = frame.data
    if frame.extended or frame.arbitration_id != identifier or len(data) != 4 or data[0] != _MAGIC:
        raise FrameError(f"{frame}: is no heartbeat of id {identifier:#x}")
    if data[3] != ~(data[1] ^ data[2]) & 0xFF:
        raise FrameError(f"{frame}: the check of the heartbeat is wrong")
    return data[1], data[2]
