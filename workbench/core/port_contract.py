"""Ports that a station must have."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    InputPort,
    LeafSystem,
    OutputPort,
    System,
)

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_fields import PortFields
from aerodima.workbench.core.port_wiring import add_and_connect, vector_of
from aerodima.workbench.core.system_lifetime import weak_callback


class StationStatus(LeafSystem):
    """The port `status` of a simulated station: armed, ages, fault codes, and 0 elsewhere.

    Input ports:
        <field> (1): of each of `sources` its value, of each of `samples` the instant, s, since
            which the field is the time.
    Output ports:
        status: the fields.

    Args:
        fields: of the port.
        sources: fields that have the value of a port.
        samples: fields that are the time since an instant, s.
        healthy: fields that are 0.
        faults: fault codes that never change.

    Raises:
        ValueError: a field of the port is in none of these, or in two; names it.
    """

    def __init__(
        self,
        fields: PortFields,
        sources: Collection[str],
        samples: Collection[str],
        healthy: Collection[str],
        faults: Mapping[str, float],
    ) -> None:
        super().__init__()
        self.set_name("status")
        constants = {"armed": 1.0, **faults}
        known = [*constants, *sources, *samples, *healthy]
        names = {*fields.fields, *known}
        wrong = [name for name in names if known.count(name) != 1 or name not in fields.fields]
        if wrong:
            raise ValueError(
                f"status: {', '.join(sorted(wrong))}; needed once each: {', '.join(fields.fields)}"
            )
        self._constants = np.zeros(fields.size)
        for name, value in constants.items():
            self._constants[fields.index(name)] = value
        self._sources = self._declare(fields, sources)
        self._samples = self._declare(fields, samples)
        tickets = {self.time_ticket(), self.all_input_ports_ticket()}
        self.DeclareVectorOutputPort("status", fields.size, weak_callback(self._calc), tickets)

    def _declare(self, fields: PortFields, names: Collection[str]) -> list[tuple[int, InputPort]]:
        """Declares an input port for each field; returns the fields' indices with their ports."""
        return [(fields.index(name), self.DeclareVectorInputPort(name, 1)) for name in names]

    def _calc(self, context: Context, output: BasicVector) -> None:
        values = self._constants.copy()
        for index, port in self._sources:
            values[index] = vector_of(port, context)[0]
        for index, port in self._samples:
            values[index] = context.get_time() - vector_of(port, context)[0]
        output.SetFromVector(values)


def add_status(
    builder: DiagramBuilder,
    fields: PortFields,
    sources: Mapping[str, OutputPort],
    healthy: Collection[str],
    *,
    samples: Mapping[str, OutputPort] | None = None,
    faults: Mapping[str, float] | None = None,
) -> OutputPort:
    """Adds a `StationStatus` with these ports for its fields; returns its port.

    Raises:
        ValueError: a field of the port is in none of these, or in two; names it.
    """
    samples = samples or {}
    status = StationStatus(fields, sources, samples, healthy, faults or {})
    return add_and_connect(builder, status, **sources, **samples).get_output_port()


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
    """Adds a hardware interface and exports its ports.

    Raises:
        UserError: names or sizes are not those of the contract.
    """
    require_ports(system, inputs, outputs)
    builder.AddSystem(system)
    for name in inputs:
        builder.ExportInput(system.GetInputPort(name), name)
    export_outputs(builder, {name: system.GetOutputPort(name) for name in outputs})


def require_ports(
    system: System,
    inputs: Mapping[str, PortFields],
    outputs: Mapping[str, PortFields],
    besides: tuple[str, ...] = (),
) -> None:
    """Raises UserError unless the ports have names and sizes of the contract.

    Args:
        besides: endings of names that are free.
    """
    inputs_of_system = [system.get_input_port(index) for index in range(system.num_input_ports())]
    outputs_of_system = [
        system.get_output_port(index) for index in range(system.num_output_ports())
    ]
    for kind, ports, contract in (
        ("inputs", inputs_of_system, inputs),
        ("outputs", outputs_of_system, outputs),
    ):
        sizes = {
            port.get_name(): port.size() for port in ports if not port.get_name().endswith(besides)
        }
        allowed = {name: fields.size for name, fields in contract.items()}
        if sizes != allowed:
            raise UserError(
                f"interface of {system.get_name()!r}: {kind} {_sizes(sizes)}; must be "
                f"{_sizes(allowed)}"
            )


def _sizes(ports: dict[str, int]) -> str:
    return ", ".join(f"{name} ({size})" for name, size in sorted(ports.items())) or "none"
