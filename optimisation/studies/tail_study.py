"""What tail would be worth building: length, width, mass and C_N one at a time, and inertial tails of the same size."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from aerodima.optimisation.studies.grip_study import Setup, friction_study, read_friction
from aerodima.optimisation.studies.study_report import Findings
from aerodima.optimisation.sweep.study import Study

INERTIAL = (
    "tail.normal_force_coefficient=0.0",
    "tail.sail_length=0.05",
    "tail.sail_width=0.05",
    "tail.sail_mass_fraction=0.9",
)
"""An inertial tail: no air, nine tenths of its mass within 0.05 m of its tip."""


def _tail(*settings: str) -> Setup:
    return Setup("turn_swing", settings)


SETUPS: dict[str, Setup] = {
    "no tail": Setup("turn_none", reference=True),
    "tail held": Setup("turn_held", reference=True),
    "tail of models/parameters": Setup("turn_swing", reference=True),
    "length 0.7 m": _tail("tail.length=0.7"),
    "length 1.1 m": _tail("tail.length=1.1"),
    "width 0.1 m": _tail("tail.sail_width=0.1"),
    "width 0.3 m": _tail("tail.sail_width=0.3"),
    "mass 0.1 kg": _tail("tail.mass=0.1"),
    "mass 0.25 kg": _tail("tail.mass=0.25"),
    "C_N 1.2": _tail("tail.normal_force_coefficient=1.2"),
    "C_N 2.6": _tail("tail.normal_force_coefficient=2.6"),
    "inertial, same mass and length": _tail(*INERTIAL),
    "inertial, 0.4 kg": _tail(*INERTIAL, "tail.mass=0.4"),
}


def tail_study(settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None) -> Study:
    """Every tail at every friction."""
    return friction_study("Tail: what would be worth building", SETUPS, settings, ensemble, members)


def read_tail(frame: pd.DataFrame) -> Findings:
    """Critical friction of every tail."""
    sentences = (
        "One number differs at a time; tails that differ in two may do better than both.",
        "The inertial tails have the same length and the same controller as the others, not one made for them.",
    )
    return read_friction(frame, SETUPS, sentences)
