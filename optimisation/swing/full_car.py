"""The full car under a swing: one run, the highest friction that it survives, and what a car is compared with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search, Start, Threshold, search_rows
from aerodima.optimisation.sweep.study_engine import RunEngine, in_waves, nearest_start
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.turn_profile import TurnProfile, turn_profile
from aerodima.workbench.config.scenario import Scenario, default_values
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker
from aerodima.workbench.errors import SwingError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.simulate.simulation import simulate

FRICTION_STEP = 0.0125
"""Resolution of critical frictions."""
SPIN = 1.5
"""Heading change (rad) with the published swing beyond which a car counts as spinning: its rear axle slid out, so that
there is no turn to compare with. Cars that turn lie at 0.6 to 1.1 rad."""
FINE_STEP = 0.0005
"""Step of the plant at which claims are made, s; a fourth of that of ordinary runs."""

ROLLED_EVERY = 0.05
"""Of tyre friction: the grid on which searches for a swing drive the straight, finer than that of scans: on two wheels
the roll at the end of the row tells another one."""

REFERENCE_SEARCH = Search(FRICTION, 0.3, 1.2, FRICTION_STEP, FRICTION_STEP)
"""Of the reference's highest friction."""


@dataclass(frozen=True)
class DriveOutcome:
    """What a run of the full car came to.

    Attributes:
        clean: as in `aerodima.workbench.metrics.turn_metrics.Outcome`.
        survived: did not roll over.
        peak_roll: rad; `heading` change, rad; `released` when the swing was, s, or None.
    """

    clean: bool
    survived: bool
    peak_roll: float
    heading: float
    released: float | None

    def words(self, friction: float, speed: float) -> str:
        """For a line of progress."""
        end = "clean" if self.clean else "survived" if self.survived else "rolled over"
        return f"at {speed:.2f} m/s, friction {friction:.3f}: {end}, peak {self.peak_roll:.3f} rad"


varied = Scenario.varied


def drive(
    scenario: Scenario,
    swing: SwingFile | None = None,
    friction: float | None = None,
    *,
    all_signals: bool = False,
    rolling: bool = False,
) -> RunLog:
    """One run of the full car, with the controller of the scenario or with a swing whose knots the joints follow.

    Args:
        scenario: car and turn.
        swing: played without feedback on the car; None leaves the scenario's controller.
        friction: of the tyres, instead of the scenario's.
        all_signals: record what a profile needs.
        rolling: begin just before the turn where the straight can be shared (`nearest_start`): for searches, while
            claims are made from rest.
    """
    if friction is not None:
        scenario = varied(scenario, car={"tyre_friction": friction})
    law = None
    if swing is not None:
        scenario = played_turn(scenario)
        law = SwingTracker.from_scenario(swing, scenario)
    start = nearest_start(scenario, law, ROLLED_EVERY) if rolling else None
    record: Literal["all", "outcome"] = "all" if all_signals else "outcome"
    return simulate(scenario, record=record, law=law, start=start, stop_when_certain=True)


def played_turn(scenario: Scenario) -> Scenario:
    """The turn of a scenario with a tail whose joints follow the knots of a swing."""
    return varied(scenario, tail={"mode": "swing"}, controller={"swing_file": "none", "tracking": "joint_pd"})


def outcome(run: RunLog) -> DriveOutcome:
    """The figures of a run that swings are compared by."""
    summary = summarise(run, "")
    metrics = summary.metrics
    return DriveOutcome(
        clean=bool(metrics.outcome.clean),
        survived=metrics.outcome.result == "survived",
        peak_roll=metrics.peak_roll_rad,
        heading=metrics.heading_change_rad,
        released=summary.trigger_time,
    )


Ride = tuple[Scenario, SwingFile | None, float]
"""Car and turn, swing and friction, as for `drive`."""


def outcome_of(ride: Ride) -> DriveOutcome:
    """From rest; for an engine."""
    return outcome(drive(*ride))


def rolling_outcome_of(ride: Ride) -> DriveOutcome:
    """Of a run that begins rolling where it can; for an engine."""
    return outcome(drive(*ride, rolling=True))


