"""Ports of systems: their values, state that they show, and connections; systems that convert to
AutoDiffXd.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar, cast

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
    MatrixGain,
    Selector,
    SelectorParams,
)

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.port_fields import PortFields
from aerodima.workbench.core.system_lifetime import weak_callback

SystemT = TypeVar("SystemT", bound=System)
PortSlice = OutputPort | str | tuple[OutputPort, Sequence[int]]
"""Of what a port is made: another port, a named input of the diagram, or elements of a port."""


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
    system.DeclareAbstractOutputPort("spatial_forces", make, weak_callback(calc), inputs)


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


def add_and_connect(
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


def multiply(
    builder: DiagramBuilder, name: str, source: OutputPort, matrix: np.ndarray
) -> OutputPort:
    """A vector port (m): a matrix (m, n) times another one (n); adds one system of that name."""
    return add_and_connect(builder, MatrixGain(matrix), name, u0=source).get_output_port()


class PortMux:
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

    def route(self, target: InputPort | str | None, *parts: PortSlice) -> None:
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

    def add_to_builder(self, name: str = "mux") -> System:
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


def concatenate(builder: DiagramBuilder, name: str, parts: Sequence[PortSlice]) -> OutputPort:
    """A vector port with these one after the other; adds one system of that name."""
    mux = PortMux(builder)
    mux.route(None, *parts)
    return mux.add_to_builder(name).get_output_port()


def constant(builder: DiagramBuilder, name: str, value: ArrayLike) -> OutputPort:
    """A vector port that never changes; adds one system of that name."""
    return builder.AddNamedSystem(
        name, ConstantVectorSource(np.array(value, dtype=float))
    ).get_output_port()
