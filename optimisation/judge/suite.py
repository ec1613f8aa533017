"""The suite of manoeuvres, tails and candidates by name, from `models/entry/suite.yaml`.

Candidates are never mixed with another tail's.
"""

from collections.abc import Sequence
from dataclasses import replace

from pydantic import Field

from aerodima.optimisation.judge.candidate import (
    HELD,
    LOW_BALLAST,
    NO_TAIL,
    THESIS,
    Candidate,
    ListedCandidate,
    read_candidates,
    require_unique,
    user_law,
)
from aerodima.optimisation.judge.entry_speed import Case, Manoeuvre, Surface
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.ranges import check_range
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import load_scenario

SCHEMA = "aerodima/entry-suite/1"
FRICTION_SCALES = (0.2, 2.0)
"""Lowest and highest friction of a surface over that of the car."""


class SuiteFile(StrictModel):
    """The suite as its file has it; the file says what each entry means."""

    schema_: str = Field(alias="schema")
    manoeuvres: dict[str, Manoeuvre]
    training: tuple[str, ...]
    comparison: tuple[str, ...]
    tails: dict[str, str]
    mount_keys: tuple[str, ...]
    candidates: dict[str, ListedCandidate]
    default: tuple[str, ...]


_PATH = model_path("entry/suite.yaml")
_SUITE = checked(SuiteFile, read_yaml(_PATH), str(_PATH), SweepError, schema=SCHEMA)
MANOEUVRES = _SUITE.manoeuvres
"""Name that asks for one -> manoeuvre."""
TRAINING_MANOEUVRES = _SUITE.training
"""Names of manoeuvres that a search of a law sees."""
COMPARISON_SETTINGS = _SUITE.comparison
"""Settings of every run of a comparison."""
TAILS = _SUITE.tails
"""Name of a tail -> scenario that it is taken from; empty for that of each car."""
MOUNT_KEYS = _SUITE.mount_keys
"""Numbers of a tail that stay those of the manoeuvre and the car."""
NAMED_CANDIDATES = {
    "none": NO_TAIL,
    "low-ballast": LOW_BALLAST,
    "held": HELD,
    "published": THESIS,
    **{name: one.candidate() for name, one in _SUITE.candidates.items()},
}
"""Name that asks for one -> candidate."""
CANDIDATES = {name: NAMED_CANDIDATES[name] for name in _SUITE.default}
"""Those that are taken unless others are asked for."""
FEEDBACK = NAMED_CANDIDATES["feedback"]


def select_manoeuvres(names: Sequence[str], tail: str) -> list[Manoeuvre]:
    """Returns manoeuvres by name with one of the `TAILS`.

    Raises:
        SweepError: no such manoeuvre or tail; one named twice.
    """
    if tail not in TAILS:
        raise SweepError(f"tail {tail!r}: {nearest(tail, list(TAILS))}")
    for name in names:
        if name not in MANOEUVRES:
            raise SweepError(f"manoeuvre {name!r}: {nearest(name, list(MANOEUVRES))}")
    require_unique(names, "manoeuvre")
    common = list(COMPARISON_SETTINGS)
    source = TAILS[tail]
    if source:
        for key, value in load_scenario(source).tail:
            if key not in MOUNT_KEYS:
                common.append(f"tail.{key}={value}")
    chosen = [MANOEUVRES[name] for name in names]
    return [replace(one, settings=(*one.settings, *common)) for one in chosen]


def select_candidates(names: Sequence[str], laws: Sequence[str] = ()) -> list[Candidate]:
    """Returns candidates of `read_candidates` and `user_law`; the car without tail comes first."""
    scenario = MANOEUVRES["turn"].scenario
    chosen = read_candidates(names, NAMED_CANDIDATES, scenario)
    chosen += [user_law(path, scenario) for path in laws]
    require_unique([one.name for one in chosen], "candidate")
    return chosen


def make_surfaces(cars: Sequence[Member], friction_scales: Sequence[float]) -> list[Case]:
    """Pairs cars with surfaces whose friction is a multiple of the car's own.

    Raises:
        SweepError: a friction scale out of range, or one that is named twice.
    """
    require_unique([f"{scale:g}" for scale in friction_scales], "floor")
    cases = []
    for scale in friction_scales:
        check_range("floor", scale, *FRICTION_SCALES, "of the car's friction", error=SweepError)
        for car in cars:
            own = load_scenario("turn_none", car.settings_on("turn_none")).car.tyre_friction
            setting = f"car.tyre_friction={scale * own:.6g}"
            cases.append((car, Surface(f"x {scale:g}", (setting,))))
    return cases