def drive_all(
    cars: Sequence[Scenario],
    swing: SwingFile | None,
    places: Sequence[tuple[float, float]],
    engine: RunEngine,
    rolling: bool = False,
) -> Iterator[DriveOutcome]:
    """The worst of several cars at one (friction, speed) after another, driven in waves: who stops asking stops them.

    Args:
        cars: scenarios of the same turn.
        swing: as `drive`.
        places: frictions of the first car, those of the others are in proportion; speeds in m/s.
        engine: where the cars are driven.
        rolling: as `drive`.
    """
    rides = (
        (varied(car, manoeuvre={"speed": speed}), swing, here)
        for friction, speed in places
        for car, here in zip(cars, frictions(cars, friction), strict=True)
    )
    driven = in_waves(engine, rolling_outcome_of if rolling else outcome_of, rides)
    for _ in places:
        found = list(islice(driven, len(cars)))
        yield DriveOutcome(
            clean=all(one.clean for one in found),
            survived=all(one.survived for one in found),
            peak_roll=max(one.peak_roll for one in found),
            heading=min(one.heading for one in found),
            released=found[0].released,
        )


def frictions(scenarios: Sequence[Scenario], friction: float) -> list[float]:
    """Friction of each car when the first has `friction`: members of an ensemble differ in what they are calibrated to.

    So "20 % more grip" is asked of all of them alike.
    """
    own = scenarios[0].car.tyre_friction
    return [friction * scenario.car.tyre_friction / own for scenario in scenarios]


def profile_of(ride: Ride) -> TurnProfile:
    """Profile of a run from the release of its swing on, without one from the start of the turn; for an engine."""
    scenario, _, friction = ride
    run = drive(*ride, all_signals=True)
    released = summarise(run, "").trigger_time
    release = scenario.manoeuvre.turn_start if released is None else released
    return turn_profile(run, ReducedCar.of(scenario), release, friction)


def clean_critical_friction(
    scenario: Scenario, swing: SwingFile | None, search: Search, start: Start = "bisect"
) -> Threshold:
    """Highest friction of an unbroken row of clean runs, with the `DriveOutcome` of every run.

    Args:
        scenario: car, turn and step of the plant.
        swing: as `drive`.
        search: frictions, and their grid.
        start: where a climb begins; or how else it is searched.
    """

    def run(wanted: Sequence[tuple[int, float]]) -> list[DriveOutcome]:
        return [outcome(drive(scenario, swing, friction)) for _, friction in wanted]

    return search_rows(search, [start], run, lambda seen: seen.clean)[0]


@dataclass(frozen=True)
class Reference:
    """The published swing in a turn: highest friction that it survives clean, and its heading change there, rad."""

    friction: float
    heading: float

    @classmethod
    def of(cls, scenario: Scenario, near: Start = "bisect") -> Reference:
        """Of the turn of a scenario, on a grid of `FRICTION_STEP`.

        Args:
            scenario: car and turn.
            near: friction that is nearly it, as that of a coarser step is, from which the grid is walked over.

        Raises:
            SwingError: the published swing does not survive the turn at the lowest friction.
        """
        found = clean_critical_friction(cls.turn(scenario), None, REFERENCE_SEARCH, near)
        if found.survived is None:
            raise SwingError(
                f"the published swing does not survive {scenario.manoeuvre.speed:g} m/s at friction "
                f"{REFERENCE_SEARCH.low:g}, so there is no turn to compare with; allowed: a slower turn"
            )
        return cls(found.survived, found.rows[found.survived].heading)

    @staticmethod
    def turn(scenario: Scenario) -> Scenario:
        """The turn of a scenario with the published swing."""
        return varied(scenario, tail={"mode": "swing"}, controller=default_values()["controller"])


@dataclass(frozen=True)
class Car:
    """A car and its turn as a resolved scenario, small enough to send anywhere, with what it is compared with."""

    scenario: dict[str, Any]
    reference: Reference

    @classmethod
    def of(cls, scenario: Scenario) -> Car:
        """With the published swing driven for its reference; errors as `Reference.of`."""
        return cls(scenario.resolved(), Reference.of(scenario))


def shares(cars: Sequence[Car], friction: float) -> list[float]:
    """Friction of each car, as many times what it survives with the published swing as `friction` is for the first."""
    return [friction * car.reference.friction / cars[0].reference.friction for car in cars]
