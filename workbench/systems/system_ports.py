"""Ports of systems: their values, state that they show, and connections; systems that convert to
AutoDiffXd.
"""

from __future__ import annotations

import math
import sys
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, TypeVar, cast

import numpy as np
import pydrake.systems.framework
from numpy.typing import ArrayLike
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    DiscreteValues,
    InputPort,
    LeafSystem,
    OutputPort,
    System,
)
from pydrake.systems.primitives import (
    ConstantVectorSource,
    MatrixGain,
    Selector,
    SelectorParams,
    TrajectorySource,
)
from pydrake.systems.scalar_conversion import TemplateSystem
from pydrake.trajectories import PiecewisePolynomial

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.signal_table import PortFields
from aerodima.workbench.errors import UserError

LeafSystem_: Any = vars(pydrake.systems.framework)["LeafSystem_"]
"""Drake's template of leaf systems."""
SystemT = TypeVar("SystemT", bound=System)
Part = OutputPort | str | tuple[OutputPort, Sequence[int]]
"""Of what a port is made: another port, a named input of the diagram, or elements of a port."""
_LONG = 1e9
"""Time until which the clock of `add_status` runs, s."""
LEAD = 1e-9
"""Share of the time by which one stage comes before the next."""


def system_template(name: str, module: str) -> Callable[[Callable[[Any], Any]], Any]:
    """Decorator of a function f(T) that returns a system class, for T = float and AutoDiffXd (see
    `TemplateSystem`).

    Args:
        name: of the template.
        module: `__name__` of the caller. To find it by itself Drake reads the source of the whole
            call stack, which takes seconds where imports are nested deeply.
    """
    decorator: Callable[[Callable[[Any], Any]], Any] = TemplateSystem.define(  # type: ignore[no-untyped-call]
        name, T_list=[float, AutoDiffXd], scope=sys.modules[module]
    )
    return decorator


