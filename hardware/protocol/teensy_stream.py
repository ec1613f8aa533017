"""Whole strings out of a serial stream that begins anywhere, is cut anywhere and may carry noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.teensy import END, StringForm, TeensyCommand, TeensyReply, decode_command, decode_reply

_LONGEST_PART = 200
"""Bytes between two `|`; more is noise."""

T = TypeVar("T")


class StringStream(Generic[T]):
    """Collects bytes and returns what they mean; anything that is not a valid string is dropped and counted.

    What stands before the first `|` is never used: a string that was joined in its middle can look like a shorter one.

    Args:
        decode: takes a whole string with its last `|`; raises `FrameError`.
        parts: number of `|` in a string.

    Attributes:
        rejected: strings dropped since the start. A command of three parts that is damaged counts once for each part.
        last_error: why the last one was dropped, empty before the first.
    """

    def __init__(self, decode: Callable[[bytes], T], parts: int) -> None:
        self._decode = decode
        self._parts = parts
        self._open = b""
        self._waiting: list[bytes] = []
        self._synchronised = False
        self.rejected = 0
        self.last_error = ""

    def feed(self, data: bytes) -> list[T]:
        """The strings that became complete with these bytes, oldest first."""
        *complete, rest = (self._open + data).split(END)
        found: list[T] = []
        for part in complete:
            if not self._synchronised:
                self._synchronised = True
            elif len(part) > _LONGEST_PART:
                self._reject("no '|' for too long")
            else:
                found += self._take(part + END)
        if len(rest) > _LONGEST_PART:
            rest = rest[: _LONGEST_PART + 1]
        self._open = rest
        return found

    def _take(self, part: bytes) -> list[T]:
        self._waiting.append(part)
        if len(self._waiting) < self._parts:
            return []
        try:
            result = self._decode(b"".join(self._waiting))
        except FrameError as error:
            self.rejected += 1
            self.last_error = str(error)
            del self._waiting[0]  # the string may begin with the next part
            return []
        self._waiting.clear()
        return [result]

    def _reject(self, reason: str) -> None:
        self.rejected += 1
        self.last_error = reason
        self._waiting.clear()


def reply_stream(form: StringForm) -> StringStream[TeensyReply]:
    """Stream of the Teensy's replies, for the computer."""
    return StringStream(lambda text: decode_reply(text, form), parts=1)


def command_stream(form: StringForm) -> StringStream[TeensyCommand]:
    """Stream of the computer's commands, for an emulated Teensy."""
    return StringStream(lambda text: decode_command(text, form), parts=3)
