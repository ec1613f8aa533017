"""A calculation written out once as straight-line NumPy: what is known to be 0 or 1 stays out, nothing is done twice.

A model that reads as vectors and small functions spends most of its time in Python when it runs as it reads. Run with
a `Symbol` for every number that comes later, it leaves one line for each operation; those lines are the function.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

_FUNCTIONS = ("sin", "cos", "exp", "log", "sqrt", "tanh")
_NAME = re.compile(r"\b[av]\d+\b")


class Symbol:
    """A number whose value comes later. Python and NumPy do to it what they do to a float: it writes that down."""

    __slots__ = ("_lines", "_name")

    def __init__(self, lines: dict[str, str], name: str) -> None:
        self._lines, self._name = lines, name

    def __add__(self, other: Any) -> Any:
        return self if _is(other, 0.0) else self._with(other, "+")

    def __mul__(self, other: Any) -> Any:
        if _is(other, 0.0) or _is(other, 1.0):
            return self if other else 0.0
        return self._with(other, "*")

    def __sub__(self, other: Any) -> Any:
        return self if _is(other, 0.0) else self._with(other, "-")

    def __rsub__(self, other: Any) -> Any:
        return -self if _is(other, 0.0) else self._with(other, "-", swapped=True)

    def __truediv__(self, other: Any) -> Any:
        return self._with(other, "/") if isinstance(other, Symbol) else self * (1.0 / other)

    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if _is(other, 0.0) else self._with(other, "/", swapped=True)

    def __neg__(self) -> Symbol:
        return self._written(f"-{self._name}")

    def __pow__(self, power: int) -> Any:
        if not isinstance(power, int) or power < 1:
            raise TypeError(f"power {power}: only 1, 2, 3 ... can be written out")
        return self * self ** (power - 1) if power > 1 else self

    def __bool__(self) -> bool:
        raise TypeError("a branch on a number whose value comes later cannot be written out")

    def __eq__(self, _other: object) -> bool:
        return bool(self)  # as every comparison: refused

    def __getattr__(self, name: str) -> Callable[[], Symbol]:
        if name not in _FUNCTIONS:
            raise AttributeError(name)
        return lambda: self._written(f"{name}({self._name})")

    __radd__, __rmul__ = __add__, __mul__

    def _with(self, other: Any, sign: str, swapped: bool = False) -> Any:
        if not isinstance(other, (Symbol, float, int)):
            return NotImplemented
        pair = [self._name, other._name if isinstance(other, Symbol) else repr(float(other))]
        if swapped or (sign in "+*" and pair[1] < pair[0]):
            pair.reverse()
        return self._written(f" {sign} ".join(pair))

    def _written(self, line: str) -> Symbol:
        return Symbol(self._lines, self._lines.setdefault(line, f"v{len(self._lines)}"))

    def __str__(self) -> str:
        return self._name


def _is(value: Any, number: float) -> bool:
    return isinstance(value, (float, int)) and value == number


@lru_cache(256)
def written_out(
    calculation: Callable[..., tuple[Any, ...]], arguments: int, *constants: Any
) -> Callable[..., tuple[Any, ...]]:
    """The calculation as a function of NumPy numbers or arrays that broadcast, real or complex.

    Args:
        calculation: of the constants and so many numbers, to a tuple of numbers; made of arithmetic, whole powers and
            NumPy's sin, cos, exp, log, sqrt and tanh, without branches that depend on the numbers.
        arguments: how many numbers it takes.
        constants: known now; hashable.

    Raises:
        TypeError, AttributeError: the calculation does something else.
    """
    lines: dict[str, str] = {}
    names = [f"a{number}" for number in range(arguments)]
    results = calculation(*constants, *(Symbol(lines, name) for name in names))
    body = _with_few_names(lines, ", ".join(map(str, results)))
    source = "\n    ".join([f"def written({', '.join(names)}):", *body])
    scope: dict[str, Any] = {name: getattr(np, name) for name in _FUNCTIONS}
    exec(source, scope)  # of operations, names and numbers alone, all of them from above
    function: Callable[..., tuple[Any, ...]] = scope["written"]
    return function


def _with_few_names(lines: dict[str, str], results: str) -> list[str]:
    """The lines that the results need; a name whose value is used up is taken again, so that its memory is."""
    last: dict[str, int] = dict.fromkeys(_NAME.findall(results), len(lines))
    for place, (line, name) in reversed(list(enumerate(lines.items()))):
        if name in last:
            for operand in _NAME.findall(line):
                last.setdefault(operand, place)
    given: dict[str, str] = {}
    free: list[str] = []
    body: list[str] = []

    def renamed(text: str) -> str:
        return _NAME.sub(lambda found: given.get(found[0], found[0]), text)

    for place, (line, name) in enumerate(lines.items()):
        if name not in last:
            continue
        text = renamed(line)
        free += [given[operand] for operand in set(_NAME.findall(line)) if operand in given and last[operand] == place]
        given[name] = free.pop() if free else f"r{len(body)}"
        body.append(f"{given[name]} = {text}")
    return [*body, f"return ({renamed(results)},)"]
