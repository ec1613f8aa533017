"""A trace as machine code of LLVM, which steps `LANES` cars at a time through all steps.

The numbers of some cars stay in the cache while they are stepped; see README.md.
"""

import ctypes
import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import llvmlite.binding as llvm
import numpy as np

from aerodima.workbench.car.reduced.compiled.batch_arrays import attributes
from aerodima.workbench.car.reduced.compiled.trace import Node, Trace, TracedArray
from aerodima.workbench.core.array_types import FloatArray

LANES = 8 if llvm.get_host_cpu_features().get("avx512f") else 4
"""Cars that one pass works on: a register of AVX-512 or of AVX2."""
INTRINSICS = ("sqrt", "fabs", "rint")
"""Operations that are functions of LLVM."""
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


class CompiledBatch:
    """Tick and step of batches with the same class, shapes and constants; see `steps.run`.

    Args:
        batch: one of these batches; it is not changed.
        given: number of numbers that each step is given.
    """

    def __init__(self, batch: Any, given: int) -> None:
        batch = deepcopy(batch)
        arrays = [owner[name] for owner, name in _array_places(batch)]
        self._rows = _consecutive([array.shape[:-1] for array in arrays])
        self._count = self._rows[-1].stop
        self._changed: set[int] = set()
        functions = [self._traced(batch, name, given) for name in ("tick", "step")]
        loop = _LOOP.format(GIVEN=LANES * (given + 1))
        module = llvm.parse_assembly("\n".join([_DECLARED, *functions, loop]))
        module.verify()
        self._engine = llvm.create_mcjit_compiler(module, _machine())
        self._engine.finalize_object()
        kinds = [ctypes.c_int64] * 2 + [ctypes.c_void_p] * 3
        self._call = ctypes.CFUNCTYPE(None, *kinds)(self._engine.get_function_address("run"))

    def _traced(self, batch: Any, function: str, given: int) -> str:
        """Returns the code of a method of the batch; notes what it changes and returns."""
        trace = Trace()
        traced = TracedArray.of_trace(trace)
        numbers = [
            np.array([trace.add("given", k)], object).view(traced) for k in range(1, given + 1)
        ]
        before = [trace.add("own", row) for row in range(self._count)]
        places = _array_places(batch)
        for (owner, name), rows in zip(places, self._rows, strict=True):
            shape = owner[name].shape[:-1]
            owner[name] = np.array(before[rows], object).reshape(*shape, 1).view(traced)
        kept = [_objects(one) for one in getattr(batch, function)(*numbers) or []]
        stored = {}
        for index, ((owner, name), rows) in enumerate(zip(places, self._rows, strict=True)):
            for row, new in enumerate(_objects(owner[name]).ravel(), rows.start):
                if new is not before[row]:
                    stored[row] = new
                    self._changed.add(index)
        self._kept = [one.shape[:-1] for one in kept]
        return _function(
            function, trace.operations, stored, [node for one in kept for node in one.ravel()]
        )

    def __call__(self, batch: Any, given: FloatArray, keep: bool) -> list[FloatArray]:
        """Steps the cars of a batch.

        Args:
            batch: batch with these shapes and constants.
            given: for each step, whether it begins with a tick, and its numbers (steps, 1 +
                numbers).
            keep: whether to keep what the steps returned.
        """
        places = _array_places(batch)
        arrays = [owner[name] for owner, name in places]
        numbers = np.concatenate(
            [array.reshape(-1, array.shape[-1]) for array in arrays], dtype=float
        )
        cars = numbers.shape[1]
        blocks = self._blocks(numbers)
        given = np.repeat(given[..., None], LANES, axis=-1)
        steps = len(given)
        parts = _consecutive(self._kept)
        width = parts[-1].stop if parts else 0
        kept = np.empty((len(blocks), steps if keep else 1, width, LANES))
        stride = LANES * width * keep  # what is not kept is written to one place
        for block, place in zip(blocks, kept, strict=True):
            self._call(steps, stride, given.ctypes.data, block.ctypes.data, place.ctypes.data)
        numbers = blocks.swapaxes(0, 1).reshape(self._count, -1)[:, :cars]
        for index in self._changed:
            owner, name = places[index]
            array = arrays[index]
            owner[name] = numbers[self._rows[index]].reshape(array.shape).astype(array.dtype)
        if not keep:
            return []
        kept = np.moveaxis(kept, 0, 2).reshape(steps, width, -1)[..., :cars]
        return [
            kept[:, part].reshape(steps, *shape, cars)
            for part, shape in zip(parts, self._kept, strict=True)
        ]

    def _blocks(self, numbers: FloatArray) -> FloatArray:
        """Returns rows (count, cars) as blocks of some cars (blocks, count, lanes), aligned; the
        last car fills the last block.
        """
        numbers = np.pad(numbers, ((0, 0), (0, -numbers.shape[1] % LANES)), mode="edge")
        memory = np.empty(numbers.size + LANES)
        first = -memory.ctypes.data // 8 % LANES
        blocks = memory[first : first + numbers.size].reshape(-1, self._count, LANES)
        blocks[:] = numbers.reshape(self._count, -1, LANES).swapaxes(0, 1)
        return blocks


def _array_places(batch: Any) -> list[tuple[dict[str, Any], str]]:
    """Returns where the arrays of a batch and of its parts are."""
    return [
        (owner, name) for owner, name in attributes(batch) if isinstance(owner[name], np.ndarray)
    ]


def _consecutive(shapes: Sequence[tuple[int, ...]]) -> list[slice]:
    """Returns the rows of arrays of these shapes that stand one behind the other."""
    rows = []
    start = 0
    for shape in shapes:
        rows.append(slice(start, start + math.prod(shape)))
        start = rows[-1].stop
    return rows


def _objects(values: Any) -> np.ndarray:
    return np.asarray(values, object).view(np.ndarray)


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
    """Returns LLVM assembly of a function of the rows of some cars, of numbers, and of a place for
    what is kept.

    Args:
        stored: results that replace rows, by row.
        kept: results that are kept.
    """
    needed = set()
    waiting = [one.index for one in (*stored.values(), *kept) if isinstance(one, Node)]
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
    if isinstance(operand, Node):
        return f"%v{operand.index}"
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
