"""Compiles NumPy functions of many cars to machine code.

A function is called once on `Symbols`, arrays that record their operations. The record has no loops, no branches and
no repeated parts. LLVM translates it into code that works on `LANES` cars at a time. The NumPy function stays the only
definition of the model. Results differ by rounding only (fused multiply and add), but for NaN: minimum, maximum and
choices need not carry it through.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache, partial, reduce
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from aerodima.optimisation.screening.vehicles import Vehicles
from aerodima.workbench.config.array_types import FloatArray

LANES = 8
"""Cars that one pass works on: two registers of AVX2, one of AVX-512."""


class Value:
    """Place of a result in the recorded list."""

    def __init__(self, place: int) -> None:
        self.place = place


class Recording:
    """Operations on `Value`s in order, each once: `(name, operand, ...)`."""

    def __init__(self) -> None:
        self.operations: list[tuple[Any, ...]] = []
        self._known: dict[tuple[Any, ...], Value] = {}

    def add(self, name: str, *operands: Any) -> Value:
        """Result of an operation; the one that is known where it was recorded before."""
        key = (name, *(("value", one.place) if isinstance(one, Value) else float(one) for one in operands))
        if key not in self._known:
            self._known[key] = Value(len(self.operations))
            self.operations.append(key)
        return self._known[key]


def _plain(*operands: Any) -> bool:
    return not any(isinstance(one, Value) for one in operands)


def _is(operand: Any, number: float) -> bool:
    return not isinstance(operand, Value) and operand == number


def _product(record: Recording, a: Any, b: Any) -> Any:
    if _is(a, 0.0) or _is(b, 0.0):
        return 0.0
    return b if _is(a, 1.0) else a if _is(b, 1.0) else record.add("fmul", a, b)


def _sum(record: Recording, a: Any, b: Any) -> Any:
    return b if _is(a, 0.0) else a if _is(b, 0.0) else record.add("fadd", a, b)


def _difference(record: Recording, a: Any, b: Any) -> Any:
    return a if _is(b, 0.0) else record.add("fsub", a, b)


def _quotient(record: Recording, a: Any, b: Any) -> Any:
    return 0.0 if _is(a, 0.0) else a if _is(b, 1.0) else record.add("fdiv", a, b)


def _power(record: Recording, a: Any, b: Any) -> Any:
    if _is(b, 2.0):
        return _product(record, a, a)
    if _is(b, 0.5):
        return record.add("sqrt", a)
    raise NotImplementedError(f"power {b}; known: 2, 0.5")


def _named(name: str) -> Callable[..., Any]:
    return lambda record, *operands: record.add(name, *operands)


def _clip(record: Recording, a: Any, low: Any, high: Any) -> Any:
    return record.add("min", record.add("max", a, low), high)


OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": _sum,
    "subtract": _difference,
    "multiply": _product,
    "divide": _quotient,
    "power": _power,
    "square": lambda record, a: _product(record, a, a),
    "negative": lambda record, a: record.add("fsub", 0.0, a),
    "absolute": _named("fabs"),
    "maximum": _named("max"),
    "minimum": _named("min"),
    "clip": _clip,
    "less": _named("olt"),
    "less_equal": _named("ole"),
    "greater": lambda record, a, b: record.add("olt", b, a),
    "greater_equal": lambda record, a, b: record.add("ole", b, a),
    "bitwise_and": _product,
    **{name: _named(name) for name in ("sin", "cos", "sqrt", "tanh")},
}
"""By the name of the NumPy function; a comparison gives 1 or 0."""
INTRINSICS = ("sin", "cos", "sqrt", "fabs", "tanh")
"""Operations that are functions of LLVM."""


class Symbols(np.ndarray):
    """An array of `Value`s and constants that records its operations; each recording has a subclass of its own."""

    recording: Recording
    __array_priority__ = 1.0  # `np.concatenate` gives the class of the highest

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **others: Any) -> Any:
        """Records an elementwise function or a sum."""
        record = self.recording
        operation = OPERATIONS.get(ufunc.__name__)
        axis = others.pop("axis", 0)
        plain_sum = {"dtype": None, "keepdims": False, "initial": np._NoValue, "where": True}
        unknown = [name for name, value in others.items() if name not in plain_sum or value is not plain_sum[name]]
        if operation is None or method not in ("__call__", "reduce") or unknown:
            raise NotImplementedError(f"numpy.{ufunc.__name__} {method} {unknown} cannot be compiled")

        def of_elements(*operands: Any) -> Any:
            if _plain(*operands):
                return ufunc(*operands)
            return operation(record, *operands)

        plain = [np.asarray(one).view(np.ndarray) for one in inputs]
        each = np.frompyfunc(of_elements, ufunc.nin, 1)
        if method == "reduce":
            found: Any = plain[0]
            axes = range(found.ndim) if axis is None else (axis,) if isinstance(axis, int) else axis
            for one in sorted((axis % found.ndim for axis in axes), reverse=True):
                rows = np.moveaxis(found, one, 0)
                found = reduce(each, rows) if len(rows) else np.zeros(rows.shape[1:], object)
        else:
            found = each(*plain)
        if out is not None:
            target: Any = out[0]
            target[...] = found
            return target
        return np.asarray(found, object).view(type(self))

    def __array_function__(self, function: Any, types: Any, arguments: Any, keywords: Any) -> Any:
        """Records a choice; functions that move elements are NumPy's own."""
        if function is not np.where:
            return super().__array_function__(function, types, arguments, keywords)
        choose = np.frompyfunc(partial(self.recording.add, "select"), 3, 1)
        return np.asarray(choose(*(np.asarray(one) for one in arguments)), object).view(type(self))


