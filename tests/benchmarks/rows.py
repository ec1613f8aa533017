"""One measured number with its goal, as `make bench` prints it and writes it to CSV."""

import operator
from collections.abc import Callable
from dataclasses import dataclass

CSV_HEADER = ("name", "value", "unit", "goal", "peer_value", "ratio")
_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "==": operator.eq,
}


class NotPermittedError(Exception):
    """The computer does not let a benchmark run: what is missing, as the right to real-time
    priority.
    """


@dataclass(frozen=True)
class BenchRow:
    """A benchmark's result.

    Attributes:
        name: what was measured, unique over all benchmarks.
        value: the number, in `unit` (s, us, 1/s, MB/s, 1 ...).
        unit: unit of `value` and `peer_value`.
        goal: a comparison such as `<= 0.5`, empty where there is none. It bounds `ratio` where
            there is a peer, `value` otherwise.
        peer_value: the same quantity measured on what we compare with, in the same session.
    """

    name: str
    value: float
    unit: str
    goal: str = ""
    peer_value: float | None = None

    @property
    def ratio(self) -> float | None:
        """`value / peer_value`; None without a peer."""
        return None if self.peer_value is None else self.value / self.peer_value

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None without a goal.

        Raises ValueError for a goal that is not a comparison.
        """
        if not self.goal:
            return None
        comparison, _, bound = self.goal.partition(" ")
        if comparison not in _COMPARISONS:
            raise ValueError(
                f"goal {self.goal!r} of {self.name!r}: must start with one of "
                f"{', '.join(_COMPARISONS)}"
            )
        measured = self.value if self.ratio is None else self.ratio
        return _COMPARISONS[comparison](measured, float(bound))

    def cells(self) -> tuple[str, ...]:
        """The row as text in the order of `CSV_HEADER`."""
        numbers = [
            ("" if number is None else f"{number:.6g}")
            for number in (self.value, self.peer_value, self.ratio)
        ]
        return (self.name, numbers[0], self.unit, self.goal, numbers[1], numbers[2])
