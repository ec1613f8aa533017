"""Places of the arrays of a batch."""

from collections.abc import Iterator
from typing import Any

import numpy as np


def attributes(batch: Any, known: set[int] | None = None) -> Iterator[tuple[dict[str, Any], str]]:
    """Yields where the arrays and constants of an object are, and those of its parts, each part
    once.
    """
    known = set() if known is None else known
    if id(batch) in known:
        return
    known.add(id(batch))
    for name, value in vars(batch).items():
        if hasattr(value, "__dict__") and not isinstance(value, np.ndarray) and not callable(value):
            yield from attributes(value, known)
        else:
            yield vars(batch), name
