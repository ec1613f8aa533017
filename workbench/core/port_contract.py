"""Ports that a station must have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from pydrake.systems.framework import (
    DiagramBuilder,
    OutputPort,
    System,
)
from pydrake.systems.primitives import (
    TrajectorySource,
)
from pydrake.trajectories import PiecewisePolynomial

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_fields import PortFields
from aerodima.workbench.core.port_wiring import concatenate, multiply

_LONG = 1e9
"""Time until which the clock of `add_status` runs, s."""


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
    inputs = concatenate(builder, "status_inputs", [clock, *ports.values()])
    return multiply(builder, "status", inputs, gains)


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
