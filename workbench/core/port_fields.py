"""The fields of a vector port, by name."""

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from aerodima.workbench.core.array_types import FloatArray, Texts


@dataclass(frozen=True)
class PortFields:
    """The fields of one vector port, in order.

    Args:
        name: CamelCase name of the views made from it.
        fields: one name per element of the port's vector.
    """

    name: str
    fields: Texts

    @cached_property
    def _tuple(self) -> Any:
        return namedtuple(self.name, self.fields)

    @property
    def size(self) -> int:
        """Count the elements of the port's vector."""
        return len(self.fields)

    def index(self, name: str) -> int:
        """Find the index of a field in the vector; ValueError for an unknown one."""
        return self.fields.index(name)

    def read(self, values: Sequence[float] | FloatArray) -> Any:
        """Read a vector (size,) as a named tuple of plain floats; TypeError for another length."""
        return self._tuple(
            *(values.tolist() if isinstance(values, np.ndarray) else map(float, values))
        )

    def zeros(self) -> FloatArray:
        """Make a vector (size,) of zeros."""
        return np.zeros(self.size)

    def write(self, **values: float) -> FloatArray:
        """Write a vector (size,) from one keyword per field; TypeError names a missing one."""
        return np.array(self._tuple(**values), dtype=float)
