"""Which page controls the car: one, the others look on until it has gone."""

from __future__ import annotations

from typing import Final

GONE_AFTER: Final = 2.0
"""s without a word after which a page counts as gone, though its connection stands: hidden, frozen, asleep."""


class Seats:
    """One seat to control and any number to look on. Pages are known by a number; times in s, monotonic."""

    def __init__(self) -> None:
        self._next = 0
        self.controller: int | None = None
        self._heard = 0.0

    def enter(self, now: float) -> int:
        """A new page; the first one controls."""
        self._next += 1
        if self._next == 1:
            self.take(1, now)
        return self._next

    def leave(self, page: int) -> None:
        """The connection of a page has ended."""
        if self.controller == page:
            self.controller = None

    def hear(self, page: int, now: float) -> None:
        """The page lives."""
        if self.controller == page:
            self._heard = now

    def free(self, now: float) -> bool:
        """Whether the controlling page has gone."""
        return self.controller is None or now - self._heard > GONE_AFTER

    def take(self, page: int, now: float) -> bool:
        """The page asks for control; whether it has it now."""
        if self.controller != page and not self.free(now):
            return False
        self.controller, self._heard = page, now
        return True
