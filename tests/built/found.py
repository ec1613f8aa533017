"""Everything that a row of `models/published/statements.yaml` can name."""

import tests.built.car
import tests.built.printed
import tests.built.strings
import tests.built.swings
import tests.built.trends
import tests.built.turns  # noqa: F401  # each module registers what it finds
from tests.built.registry import CHECKS, RUNS, SLOW

__all__ = ["CHECKS", "RUNS", "SLOW"]