def weakly(calc: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """A bound method as the function of an output port that does not keep its system, and the whole
    diagram, for ever.

    A port lives as long as its system. Drake 1.51 keeps the functions of all ports, 1.58 those of
    abstract ones.
    """
    method: Any = weakref.WeakMethod(calc)
    return lambda context, output: method()(context, output)


@contextmanager
def released(builder: DiagramBuilder) -> Iterator[None]:
    """Lets a diagram go from memory, which nothing may use afterwards.

    The cycles between the builder, its systems and their ports are those that Python cannot collect
    up to Drake 1.51.
    """
    try:
        yield
    finally:
        waiting: list[Any] = [builder]
        while waiting:
            waiting += getattr(waiting.pop(), "__dict__", {}).pop(
                "_pydrake_internal_ref_cycle_peers", ()
            )


def declare_spatial_forces(
    system: Any, calc: Callable[[Any, Any], None], inputs: set[Any], T: Any = float
) -> None:
    """Declares the output port `spatial_forces`, a list[ExternallyAppliedSpatialForce].

    Args:
        system: whose method `calc` is.
        calc: called with a context and the value to be set.
        inputs: tickets of what the value depends on.
        T: scalar type.
    """
    make = Value[list[ExternallyAppliedSpatialForce_[T]]]
    system.DeclareAbstractOutputPort("spatial_forces", make, weakly(calc), inputs)


def vector_of(port: InputPort | OutputPort, context: Context) -> FloatArray:
    """Value (n,) of a vector port; of an input port an array that is not to be changed."""
    return cast(FloatArray, port.Eval(context))


class DiscreteVector:
    """Declares a group of discrete state in a system, and reads and writes it.

    Args:
        system: the system under construction.
        initial: values (n,) of a default context.
        output: name of an output port (n) that shows the group; it costs no Python when it is
            evaluated.
    """

    def __init__(
        self, system: LeafSystem, initial: Sequence[float] | np.ndarray, output: str | None = None
    ) -> None:
        values: Any = np.array(initial, dtype=float)
        index = system.DeclareDiscreteState(values)
        if output is not None:
            system.DeclareStateOutputPort(output, index)
        self.ticket = system.discrete_state_ticket(index)
        self._index = int(index)

    def read(self, context: Context) -> np.ndarray:
        """Values (n,); a view that is not to be changed."""
        values: Any = context.get_discrete_state(self._index).value()
        return values

    def write(self, discrete_state: DiscreteValues, values: Sequence[float] | np.ndarray) -> None:
        """Sets the values (n,) within a discrete update."""
        new: Any = values
        discrete_state.set_value(self._index, new)


def connected(
    builder: DiagramBuilder, system: SystemT, name: str = "", /, **inputs: OutputPort
) -> SystemT:
    """Adds a system, of this name if one is given, and connects its input ports by their names; the
    system.
    """
    if name:
        system.set_name(name)
    builder.AddSystem(system)
    for port, source in inputs.items():
        builder.Connect(source, system.GetInputPort(port))
    return system


def transformed(
    builder: DiagramBuilder, name: str, source: OutputPort, matrix: np.ndarray
) -> OutputPort:
    """A vector port (m): a matrix (m, n) times another one (n); adds one system of that name."""
    return connected(builder, MatrixGain(matrix), name, u0=source).get_output_port()


class Wires:
    """Ports that are made of elements of others, all by one `Selector`: each system has its share
    in every instant.

    Args:
        builder: in which the ports are.
        inputs: ports that the diagram shall have by names.
    """

    def __init__(
        self, builder: DiagramBuilder, inputs: Mapping[str, PortFields] | None = None
    ) -> None:
        self._builder = builder
        self._sources: list[OutputPort | str] = list(inputs or {})
        self._sizes = [fields.size for fields in (inputs or {}).values()]
        self._targets: list[tuple[InputPort | str | None, list[Any]]] = []

    def feed(self, target: InputPort | str | None, *parts: Part) -> None:
        """Makes an input port, or a port that the diagram shall have by this name, of these one
        after the other.
        """
        selections = []
        for part in parts:
            source, indices = part if isinstance(part, tuple) else (part, None)
            if not isinstance(source, str) and source not in self._sources:
                self._sources.append(source)
                self._sizes.append(source.size())
            place = self._sources.index(source)
            if indices is None:
                indices = range(self._sizes[place])
            for index in indices:
                selections.append(
                    SelectorParams.OutputSelection(input_port_index=place, input_offset=index)
                )
        self._targets.append((target, selections))

    def add_to_builder(self, name: str = "wires") -> System:
        """Adds the named system with all connections; output ports fed to None have none."""
        sizes = [SelectorParams.InputPortParams(size=size) for size in self._sizes]
        outputs = [
            SelectorParams.OutputPortParams(selections=selections)
            for _, selections in self._targets
        ]
        system = self._builder.AddNamedSystem(
            name, Selector(SelectorParams(inputs=sizes, outputs=outputs))
        )
        for index, source in enumerate(self._sources):
            port = system.get_input_port(index)
            if isinstance(source, str):
                self._builder.ExportInput(port, source)
            else:
                self._builder.Connect(source, port)
        for index, (target, _) in enumerate(self._targets):
            made = system.get_output_port(index)
            if isinstance(target, str):
                self._builder.ExportOutput(made, target)
            elif target is not None:
                self._builder.Connect(made, target)
        return system


def stacked(builder: DiagramBuilder, name: str, parts: Sequence[Part]) -> OutputPort:
    """A vector port with these one after the other; adds one system of that name."""
    wires = Wires(builder)
    wires.feed(None, *parts)
    return wires.add_to_builder(name).get_output_port()


def constant(builder: DiagramBuilder, name: str, value: ArrayLike) -> OutputPort:
    """A vector port that never changes; adds one system of that name."""
    return builder.AddNamedSystem(
        name, ConstantVectorSource(np.array(value, dtype=float))
    ).get_output_port()


def add_status(
    builder: DiagramBuilder,
    fields: PortFields,
    sources: Mapping[str, OutputPort],
    healthy: Sequence[str],
    *,
    samples: Mapping[str, OutputPort] | None = None,
    faults: Mapping[str, float] | None = None,
) -> OutputPort:
    """The port `status` of a simulated station, computed in C++: armed, what follows, and 0 for the
    `healthy` fields.

    Args:
        sources: ports (1) with the value of a field.
        samples: fields that are the time since an instant, s, each with the port (1) of that
            instant, s.
        faults: fault codes that never change.

    Raises:
        ValueError: a field of the port is in none of these, or in two; names it.
    """
    samples = samples or {}
    faults = {"armed": 1.0, **(faults or {})}
    known = [*faults, *sources, *samples, *healthy]
    wrong = [
        name
        for name in {*fields.fields, *known}
        if known.count(name) != 1 or name not in fields.fields
    ]
    if wrong:
        raise ValueError(
            f"status: {', '.join(sorted(wrong))}; needed once each: {', '.join(fields.fields)}"
        )
    ports = {**sources, **samples}
    gains = np.zeros((fields.size, 2 + len(ports)))  # of one, time, and the ports
    for name, level in faults.items():
        gains[fields.index(name), 0] = level
    for place, name in enumerate(ports, start=2):
        gains[fields.index(name), place] = -1.0 if name in samples else 1.0
        gains[fields.index(name), 1] = float(name in samples)
    line = PiecewisePolynomial.FirstOrderHold([0.0, _LONG], [[1.0, 1.0], [0.0, _LONG]])
    clock = builder.AddNamedSystem("status_clock", TrajectorySource(line)).get_output_port()
    inputs = stacked(builder, "status_inputs", [clock, *ports.values()])
    return transformed(builder, "status", inputs, gains)


def export_outputs(builder: DiagramBuilder, ports: Mapping[str, OutputPort]) -> None:
    """Exports ports under these names."""
    for name, port in ports.items():
        builder.ExportOutput(port, name)


def export_interface(
    builder: DiagramBuilder,
    system: System,
    inputs: Mapping[str, PortFields],
    outputs: Mapping[str, PortFields],
) -> None:
    """Adds a hardware interface and exports its ports; UserError unless names and sizes are those
    of the contract.
    """
    refuse_other_ports(system, inputs, outputs)
    builder.AddSystem(system)
    for name in inputs:
        builder.ExportInput(system.GetInputPort(name), name)
    export_outputs(builder, {name: system.GetOutputPort(name) for name in outputs})


def refuse_other_ports(
    system: System,
    inputs: Mapping[str, PortFields],
    outputs: Mapping[str, PortFields],
    besides: tuple[str, ...] = (),
) -> None:
    """Raises UserError unless the ports have names and sizes of the contract; names that end in
    `besides` are free.
    """
    found_inputs = [system.get_input_port(index) for index in range(system.num_input_ports())]
    found_outputs = [system.get_output_port(index) for index in range(system.num_output_ports())]
    for kind, found, contract in (
        ("inputs", found_inputs, inputs),
        ("outputs", found_outputs, outputs),
    ):
        sizes = {
            port.get_name(): port.size() for port in found if not port.get_name().endswith(besides)
        }
        allowed = {name: fields.size for name, fields in contract.items()}
        if sizes != allowed:
            raise UserError(
                f"interface of {system.get_name()!r}: {kind} {_sizes(sizes)}; allowed: "
                f"{_sizes(allowed)}"
            )


def _sizes(ports: dict[str, int]) -> str:
    return ", ".join(f"{name} ({size})" for name, size in sorted(ports.items())) or "none"


class Stage(IntEnum):
    """Who acts at one instant before the plant steps; the larger, the earlier.

    The controller does not come after the driver: it sees what the driver did one tick before, as
    on the car, where both read first and write afterwards. At one rate both act in the controller's
    stage: Drake computes all discrete updates of an instant from the state before it.
    """

    WIND = 5
    SENSOR = 4
    CONTROLLER = 3
    DRIVER = 2
    RECORD = 1


def period_of(rate: float, stage: Stage) -> float:
    """Period (s) to declare in Drake for a part of `stage` that acts `rate` times per second before
    the plant steps.
    """
    return (1.0 - stage * LEAD) / rate


def row_period(rate: float, step: float) -> float:
    """Period (s) of rows, `rate` Hz, that show a discrete plant before its step of `step` s.

    Drake publishes before it updates. With a row every 1, 2, 4 ... steps, whose multiples have the
    same bits, both have one instant: another one costs a second look for the next event, and what
    drives the plant is calculated twice.
    """
    steps = round(1.0 / (rate * step))
    shared = math.isclose(steps * rate * step, 1.0) and steps.bit_count() == 1
    if shared:
        return steps * step
    return period_of(rate, Stage.RECORD)


def nominal_time(time: float, rate: float) -> float:
    """The instant k / rate that an event at `time` s stands for, s."""
    return round(time * rate) / rate


def step_instant(time: float, step: float) -> float | None:
    """The instant (s) of the plant's step at `time`, with the bits that Drake computes; None
    between two steps.

    What publishes at the same bits shows what a row of `Stage.RECORD` would: the plant before its
    step.
    """
    instant = round(time / step) * step
    return instant if math.isclose(instant, time, rel_tol=LEAD) else None


def declare_ticks(
    system: LeafSystem,
    rate: float,
    stage: Stage | None,
    update: Callable[[Context, DiscreteValues], Any],
) -> None:
    """Declares a discrete update at 0, 1/rate, 2/rate ... s.

    Args:
        system: under construction.
        rate: Hz.
        stage: before the step of a discrete plant; None where no plant steps.
        update: called with the context and the discrete values to be set.
    """
    if stage is None:
        system.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, update)
        return
    period = period_of(rate, stage)
    system.DeclareInitializationDiscreteUpdateEvent(update)
    system.DeclarePeriodicDiscreteUpdateEvent(period, period, update)


def stage_before(station: System, stage: Stage) -> Stage | None:
    """The stage of a part beside this station; None beside one that has no plant to come before,
    that of the car.
    """
    return stage if isinstance(station, Diagram) and station.HasSubsystemNamed("plant") else None
