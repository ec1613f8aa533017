"""What the corner study asks: candidates, floors, which runs count, and what the steering is made best for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from aerodima.optimisation.studies.candidates import (
    FRICTION_CLIMB,
    HELD,
    LOW_BALLAST,
    LOW_CENTRE,
    NO_TAIL,
    THESIS,
    Candidate,
    refuse_twice,
)
from aerodima.optimisation.studies.disturbances import draw_disturbances
from aerodima.optimisation.studies.law_search import LawSearch
from aerodima.optimisation.studies.law_training import CONSTANT_RATE, TRAINED, TRAINED_BY_YAW, LawFamily
from aerodima.optimisation.studies.steering_search import SteeringSearch
from aerodima.optimisation.sweep.rollover_threshold import Search, is_clean
from aerodima.optimisation.swing.full_car import FINE_STEP
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError
from aerodima.workbench.metrics.turn_course import COURSES

CANDIDATES: dict[str, Candidate | LawFamily] = {
    "none": NO_TAIL,
    "low-ballast": LOW_BALLAST,
    "low-centre": LOW_CENTRE,
    "held": HELD,
    "published": THESIS,
    "constant": CONSTANT_RATE,
    "trained": TRAINED,
    "trained-by-yaw": TRAINED_BY_YAW,
}
"""By the name that asks for one; of a family of laws the best one on the training cars is found first."""
STANDARD = tuple(name for name, who in CANDIDATES.items() if who is not TRAINED_BY_YAW)
"""Who takes part unless somebody else is asked for."""
PULSE = 0.5
"""s, unless another is asked for."""
PULSES = (0.1, 2.0)
"""Shortest and longest one that may be asked for, s."""
LONGEST = 3.0
"""Longest steering towards a course, s."""
AFTER, SOON_AFTER = 1.5, 0.2
"""How long a run goes on after the steering, s; the second where only the way to a course is looked at."""
MOST_ROLL, MOST_SIDESLIP = 0.35, 0.1
"""rad; outwards from the turn on, and to either side at the exit."""
STEP_BACK, MOST_BACK = 2, 8
"""Places on the grid of the search by which the steering is lowered when the fine step does not bear it out, and how
often at most."""
ONE_LEVEL = (1.0, 0.0)
TWO_LEVELS = tuple((ratio, hold) for ratio in (0.6, 1.5, 2.5) for hold in (0.15, 0.3))
"""Shapes of steering beside that of one level: first level over the second, and how long it lasts, s."""
SHOWN = (
    *("course_change_rad", "exit_heading_change_rad", "exit_time_s", "exit_speed_m_per_s", "exit_sideslip_rad"),
    *("average_linear_acceleration_m_per_s2", "peak_roll_rad", "two_wheel_time_s", "swing_trigger_time_s"),
)
"""Of the run that proves the pulse."""


@dataclass(frozen=True)
class CornerPlan:
    """How much is run.

    Attributes:
        scenario: of the turn; its tail is the one that all candidates have.
        speeds: m/s.
        floors: friction over the critical friction of the published swing at full lock.
        courses: degrees; the time to each is measured too.
        pulses: lengths of the steering, s; laws are trained for the first one.
        reduced: courses on reduced cars alone, with nothing else of a turn and nothing proved; in place of the full
            ones, which set the floors all the same.
        shapes: of the steering: first level over the second and its time, s; (1, 0) is one level. Every candidate
            searches each of them, and has the best; laws are trained with the first one alone.
        fixed: also measure the course with steering of one level that is not found on the test car: the least of the
            best amplitudes of the training cars, by candidate, speed and share of the floor.
        search: for the steering.
        friction: climb of the critical friction.
        training: how laws are looked for on the training cars.
        disturbed: runs of each candidate in each case with what may be otherwise than planned; 0: none.
        seed: of these disturbances, the same for all candidates of a car.
        step, fine_step: of the plant, s: of searches and disturbed runs, and of claims.

    Raises:
        UserError: a course that is not measured, a pulse out of range, a speed, floor, course or pulse that is named
            twice, a scenario without a turn, more steering than the servo has, more than courses of reduced cars, a
            number of disturbed runs that is not allowed.
    """

    scenario: str = "turn_fast"
    speeds: tuple[float, ...] = (4.5,)
    floors: tuple[float, ...] = (1.1, 1.3)
    courses: tuple[int, ...] = ()
    pulses: tuple[float, ...] = (PULSE,)
    reduced: bool = False
    shapes: tuple[tuple[float, float], ...] = (ONE_LEVEL,)
    fixed: bool = False
    search: SteeringSearch = field(default_factory=SteeringSearch)
    friction: Search = FRICTION_CLIMB
    training: LawSearch = field(default_factory=LawSearch)
    disturbed: int = 0
    seed: int = 1
    step: float = 0.002
    fine_step: float = FINE_STEP

    def __post_init__(self) -> None:
        for degrees in self.courses:
            if degrees not in COURSES:
                raise SweepError(f"course {degrees}: allowed: {', '.join(map(str, COURSES))} degrees")
        for pulse in self.pulses:
            if not PULSES[0] <= pulse <= PULSES[1]:
                raise SweepError(f"pulse {pulse:g} s: allowed: {PULSES[0]:g} to {PULSES[1]:g} s")
        asked = {"speed": self.speeds, "floor": self.floors, "course": self.courses, "pulse": self.pulses}
        for name, values in asked.items():
            refuse_twice([f"{value:g}" for value in values], name)
        if self.disturbed:
            draw_disturbances(self.disturbed, self.seed, "")
        if self.reduced and (self.courses or self.fixed or self.disturbed or len(self.shapes) > 1):
            raise SweepError(
                "reduced cars: allowed: courses after pulses of one level as planned, steering found on each car"
            )
        turn = load_scenario(self.scenario, [f"manoeuvre.steer_angle={self.search.high!r}"]).manoeuvre
        if turn.kind != "turn":
            raise SweepError(f"{self.scenario}: manoeuvre.kind {turn.kind}; allowed: turn")


@dataclass(frozen=True)
class Floor:
    """A case without its candidate: `share` times the critical friction is the friction of the floor."""

    member: Member
    speed: float
    share: float
    critical: float

    @property
    def friction(self) -> float:
        """Of tyres on the floor."""
        return float(f"{self.share * self.critical:.6g}")


Turn = tuple[Candidate, Floor]
PulsedTurn = tuple[float, Candidate, Floor]
"""With the length of its pulse, s."""
Run = tuple[Candidate, Floor, int, tuple[float, float]]
"""A turn with place on the grid and shape of its steering."""


@dataclass(frozen=True)
class Aim:
    """What the steering is made best for: the course after a pulse, or with `degrees` the time to that course."""

    degrees: int | None = None
    pulse: float = PULSE

    @property
    def words(self) -> str:
        """For a line of progress."""
        return f"{self.pulse:g} s pulse" if self.degrees is None else f"time to {self.degrees} degrees"

    @property
    def searching(self) -> tuple[float, float]:
        """How long a run of the search is steered, and goes on after that, s."""
        return (self.pulse, AFTER) if self.degrees is None else (LONGEST, SOON_AFTER)

    def worth(self, row: Mapping[str, Any]) -> float | None:
        """Of a run of the search; None where it does not count."""
        if row["outcome"] is None:
            return None
        if self.degrees is None:
            return float(row["course_change_rad"]) if counts(row) else None
        time, roll = row[f"time_to_{self.degrees}_deg_s"], row[f"peak_roll_to_{self.degrees}_deg_rad"]
        return -float(time) if time is not None and row[f"clean_to_{self.degrees}_deg"] and roll <= MOST_ROLL else None

    def proving(self, row: Mapping[str, Any]) -> tuple[float, float]:
        """The same for the run that proves a run of the search."""
        return self.pulse if self.degrees is None else float(f"{row[f'time_to_{self.degrees}_deg_s']:.6g}"), AFTER

    def proved(self, row: Mapping[str, Any]) -> bool:
        """Whether a run at the fine step counts, and comes to the course."""
        return counts(row) and (self.degrees is None or row[f"time_to_{self.degrees}_deg_s"] is not None)


def counts(row: Mapping[str, Any]) -> bool:
    """Whether a run is a turn: clean, little roll, out of the turn, and hardly sliding there."""
    if row["outcome"] is None or not is_clean(row) or row["exit_sideslip_rad"] is None:
        return False
    return row["peak_roll_rad"] <= MOST_ROLL and abs(row["exit_sideslip_rad"]) <= MOST_SIDESLIP


class Steering(NamedTuple):
    """An amplitude by its place on the grid, the shape of the steering, and what the search found it worth."""

    place: int
    shape: tuple[float, float]
    worth: float


@dataclass(frozen=True)
class Steered:
    """The steering of one candidate in one case.

    Attributes:
        found: what the search came to; None when nothing counted.
        proved: the place on the grid that the fine step bore out; None when none did.
        row: of that run; empty without.
    """

    found: Steering | None
    proved: int | None = None
    row: Mapping[str, Any] = field(default_factory=dict)


def candidates_of(names: Sequence[str]) -> dict[str, Candidate | LawFamily]:
    """Candidates by the names that ask for them; the reference without tail always takes part.

    Raises:
        SweepError: an unknown name; lists all.
    """
    for name in names:
        if name not in CANDIDATES:
            raise SweepError(f"candidate {name!r}: allowed: {', '.join(CANDIDATES)}")
    return {name: who for name, who in CANDIDATES.items() if name in names or who is NO_TAIL}


def chosen_cars(cars: Sequence[Member], names: Sequence[str]) -> list[Member]:
    """Test cars by name.

    Raises:
        SweepError: one is no test car, or named twice.
    """
    known = {car.name: car for car in cars}
    refuse_twice(names, "car")
    for name in names:
        if name not in known:
            raise SweepError(f"car {name!r}: is no test car with this seed; allowed: {', '.join(sorted(known))}")
    return [known[name] for name in names]
