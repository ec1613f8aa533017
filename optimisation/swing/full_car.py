"""One run of the full car under a swing, and what it came to."""

from __future__ import annotations

from dataclasses import dataclass

from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.swing_player import SwingPlayer
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.simulate.simulation import simulate

FRICTION_STEP = 0.0125
"""Resolution of critical frictions."""
FINE_STEP = 0.0005
"""Step of the plant at which claims are made, s; a fourth of that of ordinary runs."""


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
) -> RunLog:
    """One run of the full car, with the controller of the scenario or with a swing whose knots the joints follow.

    Args:
        scenario: car and turn.
        swing: played; None leaves the scenario's controller.
        friction: of the tyres, instead of the scenario's.
    """
    if friction is not None:
        scenario = varied(scenario, car={"tyre_friction": friction})
    law = None
    if swing is not None:
        scenario = played_turn(scenario)
        law = SwingPlayer.from_scenario(swing, scenario)
    return simulate(scenario, record="outcome", law=law, stop_when_certain=True)


def played_turn(scenario: Scenario) -> Scenario:
    """The turn of a scenario with a tail whose joints follow the knots of a swing."""
    return varied(scenario, tail={"mode": "swing"}, controller={"swing_file": "none"})


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
