"""Arrays that record what NumPy does with them.

A trace has no loops, no branches and no repeated parts. Functions that no processor has (sin, cos,
tan, arctan, tanh) are recorded as series, within 2e-15.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

_PI_REMAINDER = 1.2246467991473532e-16
"""Pi less its value as a double."""
_DIRECT = {
    "maximum": "max",
    "minimum": "min",
    "bitwise_or": "max",
    "less": "olt",
    "less_equal": "ole",
    "equal": "oeq",
    "absolute": "fabs",
    "sqrt": "sqrt",
    "rint": "rint",
}
"""NumPy functions that are one operation of the trace."""
_SUM_DEFAULTS = {"dtype": None, "keepdims": False, "initial": np._NoValue, "where": True}
"""Keywords with which NumPy calls a plain sum."""


class Node:
    """Result of an operation, by its index in the trace."""

    def __init__(self, index: int) -> None:
        self.index = index


class Trace:
    """Operations on `Node`s in order, each once: `(name, operand, ...)`."""

    def __init__(self) -> None:
        self.operations: list[tuple[Any, ...]] = []
        self._known: dict[tuple[Any, ...], Node] = {}

    def add(self, name: str, *operands: Any) -> Node:
        """Records an operation; returns the known result where it was recorded before."""
        key: tuple[Any, ...] = tuple(
            ("value", one.index) if isinstance(one, Node) else float(one) for one in operands
        )
        if name in ("fadd", "fmul"):
            key = tuple(sorted(key, key=str))
        operation = (name, *key)
        if operation not in self._known:
            self._known[operation] = Node(len(self.operations))
            self.operations.append(operation)
        return self._known[operation]


def _product(trace: Trace, a: Any, b: Any) -> Any:
    if 0.0 in (a, b):
        return 0.0
    if a == 1.0:
        return b
    if b == 1.0:
        return a
    return trace.add("fmul", a, b)


def _sum(trace: Trace, a: Any, b: Any) -> Any:
    if a == 0.0:
        return b
    if b == 0.0:
        return a
    return trace.add("fadd", a, b)


def _difference(trace: Trace, a: Any, b: Any) -> Any:
    if b == 0.0:
        return a
    return trace.add("fsub", a, b)


def _quotient(trace: Trace, a: Any, b: Any) -> Any:
    if not isinstance(b, Node):
        return _product(trace, a, 1.0 / b)
    if a == 0.0:
        return 0.0
    return trace.add("fdiv", a, b)


def _power(trace: Trace, a: Any, b: Any) -> Any:
    if b == 2.0:
        return _product(trace, a, a)
    if b == 0.5:
        return trace.add("sqrt", a)
    raise NotImplementedError(f"power {b}; known: 2, 0.5")


def _direct(name: str) -> Callable[..., Any]:
    return lambda trace, *operands: trace.add(name, *operands)


def _clip(trace: Trace, a: Any, low: Any, high: Any) -> Any:
    return trace.add("min", trace.add("max", a, low), high)


def _series(trace: Trace, x: Any, factors: Sequence[float]) -> Any:
    """Records the sum of factors times powers of x, from 0 on."""
    total: Any = factors[-1]
    for factor in reversed(factors[:-1]):
        total = trace.add("fadd", trace.add("fmul", total, x), factor)
    return total


def _sine(trace: Trace, a: Any, ahead: float = 0.0) -> Any:
    """Records sin(a + ahead pi) for |a| below 1e6, by its series within a quarter turn of the next
    multiple of pi.
    """
    add = trace.add
    quarter = _sum(trace, add("fmul", a, 1.0 / math.pi), ahead)
    halves = add("rint", quarter)
    turns = _difference(trace, halves, ahead)
    x = add("fsub", a, add("fmul", turns, math.pi))
    x = add("fsub", x, add("fmul", turns, _PI_REMAINDER))
    factors = [(-1.0) ** k / math.factorial(2 * k + 1) for k in range(10)]
    series = _series(trace, add("fmul", x, x), factors)
    half = add("fmul", halves, 0.5)
    odd = add("fsub", half, add("rint", half))  # 0, or a half to either side
    square = add("fmul", odd, odd)
    sign = add("fsub", 1.0, add("fmul", square, 8.0))
    return add("fmul", add("fmul", sign, x), series)


def _arctan(trace: Trace, a: Any) -> Any:
    """Records the angle for |a| below 1e150; it is halved three times, to its series below 0.2."""
    add = trace.add
    for _ in range(3):
        square = add("fmul", a, a)
        root = add("sqrt", add("fadd", square, 1.0))
        a = add("fdiv", a, add("fadd", root, 1.0))
    factors = [8.0 * (-1.0) ** k / (2 * k + 1) for k in range(11)]
    return add("fmul", a, _series(trace, add("fmul", a, a), factors))


def _tanh(trace: Trace, a: Any) -> Any:
    """Records E / (E + 2) with E = exp(2 a) - 1, doubled six times in its exponent; 1 beyond 20."""
    add = trace.add
    x = add("fmul", _clip(trace, a, -20.0, 20.0), 2.0**-5)
    factors = [1.0 / math.factorial(k + 1) for k in range(16)]
    e = add("fmul", x, _series(trace, x, factors))
    for _ in range(6):
        e = add("fmul", e, add("fadd", e, 2.0))
    return add("fdiv", e, add("fadd", e, 2.0))


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": _sum,
    "subtract": _difference,
    "divide": _quotient,
    "power": _power,
    "square": lambda trace, a: _product(trace, a, a),
    "negative": lambda trace, a: trace.add("fsub", 0.0, a),
    "clip": _clip,
    "greater": lambda trace, a, b: trace.add("olt", b, a),
    "greater_equal": lambda trace, a, b: trace.add("ole", b, a),
    "isnan": lambda trace, a: trace.add("uno", a, a),
    "invert": lambda trace, a: trace.add("fsub", 1.0, a),
    "sin": _sine,
    "cos": lambda trace, a: _sine(trace, a, 0.5),
    "tan": lambda trace, a: trace.add("fdiv", _sine(trace, a), _sine(trace, a, 0.5)),
    "arctan": _arctan,
    "tanh": _tanh,
    **dict.fromkeys(("multiply", "bitwise_and", "logical_and"), _product),
    **{name: _direct(operation) for name, operation in _DIRECT.items()},
}
"""Recorded operations by the name of the NumPy function; a comparison gives 1 or 0."""


class TracedArray(np.ndarray):
    """An array of `Node`s and constants; `of_trace` makes a class of its own for each trace."""

    recorder: Trace
    __array_priority__ = 1.0  # `np.concatenate` returns the class with the highest

    @classmethod
    def of_trace(cls, trace: Trace) -> type[TracedArray]:
        """Returns the class of the arrays that record into a trace."""
        return type("TracedArrayOfOneTrace", (cls,), {"recorder": trace})

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **others: Any
    ) -> Any:
        """Records an elementwise function or a sum."""
        trace = self.recorder
        operation = OPERATIONS.get(ufunc.__name__)
        axis = others.pop("axis", 0)
        unknown = [
            name
            for name, value in others.items()
            if name not in _SUM_DEFAULTS or value is not _SUM_DEFAULTS[name]
        ]
        if operation is None or method not in ("__call__", "reduce") or unknown:
            raise NotImplementedError(
                f"numpy.{ufunc.__name__} {method} {unknown} cannot be compiled"
            )

        def of_elements(*operands: Any) -> Any:
            if any(isinstance(one, Node) for one in operands):
                return operation(trace, *operands)
            return ufunc(*operands)

        plain = [_plain(one) for one in inputs]
        elementwise: Any = np.frompyfunc(of_elements, ufunc.nin, 1, identity=ufunc.identity)
        if method == "reduce":
            result = elementwise.reduce(plain[0], axis=axis)
        else:
            result = elementwise(*plain)
        if out is not None:
            target: Any = out[0]
            target[...] = result
            return target
        return np.asarray(result, object).view(type(self))

    def __array_function__(self, function: Any, types: Any, arguments: Any, keywords: Any) -> Any:
        """Records a choice; functions that move elements are NumPy's own."""
        if function is not np.where:
            return super().__array_function__(function, types, arguments, keywords)
        choose = np.frompyfunc(partial(self.recorder.add, "select"), 3, 1)
        return np.asarray(choose(*map(_plain, arguments)), object).view(type(self))


def _plain(values: Any) -> np.ndarray:
    return np.asarray(values).view(np.ndarray)