def _machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=2, jit=True
    )


def for_cars(function: Callable[..., Sequence[Any]], cars: Vehicles, *shapes: tuple[int, ...]) -> Callable[..., Any]:
    """The compiled function of these cars: takes the arrays after the first argument, gives a list of arrays.

    Args:
        function: of `Vehicles` and arrays with these shapes and a last axis of cars; compiled once in a process.
        cars: n of them.
        shapes: of its arrays, without the last axis.

    Raises:
        ValueError: no cars.
        NotImplementedError: as `Compiled`.
    """
    if cars.count < 1:
        raise ValueError("no cars: at least one is needed")
    own = [getattr(cars, field.name) for field in fields(cars)]
    kernel = _kernel(function, (*(one.shape[:-1] for one in own), *shapes))
    count = cars.count
    rows = kernel.rows_for(count)
    first = sum(one[..., 0].size for one in own)
    rows[:first, :count] = np.concatenate([one.reshape(-1, count) for one in own])

    def call(*arrays: FloatArray) -> list[FloatArray]:
        rows[first:, :count] = np.concatenate([one.reshape(-1, count) for one in arrays])
        rows[:, count:] = rows[:, count - 1 : count]
        return kernel(rows, count)

    return call


@lru_cache(maxsize=16)
def _kernel(function: Callable[..., Sequence[Any]], shapes: tuple[tuple[int, ...], ...]) -> Compiled:
    names = [field.name for field in fields(Vehicles)]

    def of_arrays(*arrays: Any) -> Sequence[Any]:
        return function(Vehicles(**dict(zip(names, arrays, strict=False))), *arrays[len(names) :])

    return Compiled(of_arrays, shapes)


