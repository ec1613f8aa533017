"""Connections between ports of a diagram."""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import MatrixGain


def select(builder: DiagramBuilder, name: str, source: OutputPort, indices: Sequence[int]) -> OutputPort:
    """A vector port (len(indices)) with these elements of another one; adds one system of that name."""
    matrix = np.zeros((len(indices), source.size()))
    matrix[np.arange(len(indices)), list(indices)] = 1.0
    system = builder.AddNamedSystem(name, MatrixGain(matrix))
    builder.Connect(source, system.get_input_port())
    return system.get_output_port()
