"""One group of a system's discrete state, by name instead of by index."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem


class DiscreteVector:
    """Declares a group of discrete state in a system, and reads and writes it.

    Args:
        system: the system under construction.
        initial: values (n,) of a default context.
        output: name of an output port (n) that shows the group; it costs no Python when it is evaluated.
    """

    def __init__(self, system: LeafSystem, initial: Sequence[float] | np.ndarray, output: str | None = None) -> None:
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
