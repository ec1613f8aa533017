"""What the corner study comes to: tables of cases, laws and disturbed runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from aerodima.optimisation.studies.candidates import Candidate
from aerodima.optimisation.studies.disturbed_turns import summarise_disturbed


@dataclass(frozen=True)
class Corner:
    """What was measured.

    Attributes:
        cases: a row per pulse, floor and candidate.
        laws: what the finalists of each family, and the published law, came to on the training cars; empty without.
        candidates: in order.
        without_floor: cars and speeds that have no floor, since the published swing at full lock is clean on none.
        disturbed: a row per disturbed run; empty without.
    """

    cases: pd.DataFrame
    laws: pd.DataFrame
    candidates: tuple[Candidate, ...]
    without_floor: tuple[str, ...]
    disturbed: pd.DataFrame

    @cached_property
    def survival(self) -> pd.DataFrame:
        """Summary of the disturbed runs, a row per candidate."""
        return summarise_disturbed(self.disturbed, self.candidates)
