"""Ports of systems: declaration, values, the state that they show, and connections."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    DiscreteValues,
    InputPort,
    LeafSystem,
    OutputPort,
    System,
)
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Selector,
    SelectorParams,
)

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.system_lifetime import weak_callback

SystemT = TypeVar("SystemT", bound=System)
PortSlice = OutputPort | tuple[OutputPort, Sequence[int]]
"""Part of a composed port: a whole other port, or a port with the indices of its elements."""


def declare_spatial_forces(system: Any, calc: Callable[[Any, Any], None], T: Any = float) -> None:
    """Declares the output port `spatial_forces`, a list[ExternallyAppliedSpatialForce].

    The port depends on the input ports alone.

    Args:
        system: system under construction.
        calc: method of the system that is called with a context and the value to be set.
        T: scalar type of the system.
    """
    make = Value[list[ExternallyAppliedSpatialForce_[T]]]
    tickets = {system.all_input_ports_ticket()}
    system.DeclareAbstractOutputPort("spatial_forces", make, weak_callback(calc), tickets)


def declare_output(
    system: Any, name: str, size: int, calc: Callable[[Any, Any], None], *, timed: bool = False
) -> None:
    """Declares a vector output port that depends on the input ports alone, or on the time too.

    Args:
        system: system under construction.
        name: name of the port.
        size: size of the port's vector.
        calc: method of the system that is called with a context and the vector to be set.
        timed: whether the port depends on the time too.
    """
    tickets = {system.all_input_ports_ticket()}
    if timed:
        tickets.add(system.time_ticket())
    system.DeclareVectorOutputPort(name, size, weak_callback(calc), tickets)


def vector_of(port: InputPort | OutputPort, context: Context) -> FloatArray:
    """Returns the value (n,) of a vector port; the array of an input port must not be changed."""
    value: Any = port.Eval(context)
    return value


class DiscreteVector:
    """Declares a group of discrete state in a system, and reads and writes it.

    Args:
        system: system under construction.
        initial: values (n,) in a default context.
        output: name of an output port (n) that shows the group; no Python runs when the port is
            evaluated.
    """

    def __init__(
        self, system: LeafSystem, initial: Sequence[float] | FloatArray, output: str | None = None
    ) -> None:
        values: Any = np.array(initial, dtype=float)
        index = system.DeclareDiscreteState(values)
        if output is not None:
            system.DeclareStateOutputPort(output, index)
        self._index = int(index)

    def read(self, context: Context) -> FloatArray:
        """Returns the values (n,) as a view that must not be changed."""
        values: Any = context.get_discrete_state(self._index).value()
        return values

    def write(self, discrete_state: DiscreteValues, values: Sequence[float] | FloatArray) -> None:
        """Sets the values (n,) within a discrete update."""
        new: Any = values
        discrete_state.set_value(self._index, new)


def add_and_connect(
    builder: DiagramBuilder, system: SystemT, name: str = "", /, **inputs: OutputPort
) -> SystemT:
    """Adds a system, under this name if one is given, and connects its input ports by their names;
    returns the system.
    """
    if name:
        system.set_name(name)
    builder.AddSystem(system)
    for port, source in inputs.items():
        builder.Connect(source, system.GetInputPort(port))
    return system


def add_selector(
    builder: DiagramBuilder, name: str, outputs: Mapping[str, Sequence[PortSlice]]
) -> System:
    """Adds one `Selector` whose named output ports are made of elements of other ports.

    It works in C++. An output depends on the ports of its own elements only.

    Args:
        builder: diagram builder that holds the other ports.
        name: name of the new system.
        outputs: parts of each output port, by its name, joined in this order.
    """
    sources: list[OutputPort] = []
    ports = []
    for port, parts in outputs.items():
        selections = []
        for part in parts:
            source, indices = part if isinstance(part, tuple) else (part, range(part.size()))
            if source not in sources:
                sources.append(source)
            index = sources.index(source)
            selections += [
                SelectorParams.OutputSelection(input_port_index=index, input_offset=offset)
                for offset in indices
            ]
        ports.append(SelectorParams.OutputPortParams(name=port, selections=selections))
    inputs = [SelectorParams.InputPortParams(size=source.size()) for source in sources]
    system = builder.AddNamedSystem(name, Selector(SelectorParams(inputs=inputs, outputs=ports)))
    for index, source in enumerate(sources):
        builder.Connect(source, system.get_input_port(index))
    return system


def concatenate(builder: DiagramBuilder, name: str, parts: Sequence[PortSlice]) -> OutputPort:
    """Adds one system of this name; returns its vector port, which joins the parts in order."""
    return add_selector(builder, name, {name: parts}).get_output_port()


def constant(builder: DiagramBuilder, name: str, value: ArrayLike) -> OutputPort:
    """Adds one system of this name; returns its vector port, which never changes."""
    return builder.AddNamedSystem(
        name, ConstantVectorSource(np.array(value, dtype=float))
    ).get_output_port()