class Compiled:
    """A compiled function of arrays whose last axis is the car.

    Attributes:
        operations: number of different ones, the inputs included.

    Args:
        function: takes arrays, gives arrays; uses the NumPy functions of `OPERATIONS` and shapes only.
        shapes: of its arguments, without the last axis.

    Raises:
        NotImplementedError: the function uses another function of NumPy.
    """

    def __init__(self, function: Callable[..., Sequence[Any]], shapes: Sequence[tuple[int, ...]]) -> None:
        record = Recording()
        arguments: list[Any] = []
        symbols = type("RecordedSymbols", (Symbols,), {"recording": record})
        for shape in shapes:
            rows = [record.add("in", len(record.operations)) for _ in range(int(np.prod(shape, dtype=int)))]
            arguments.append(np.array(rows, object).reshape(*shape, 1).view(symbols))
        self._rows_in = len(record.operations)
        results = [np.asarray(one, object).view(np.ndarray) for one in function(*arguments)]
        self._shapes = [one.shape[:-1] for one in results]
        given = [value for one in results for value in one.reshape(-1)]
        self._rows_out, self.operations = len(given), len(record.operations)
        module = llvm.parse_assembly(_assembly(record.operations, given))
        module.verify()
        self._engine = llvm.create_mcjit_compiler(module, _machine())
        self._engine.finalize_object()
        address = self._engine.get_function_address("batch")
        number = ctypes.c_int64
        self._call = ctypes.CFUNCTYPE(None, number, number, ctypes.c_void_p, ctypes.c_void_p)(address)

    def __call__(self, rows: FloatArray, cars: int) -> list[FloatArray]:
        """Results for the first of the cars.

        Args:
                rows: of `rows_for`, filled with the arguments one after another.
            cars: how many are wanted.
        """
        found = np.empty((self._rows_out, rows.shape[1]))
        self._call(rows.shape[1], rows.shape[1], rows.ctypes.data, found.ctypes.data)
        results, place = [], 0
        for shape in self._shapes:
            size = int(np.prod(shape, dtype=int))
            results.append(found[place : place + size, :cars].reshape(*shape, cars))
            place += size
        return results

    def rows_for(self, cars: int) -> FloatArray:
        """Rows for the arguments, the columns rounded up to `LANES`."""
        return np.ones((self._rows_in, -(-cars // LANES) * LANES))


def _assembly(operations: Sequence[tuple[Any, ...]], results: Sequence[Any]) -> str:
    """LLVM assembly of `void batch(cars, stride, in, out)`."""
    kind = f"<{LANES} x double>"

    def name(operand: Any) -> str:
        if isinstance(operand, tuple):
            return f"%v{operand[1]}"
        number = f"double 0x{np.float64(operand).view(np.uint64):016X}"
        return "<" + ", ".join([number] * LANES) + ">"

    needed, waiting = set(), [one.place for one in results if isinstance(one, Value)]
    while waiting:
        if (place := waiting.pop()) not in needed:
            needed.add(place)
            waiting += [one[1] for one in operations[place][1:] if isinstance(one, tuple)]
    lines: list[str] = []
    for place in sorted(needed):
        what, *operands = operations[place]
        if what == "in":
            lines += _address("in", int(operands[0]), place)
            lines.append(f"%v{place} = load {kind}, ptr %p_in_{place}, align 8")
            continue
        first, *others = (name(one) for one in operands)
        if what in ("min", "max"):
            lines.append(f"%c{place} = fcmp {'olt' if what == 'min' else 'ogt'} {kind} {first}, {others[0]}")
            lines.append(f"%v{place} = select <{LANES} x i1> %c{place}, {kind} {first}, {kind} {others[0]}")
        elif what in ("olt", "ole"):
            lines.append(f"%c{place} = fcmp {what} {kind} {first}, {others[0]}")
            lines.append(f"%v{place} = uitofp <{LANES} x i1> %c{place} to {kind}")
        elif what == "select":
            lines.append(f"%c{place} = fcmp one {kind} {first}, zeroinitializer")
            lines.append(f"%v{place} = select <{LANES} x i1> %c{place}, {kind} {others[0]}, {kind} {others[1]}")
        elif what in INTRINSICS:
            lines.append(f"%v{place} = call {kind} @llvm.{what}.v{LANES}f64({kind} {first})")
        else:
            lines.append(f"%v{place} = {what} contract {kind} {first}, {others[0]}")
    for row, result in enumerate(results):
        value = name(("value", result.place) if isinstance(result, Value) else result)
        lines += [*_address("out", row, row), f"store {kind} {value}, ptr %p_out_{row}, align 8"]
    declared = "\n".join(f"declare {kind} @llvm.{one}.v{LANES}f64({kind})" for one in INTRINSICS)
    body = "\n  ".join(lines)
    return f"""{declared}
define void @batch(i64 %cars, i64 %stride, ptr noalias %in, ptr noalias %out) {{
entry:
  br label %loop
loop:
  %j = phi i64 [ 0, %entry ], [ %next, %loop ]
  {body}
  %next = add i64 %j, {LANES}
  %more = icmp slt i64 %next, %cars
  br i1 %more, label %loop, label %end
end:
  ret void
}}
"""


def _address(array: str, row: int, place: int) -> list[str]:
    return [
        f"%r_{array}_{place} = mul i64 %stride, {row}",
        f"%o_{array}_{place} = add i64 %r_{array}_{place}, %j",
        f"%p_{array}_{place} = getelementptr double, ptr %{array}, i64 %o_{array}_{place}",
    ]
