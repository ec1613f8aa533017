"""Steps batches of cars in machine code that is made from their NumPy functions.

The functions of a batch are called once on `Symbols`, arrays that record their operations. A record
has no loops, no branches and no repeated parts. LLVM translates it into code that works on `LANES`
cars at a time, all steps of them before the next ones, so that their numbers stay in the cache. The
NumPy functions stay the only definition of the model. Results differ by rounding only (fused
multiply and add; series of sin, cos, tan, arctan, tanh, within 2e-15), but for NaN: minimum,
maximum and choices need not carry it through.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from functools import partial, reduce
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from aerodima.workbench.core.array_types import FloatArray

LANES = 8 if llvm.get_host_cpu_features().get("avx512f") else 4
"""Cars that one pass works on: a register of AVX-512 or of AVX2."""
_NAMED = {
    "maximum": "max",
    "minimum": "min",
    "bitwise_or": "max",
    "less": "olt",
    "less_equal": "ole",
    "equal": "oeq",
}
INTRINSICS = ("sqrt", "fabs", "rint")
"""Operations that are functions of LLVM."""
_COMPILED: dict[tuple[Any, ...], Compiled] = {}
_KIND = f"<{LANES} x double>"
_DECLARED = "\n".join(f"declare {_KIND} @llvm.{name}.v{LANES}f64({_KIND})" for name in INTRINSICS)
_LOOP = """
define void @run(i64 %steps, i64 %stride, ptr %given, ptr %own, ptr %kept) {{
entry:
  br label %begin
begin:
  %s = phi i64 [ 0, %entry ], [ %next, %ticked ]
  %first = mul i64 %s, {GIVEN}
  %now = getelementptr double, ptr %given, i64 %first
  %flag = load double, ptr %now
  %ticks = fcmp one double %flag, 0.0
  br i1 %ticks, label %ticking, label %ticked
ticking:
  call void @tick(ptr %own, ptr %now, ptr %kept)
  br label %ticked
ticked:
  %before = mul i64 %s, %stride
  %place = getelementptr double, ptr %kept, i64 %before
  call void @step(ptr %own, ptr %now, ptr %place)
  %next = add i64 %s, 1
  %more = icmp slt i64 %next, %steps
  br i1 %more, label %begin, label %end
end:
  ret void
}}
"""


def run(batch: Any, ticks: np.ndarray, *given: np.ndarray, keep: bool = False) -> list[FloatArray]:
    """Steps the cars of a batch in compiled code.

    Args:
        batch: `batch.step(*numbers)` replaces arrays of the batch, or of objects that it consists
            of, and returns arrays; `batch.tick(*numbers)` replaces arrays. The last axis of all
            arrays is the car. Both use the NumPy functions of `OPERATIONS` and shapes only. They
            are compiled once in a process for each class, shapes and constants.
        ticks: whether a step begins with a tick (steps).
        given: the numbers, of all cars (steps) each.
        keep: what the steps returned.

    Returns:
        What the steps returned (steps, ..., n) each; nothing unless it is kept.

    Raises:
        ValueError: no cars.
        NotImplementedError: a function that cannot be compiled.
    """
    values = [attributes[name] for attributes, name in _attributes(batch, set())]
    counts = {value.shape[-1] for value in values if isinstance(value, np.ndarray)}
    if len(counts) != 1 or 0 in counts:
        raise ValueError(f"cars: {sorted(counts)}; one number, at least 1, is needed")
    if not len(ticks):
        return []
    layout = (
        value.shape[:-1] if isinstance(value, np.ndarray) else ("constant", value)
        for value in values
    )
    key = (type(batch), len(given), *layout)
    if key not in _COMPILED:
        _COMPILED[key] = Compiled(batch, len(given))
    numbers = np.stack([ticks, *given], axis=-1).astype(float)
    return _COMPILED[key](batch, numbers, keep)


def _attributes(batch: Any, known: set[int]) -> Iterator[tuple[dict[str, Any], str]]:
    """Where the arrays and constants of an object are, and those of its parts, each part once."""
    if id(batch) in known:
        return
    known.add(id(batch))
    for name, value in vars(batch).items():
        if hasattr(value, "__dict__") and not isinstance(value, np.ndarray) and not callable(value):
            yield from _attributes(value, known)
        else:
            yield vars(batch), name


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
        key = (
            name,
            *(("value", one.place) if isinstance(one, Value) else float(one) for one in operands),
        )
        if name in ("fadd", "fmul"):
            key = (name, *sorted(key[1:], key=str))
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
    if _is(a, 1.0):
        return b
    if _is(b, 1.0):
        return a
    return record.add("fmul", a, b)


def _sum(record: Recording, a: Any, b: Any) -> Any:
    if _is(a, 0.0):
        return b
    if _is(b, 0.0):
        return a
    return record.add("fadd", a, b)


def _difference(record: Recording, a: Any, b: Any) -> Any:
    if _is(b, 0.0):
        return a
    return record.add("fsub", a, b)


def _quotient(record: Recording, a: Any, b: Any) -> Any:
    if not isinstance(b, Value):
        return _product(record, a, 1.0 / b)
    if _is(a, 0.0):
        return 0.0
    return record.add("fdiv", a, b)


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


def _series(record: Recording, x: Any, factors: Sequence[float]) -> Any:
    """Sum of factors times powers of x, from 0 on."""
    found: Any = factors[-1]
    for factor in reversed(factors[:-1]):
        found = record.add("fadd", record.add("fmul", found, x), factor)
    return found


def _sine(record: Recording, a: Any, ahead: float = 0.0) -> Any:
    """sin(a + ahead pi) for |a| below 1e6: by its series within a quarter turn of the next multiple
    of pi.
    """
    add = record.add
    quarter = _sum(record, add("fmul", a, 1.0 / math.pi), ahead)
    halves = add("rint", quarter)
    turns = _difference(record, halves, ahead)
    x = add("fsub", a, add("fmul", turns, math.pi))
    lacking = add("fmul", turns, 1.2246467991473532e-16)  # what the double pi lacks
    x = add("fsub", x, lacking)
    factors = [(-1.0) ** k / math.factorial(2 * k + 1) for k in range(10)]
    series = _series(record, add("fmul", x, x), factors)
    half = add("fmul", halves, 0.5)
    odd = add("fsub", half, add("rint", half))  # 0, or a half to either side
    square = add("fmul", odd, odd)
    sign = add("fsub", 1.0, add("fmul", square, 8.0))
    return add("fmul", add("fmul", sign, x), series)


def _arctan(record: Recording, a: Any) -> Any:
    """For |a| below 1e150: the angle is halved three times, to its series below 0.2."""
    add = record.add
    for _ in range(3):
        square = add("fmul", a, a)
        root = add("sqrt", add("fadd", square, 1.0))
        a = add("fdiv", a, add("fadd", root, 1.0))
    factors = [8.0 * (-1.0) ** k / (2 * k + 1) for k in range(11)]
    series = _series(record, add("fmul", a, a), factors)
    return add("fmul", a, series)


def _tanh(record: Recording, a: Any) -> Any:
    """E / (E + 2) with E = exp(2 a) - 1, doubled six times in its exponent; 1 beyond 20."""
    add = record.add
    clipped = _clip(record, a, -20.0, 20.0)
    x = add("fmul", clipped, 2.0**-5)
    factors = [1.0 / math.factorial(k + 1) for k in range(16)]
    e = add("fmul", x, _series(record, x, factors))
    for _ in range(6):
        e = add("fmul", e, add("fadd", e, 2.0))
    return add("fdiv", e, add("fadd", e, 2.0))


_NAMED |= {"absolute": "fabs", "sqrt": "sqrt", "rint": "rint"}
OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "add": _sum,
    "subtract": _difference,
    "divide": _quotient,
    "power": _power,
    "square": lambda record, a: _product(record, a, a),
    "negative": lambda record, a: record.add("fsub", 0.0, a),
    "clip": _clip,
    "greater": lambda record, a, b: record.add("olt", b, a),
    "greater_equal": lambda record, a, b: record.add("ole", b, a),
    "isnan": lambda record, a: record.add("uno", a, a),
    "invert": lambda record, a: record.add("fsub", 1.0, a),
    "sin": _sine,
    "cos": lambda record, a: _sine(record, a, 0.5),
    "tan": lambda record, a: record.add("fdiv", _sine(record, a), _sine(record, a, 0.5)),
    "arctan": _arctan,
    "tanh": _tanh,
    **dict.fromkeys(("multiply", "bitwise_and", "logical_and"), _product),
    **{name: _named(kind) for name, kind in _NAMED.items()},
}
"""By the name of the NumPy function; a comparison gives 1 or 0."""


class Symbols(np.ndarray):
    """An array of `Value`s and constants that records its operations; each recording has a subclass
    of its own.
    """

    recording: Recording
    __array_priority__ = 1.0  # `np.concatenate` gives the class of the highest

    def __array_ufunc__(
        self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **others: Any
    ) -> Any:
        """Records an elementwise function or a sum."""
        record = self.recording
        operation = OPERATIONS.get(ufunc.__name__)
        axis = others.pop("axis", 0)
        plain_sum = {"dtype": None, "keepdims": False, "initial": np._NoValue, "where": True}
        unknown = [
            name
            for name, value in others.items()
            if name not in plain_sum or value is not plain_sum[name]
        ]
        if operation is None or method not in ("__call__", "reduce") or unknown:
            raise NotImplementedError(
                f"numpy.{ufunc.__name__} {method} {unknown} cannot be compiled"
            )

        def of_elements(*operands: Any) -> Any:
            if _plain(*operands):
                return ufunc(*operands)
            return operation(record, *operands)

        plain = [np.asarray(one).view(np.ndarray) for one in inputs]
        each = np.frompyfunc(of_elements, ufunc.nin, 1)
        if method == "reduce":
            found: Any = plain[0]
            axes: Sequence[int]
            if axis is None:
                axes = range(found.ndim)
            elif isinstance(axis, int):
                axes = (axis,)
            else:
                axes = axis
            for one in sorted((axis % found.ndim for axis in axes), reverse=True):
                rows = np.moveaxis(found, one, 0)
                if len(rows):
                    found = reduce(each, rows)
                else:
                    found = np.zeros(rows.shape[1:], object)
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


class Compiled:
    """Tick and step of a batch with these shapes and constants; see `run`.

    Args:
        batch: stays as it is.
        given: how many numbers each step is given.
    """

    def __init__(self, batch: Any, given: int) -> None:
        batch = deepcopy(batch)
        places = [
            (own, name)
            for own, name in _attributes(batch, set())
            if isinstance(own[name], np.ndarray)
        ]
        shapes = [own[name].shape[:-1] for own, name in places]
        ends = np.cumsum([math.prod(shape) for shape in shapes]).tolist()
        self._rows = [
            slice(end - math.prod(shape), end) for shape, end in zip(shapes, ends, strict=True)
        ]
        self._count = ends[-1]
        self._changed = set()
        functions = []
        for function in ("tick", "step"):
            record = Recording()
            symbols = type("RecordedSymbols", (Symbols,), {"recording": record})
            numbers: Any = [
                np.array([record.add("given", k)], object).view(symbols)
                for k in range(1, given + 1)
            ]
            before = [record.add("own", row) for row in range(self._count)]
            for (own, name), rows, shape in zip(places, self._rows, shapes, strict=True):
                own[name] = np.array(before[rows], object).reshape(*shape, 1).view(symbols)
            kept = getattr(batch, function)(*numbers) or []
            stored = {}
            for index, ((own, name), rows) in enumerate(zip(places, self._rows, strict=True)):
                after = np.asarray(own[name], object).view(np.ndarray).reshape(-1)
                for row, (old, new) in enumerate(zip(before[rows], after, strict=True), rows.start):
                    if new is not old:
                        stored[row] = new
                        self._changed.add(index)
            kept = [np.asarray(one, object).view(np.ndarray) for one in kept]
            functions.append(
                _function(
                    function, record.operations, stored, [v for one in kept for v in one.ravel()]
                )
            )
        self._kept = [one.shape[:-1] for one in kept]
        self._width = sum(map(math.prod, self._kept))
        loop = _LOOP.format(GIVEN=LANES * (given + 1))
        module = llvm.parse_assembly("\n".join([_DECLARED, *functions, loop]))
        module.verify()
        self._engine = llvm.create_mcjit_compiler(module, _machine())
        self._engine.finalize_object()
        kinds = [ctypes.c_int64] * 2 + [ctypes.c_void_p] * 3
        self._call = ctypes.CFUNCTYPE(None, *kinds)(self._engine.get_function_address("run"))

    def __call__(self, batch: Any, given: FloatArray, keep: bool) -> list[FloatArray]:
        """Steps the cars of a batch.

        Args:
            batch: of these shapes and constants.
            given: whether a step begins with a tick, and its numbers (steps, 1 + numbers).
            keep: what the steps returned.
        """
        places = [
            (own, name)
            for own, name in _attributes(batch, set())
            if isinstance(own[name], np.ndarray)
        ]
        arrays = [own[name] for own, name in places]
        numbers = np.concatenate(
            [array.reshape(-1, array.shape[-1]) for array in arrays], dtype=float
        )
        cars = numbers.shape[1]
        numbers = np.pad(numbers, ((0, 0), (0, -cars % LANES)), mode="edge")
        memory = np.empty(numbers.size + LANES)
        first = -memory.ctypes.data // 8 % LANES  # aligned
        rows = memory[first : first + numbers.size].reshape(-1, self._count, LANES)
        rows[:] = numbers.reshape(self._count, -1, LANES).swapaxes(0, 1)
        given = np.repeat(given[..., None], LANES, axis=-1)
        steps = len(given)
        width = self._width
        kept = np.empty((len(rows), steps if keep else 1, width, LANES))
        stride = LANES * width * keep  # what is not kept is written to one place
        for block, place in zip(rows, kept, strict=True):
            self._call(steps, stride, given.ctypes.data, block.ctypes.data, place.ctypes.data)
        numbers = rows.swapaxes(0, 1).reshape(self._count, -1)[:, :cars]
        for index in self._changed:
            own, name = places[index]
            array = arrays[index]
            own[name] = numbers[self._rows[index]].reshape(array.shape).astype(array.dtype)
        if not keep:
            return []
        kept = np.moveaxis(kept, 0, 2).reshape(steps, width, -1)[..., :cars]
        ends = np.cumsum([math.prod(shape) for shape in self._kept])
        parts = np.split(kept, ends[:-1], axis=1)
        return [
            part.reshape(steps, *shape, cars) for part, shape in zip(parts, self._kept, strict=True)
        ]


def _machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=2,
        jit=True,
    )


def _function(
    name: str, operations: Sequence[tuple[Any, ...]], stored: Mapping[int, Any], kept: Sequence[Any]
) -> str:
    """LLVM assembly of a function of the rows of some cars, of numbers, and of a place for what is
    kept.

    Args:
        stored: by row, what replaces it.
        kept: results.
    """
    needed = set()
    waiting = [one.place for one in (*stored.values(), *kept) if isinstance(one, Value)]
    while waiting:
        place = waiting.pop()
        if place not in needed:
            needed.add(place)
            waiting += [one[1] for one in operations[place][1:] if isinstance(one, tuple)]
    lines: list[str] = []
    for place in sorted(needed):
        lines += _instructions(place, operations[place])
    for base, results in (("own", stored.items()), ("kept", enumerate(kept))):
        for row, result in results:
            pointer = f"%{base}{row}"
            lines.append(f"{pointer} = getelementptr double, ptr %{base}, i64 {row * LANES}")
            lines.append(f"store {_KIND} {_operand(result)}, ptr {pointer}, align 8")
    body = "\n  ".join([*lines, "ret void"])
    return (
        f"define void @{name}(ptr noalias %own, ptr noalias %given, ptr noalias %kept) {{\n  "
        f"{body}\n}}\n"
    )


def _operand(operand: Any) -> str:
    """Writes a result or a constant as an operand of LLVM."""
    if isinstance(operand, Value):
        return f"%v{operand.place}"
    if isinstance(operand, tuple):
        return f"%v{operand[1]}"
    number = f"double 0x{np.float64(operand).view(np.uint64):016X}"
    return "<" + ", ".join([number] * LANES) + ">"


def _instructions(place: int, operation: tuple[Any, ...]) -> list[str]:
    """Writes the instructions of the operation at a place of the recorded list."""
    what, *operands = operation
    v = f"%v{place} ="
    p = f"%p{place}"
    c = f"%c{place}"
    if what in ("own", "given"):
        offset = int(operands[0]) * LANES
        pointer = f"{p} = getelementptr double, ptr %{what}, i64 {offset}"
        return [pointer, f"{v} load {_KIND}, ptr {p}, align 8"]
    first, *others = map(_operand, operands)
    if what in INTRINSICS:
        return [f"{v} call {_KIND} @llvm.{what}.v{LANES}f64({_KIND} {first})"]
    second = others[0]
    if what == "select":
        condition = f"{c} = fcmp one {_KIND} {first}, zeroinitializer"
        choice = f"{v} select <{LANES} x i1> {c}, {_KIND} {second}, {_KIND} {others[1]}"
        return [condition, choice]
    if what in ("min", "max"):
        test = "olt" if what == "min" else "ogt"
        condition = f"{c} = fcmp {test} {_KIND} {first}, {second}"
        choice = f"{v} select <{LANES} x i1> {c}, {_KIND} {first}, {_KIND} {second}"
        return [condition, choice]
    if what in ("olt", "ole", "oeq", "uno"):
        condition = f"{c} = fcmp {what} {_KIND} {first}, {second}"
        return [condition, f"{v} uitofp <{LANES} x i1> {c} to {_KIND}"]
    return [f"{v} {what} contract {_KIND} {first}, {second}"]
