"""Ports that a station must have."""

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import AffineSystem, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from aerodima.workbench.core.array_types import Texts, Values
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.port_fields import PortFields
from aerodima.workbench.core.port_wiring import add_and_connect, concatenate

Contract = Mapping[str, PortFields]
"""Fields of every port, by its name."""
LAST_TIME = 1e9
"""Time up to which the clock of a simulated station runs, s."""


def add_status(
    builder: DiagramBuilder,
    fields: PortFields,
    samples: Mapping[str, OutputPort],
    faults: Values | None = None,
) -> OutputPort:
    """Adds the port `status` of a simulated station: armed, ages, fault codes, and 0 elsewhere.

    Its three systems, `clock`, `status_times` and `status`, work in C++.

    Args:
        builder: diagram builder of the station.
        fields: fields of the port `status`.
        samples: names of the fields that hold the time since an instant, with the port (1) of that
            instant, s.
        faults: values of the fault codes, which never change, by field name.
    """
    constants = {"armed": 1.0, **(faults or {})}
    clock = TrajectorySource(
        PiecewisePolynomial.FirstOrderHold([0.0, LAST_TIME], [[0.0, LAST_TIME]])
    )
    times = [builder.AddNamedSystem("clock", clock).get_output_port(), *samples.values()]
    gains = np.zeros((len(fields.fields), len(times)))
    for column, name in enumerate(samples, 1):
        gains[fields.fields.index(name), [0, column]] = 1.0, -1.0
    values = np.array([constants.get(name, 0.0) for name in fields.fields])
    return add_and_connect(
        builder,
        AffineSystem(D=gains, y0=values),
        "status",
        u0=concatenate(builder, "status_times", times),
    ).get_output_port()


def export_outputs(builder: DiagramBuilder, ports: Mapping[str, OutputPort]) -> None:
    """Exports ports under these names."""
    for name, port in ports.items():
        builder.ExportOutput(port, name)


def export_interface(
    builder: DiagramBuilder,
    system: System,
    inputs: Contract,
    outputs: Contract,
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
    inputs: Contract,
    outputs: Contract,
    besides: Texts = (),
) -> None:
    """Raises UserError unless the ports have the names and sizes of the contract.

    Args:
        besides: endings of the names of ports that are not checked.
    """
    for kind, port_of, count, contract in (
        ("inputs", system.get_input_port, system.num_input_ports(), inputs),
        ("outputs", system.get_output_port, system.num_output_ports(), outputs),
    ):
        ports = [port_of(index) for index in range(count)]
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
