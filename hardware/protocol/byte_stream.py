"""Extraction of frames from a stream of bytes that begins anywhere and may carry noise."""

from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def cut_frames(
    data: bytes, start: bytes, cut: Callable[[bytes], tuple[int, T | None]]
) -> tuple[list[T], bytes]:
    """Cuts the frames out of bytes; returns their contents and the bytes of an incomplete frame.

    Args:
        data: bytes to cut.
        start: first byte of a frame.
        cut: function that returns the number of bytes that are done with (0: the frame is
            incomplete) and the content of the frame; None for a frame without content, or where no
            frame starts.
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
