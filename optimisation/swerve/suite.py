"""Tails, candidates and cases of a comparison by name, from `models/swerve/suite.yaml`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from aerodima.optimisation.swerve.candidate import (
    LOW_BALLAST,
    NO_TAIL,
    SWERVE,
    Candidate,
    ListedCandidate,
    read_candidates,
    user_law,
)
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.core.key_errors import nearest, require_unique
from aerodima.workbench.core.ranges import check_range
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml
from aerodima.workbench.scenario.ensemble import Member, load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario

SCHEMA = "aerodima/swerve-suite/1"
FRICTION_SCALES = (0.2, 2.0)
"""Lowest and highest friction of a floor, as a multiple of the car's."""


class SuiteFile(StrictModel):
    """Content of the suite's file, which says what each entry means."""

    schema_: str = Field(alias="schema")
    comparison: Settings
    tails: dict[str, str]
    mount_keys: tuple[str, ...]
    candidates: dict[str, ListedCandidate]
    default: tuple[str, ...]
    speeds: tuple[float, ...]
    trained: dict[str, tuple[float, float, float]]
    conditions: tuple[tuple[float, float, float], ...]


_PATH = model_path("swerve/suite.yaml")
SUITE = checked(SuiteFile, read_yaml(_PATH), str(_PATH), SweepError, schema=SCHEMA)
BOUND = Candidate("bound", ("tail.mode=swing",))
"""Candidate that stands for the best motion of the tail, which is searched for every car."""
ANNOUNCED = Candidate("announced bound", BOUND.settings)
"""The same for a tail that knows of the turn and may wait at a side; the car then has a trim."""
BOUNDS = (BOUND, ANNOUNCED)
"""Candidates whose motion is searched."""
NAMED_CANDIDATES = {
    "none": NO_TAIL,
    "low-ballast": LOW_BALLAST,
    "bound": BOUND,
    "bound-announced": ANNOUNCED,
    **{name: one.candidate() for name, one in SUITE.candidates.items()},
}
"""Candidates by the name that asks for them."""
FOLDED = NAMED_CANDIDATES["folded"]
FEEDBACK = NAMED_CANDIDATES["feedback"]


@dataclass(frozen=True)
class Case:
    """A car with a tail on a floor.

    Attributes:
        car: member of an ensemble.
        tail: name of a tail of the suite.
        floor: friction of the floor, as a multiple of the car's.
        conditions: further settings of the drive, such as `imu.delay=0.024`.
    """

    car: Member
    tail: str
    floor: float
    conditions: Settings = ()

    @property
    def names(self) -> dict[str, str]:
        """Columns of a table that name the case."""
        return {"tail": self.tail, "floor": f"x {self.floor:g}", "car": self.car.name}

    def settings(self, scenario: str = SWERVE) -> Settings:
        """Returns the settings that turn a scenario into this case, without a candidate's."""
        own = self.car.settings_on(scenario)
        friction = self.floor * load_scenario(scenario, own).car.tyre_friction
        floor = f"car.tyre_friction={friction:.6g}"
        return (*own, *tail_settings(self.tail), floor, *self.conditions)


def candidate_settings(
    candidate: Candidate, case: Case, speed: float, scenario: str = SWERVE
) -> tuple[Settings, ...]:
    """Returns the settings of a candidate's drive on a scenario: one tuple for each place of its
    ballast, one alone if it has none.
    """
    base = case.settings(scenario)
    car = load_scenario(scenario, base)
    places = [ballast(car) for ballast in candidate.ballasts] or [()]
    driven = f"manoeuvre.speed={speed!r}"
    return tuple((*base, *candidate.at(speed), *place, driven) for place in places)


def tail_settings(tail: str) -> Settings:
    """Returns the settings of a tail of the suite; raises SweepError for any other name."""
    if tail not in SUITE.tails:
        raise SweepError(f"tail {tail!r}: {nearest(tail, list(SUITE.tails))}")
    settings = list(SUITE.comparison)
    source = SUITE.tails[tail]
    if source:
        for key, value in load_scenario(source).tail:
            if key not in SUITE.mount_keys:
                settings.append(f"tail.{key}={value}")
    return tuple(settings)


def select_candidates(names: Sequence[str], laws: Sequence[str] = ()) -> list[Candidate]:
    """Returns the candidates of names and of the user's laws; the car without tail comes first."""
    chosen = read_candidates(names, NAMED_CANDIDATES)
    chosen += [user_law(path) for path in laws]
    require_unique([one.name for one in chosen], "candidate", SweepError)
    return chosen


def ensemble_cases(
    ensemble: str,
    part: Literal["training", "test"],
    number: int,
    tail: str,
    floors: Sequence[float],
    seed: int = 1,
    conditions: Settings = (),
) -> list[Case]:
    """Pairs the first cars of one part of an ensemble with floors.

    Raises:
        SweepError: more cars than the part has; a friction scale out of range, or named twice; no
            such tail.
    """
    members = getattr(load_ensemble(ensemble).split(seed), part)
    unit = f"of the {part} cars of {ensemble}"
    check_range("cars", number, 1, len(members), unit, error=SweepError)
    require_unique([f"{scale:g}" for scale in floors], "floor", SweepError)
    tail_settings(tail)
    for scale in floors:
        check_range("floor", scale, *FRICTION_SCALES, "of the car's friction", error=SweepError)
    return [Case(car, tail, scale, conditions) for scale in floors for car in members[:number]]
