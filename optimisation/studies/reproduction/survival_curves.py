"""Survival of an ensemble over speed without tail, with it held and swung: what a new plant or calibration changes."""

from itertools import product

import numpy as np
import pandas as pd

from aerodima.optimisation.calibration.calibration_runs import flips_in_the_turn, survives
from aerodima.optimisation.studies.reproduction.evidence import Evidence
from aerodima.workbench.figures.figure_style import MODE_STYLES
from aerodima.workbench.report.report_page import Finding, Part, Section, Table

MODES = ("none", "held", "swing")
SPEEDS = (3.33, 3.61, 4.0, 4.44, 4.72, 5.28, 6.1)
"""m/s: both published brackets, steps between and beyond, and the fastest run of the real car."""
PAIRS = tuple(product(MODES, SPEEDS))


def survival_table(evidence: Evidence) -> pd.DataFrame:
    """One row per tail mode and speed: shares of the weight, and how many members tipped over before their turn."""
    weights = evidence.weights
    found = []
    for mode, speed in PAIRS:
        rows = evidence.rows[mode, speed]
        tipped = ~survives(rows) & ~flips_in_the_turn(rows)
        found.append(
            {
                "tail": mode,
                "speed_m_per_s": speed,
                "members": len(rows),
                "survived": evidence.survived(mode, speed),
                "clean": float(weights @ np.asarray(rows["clean"] == True, bool)),  # noqa: E712  # None where it failed
                "flipped_in_turn": evidence.flipped(mode, speed),
                "tipped_before_turn": evidence.tipped(mode, speed),
                "members_tipped_before_turn": int(np.count_nonzero(tipped)),
            }
        )
    return pd.DataFrame(found)


def survival_section(found: pd.DataFrame) -> Section:
    """The table as a part of the page: survived share, clean share in brackets."""
    said = [f"{row['survived']:.0%} ({row['clean']:.0%})" for row in found.to_dict("records")]
    cells = [
        (MODE_STYLES[mode].words, *said[place * len(SPEEDS) : (place + 1) * len(SPEEDS)])
        for place, mode in enumerate(MODES)
    ]
    worst = int(found["members_tipped_before_turn"].max())
    parts: list[Part] = [
        Finding([f"At most {worst} of {found['members'].max()} members tip over before their turn."]),
        Table(("", *(f"{speed:g} m/s" for speed in SPEEDS)), cells),
        "Share of the weight that survives; in brackets, with nothing but wheels on the ground.",
    ]
    return Section("Survival over speed", parts)
