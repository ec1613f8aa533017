"""Frames out of a stream of bytes that begins anywhere and may carry noise."""

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def cut_frames(
    data: bytes, start: bytes, cut: Callable[[bytes], tuple[int, T | None]]
) -> tuple[list[T], bytes]:
    """Cuts the frames out of bytes; returns what they hold, and the bytes of one that is open.

    Args:
        start: first byte of a frame.
        cut: returns the number of bytes that are done with (0: the frame is open), and what the
            frame holds; None for one that holds nothing, or a start that was none.
    """
    contents: list[T] = []
    while (begin := data.find(start)) >= 0:
        data = data[begin:]
        used, content = cut(data)
        if used == 0:
            return contents, data
        data = data[used:]
        if content is not None:
            contents.append(content)
    return contents, b""
