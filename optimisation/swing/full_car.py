"""The full car under a swing: one run at a friction and a speed, and the highest friction that it survives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.turn_profile import TurnProfile, turn_profile
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.simulate.simulation import simulate

FRICTION_STEP = 0.0125
"""Resolution of critical frictions."""
LEAST_HEADING = 0.95
"""Share of the reference's heading change that a turn must have to count (design section 10)."""
SPIN = 1.5
"""Heading change (rad) with the published swing beyond which a possible car counts as spinning: its rear axle slid out,
so that there is no turn to compare with. Cars that turn lie at 0.6 to 1.1 rad."""
FINE_STEP = 0.0005
"""Step of the plant at which claims are made, s; a fourth of that of ordinary runs."""


@dataclass(frozen=True)
class Outcome:
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


def varied(scenario: Scenario, **sections: dict[str, Any]) -> Scenario:
    """The scenario with other values: section -> key -> value.

    Raises:
        ScenarioError: a value is not allowed.
    """
    data = scenario.resolved()
    for section, values in sections.items():
        data[section] = data[section] | values
    return scenario_from_dict(data)


def drive(
    scenario: Scenario, swing: SwingFile | None = None, friction: float | None = None, all_signals: bool = False
) -> RunLog:
    """One run of the full car, with the controller of the scenario or with a swing whose knots the joints follow.

    Args:
        scenario: car and turn.
        swing: played without feedback on the car; None leaves the scenario's controller.
        friction: of the tyres, instead of the scenario's.
        all_signals: record what a profile needs.
    """
    if friction is not None:
        scenario = varied(scenario, car={"tyre_friction": friction})
    law = None
    if swing is not None:
        scenario = varied(scenario, tail={"mode": "swing"}, controller={"swing_file": "none", "tracking": "joint_pd"})
        law = SwingTracker.from_scenario(swing, scenario)
    return simulate(scenario, record="all" if all_signals else "outcome", law=law, stop_when_flipped=True)


def outcome(run: RunLog) -> Outcome:
    """The figures of a run that swings are compared by."""
    summary = summarise(run, "")
    metrics = summary.metrics
    return Outcome(
        clean=bool(metrics.outcome.clean),
        survived=metrics.outcome.result == "survived",
        peak_roll=metrics.peak_roll_rad,
        heading=metrics.heading_change_rad,
        released=summary.trigger_time,
    )


def drive_all(scenarios: Sequence[Scenario], swing: SwingFile | None, friction: float) -> Outcome:
    """The worst of several cars at one friction of the first, the others in proportion; `released` is of the first."""
    found = [
        outcome(drive(car, swing, here)) for car, here in zip(scenarios, frictions(scenarios, friction), strict=True)
    ]
    return Outcome(
        clean=all(one.clean for one in found),
        survived=all(one.survived for one in found),
        peak_roll=max(one.peak_roll for one in found),
        heading=min(one.heading for one in found),
        released=found[0].released,
    )


def frictions(scenarios: Sequence[Scenario], friction: float) -> list[float]:
    """Friction of each car when the first has `friction`: possible cars differ in what they were calibrated to.

    So "20 % more grip" is asked of all of them alike.
    """
    own = scenarios[0].car.tyre_friction
    return [friction * scenario.car.tyre_friction / own for scenario in scenarios]


def profile_of(run: RunLog, scenario: Scenario, friction: float, fallback_release: float) -> TurnProfile:
    """Profile of a run with all signals, from the release of its swing on; without one from `fallback_release` (s)."""
    released = summarise(run, "").trigger_time
    release = fallback_release if released is None else released
    return turn_profile(run, ReducedCar.of(scenario), release, friction)


@dataclass(frozen=True)
class CriticalFriction:
    """Highest friction of an unbroken row of clean runs.

    Attributes:
        value: 0 when the lowest friction looked at is not survived.
        runs: friction and outcome of every run, by friction.
    """

    value: float
    runs: tuple[tuple[float, Outcome], ...]


def critical_friction(
    scenario: Scenario, swing: SwingFile | None, low: float, high: float, step: float = FRICTION_STEP
) -> CriticalFriction:
    """Bisection on a grid between `low` and `high`; survival is not monotone, so the runs are kept.

    Args:
        scenario: car, turn and step of the plant.
        swing: as `drive`.
        low, high: frictions, the grid starts at `low`.
        step: of the grid.
    """
    runs: dict[int, Outcome] = {}

    def clean(index: int) -> bool:
        if index not in runs:
            runs[index] = outcome(drive(scenario, swing, low + index * step))
        return runs[index].clean

    lost = round((high - low) / step) + 1
    held = -1
    while lost - held > 1:
        middle = (lost + held) // 2
        held, lost = (middle, lost) if clean(middle) else (held, middle)
    rows = tuple((low + index * step, runs[index]) for index in sorted(runs))
    return CriticalFriction(low + held * step if held >= 0 else 0.0, rows)


def unbroken_friction(scenario: Scenario, swing: SwingFile | None, low: float, high: float) -> CriticalFriction:
    """Upwards from `low` until a run is not clean: what a claim rests on, since survival is not monotone.

    Two steps of `FRICTION_STEP` at a time, and one at the end.

    Args:
        scenario: car, turn and step of the plant.
        swing: as `drive`.
        low, high: first and last friction that is run.
    """
    runs: dict[float, Outcome] = {}

    def clean(friction: float) -> bool:
        runs[friction] = outcome(drive(scenario, swing, friction))
        return runs[friction].clean

    last = round((high - low) / FRICTION_STEP)
    held = 0
    if not clean(low):
        return CriticalFriction(0.0, tuple(runs.items()))
    while held < last:
        stride = min(2, last - held)
        if clean(low + (held + stride) * FRICTION_STEP):
            held += stride
            continue
        if stride == 2 and clean(low + (held + 1) * FRICTION_STEP):
            held += 1
        break
    return CriticalFriction(low + held * FRICTION_STEP, tuple(sorted(runs.items())))
