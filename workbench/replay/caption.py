"""What stands above a replay: scenario, speed, tail mode and how the run ended."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.figure_style import MODE_STYLES
from aerodima.workbench.logs.schema import TAIL_LAW, RunLog
from aerodima.workbench.metrics.run_summary import tail_mode_of
from aerodima.workbench.metrics.turn_metrics import Outcome, outcome_of
from aerodima.workbench.replay.logged_car import RECKONED


@dataclass(frozen=True)
class Caption:
    """Title of a replay.

    Attributes:
        name: of the scenario.
        facts: commanded speed and tail mode, or the tail law of one's own.
        outcome: how the run ended, in words.
        result: `survived`, `flipped`, or `unknown` for a log that ends before its turn does.
    """

    name: str
    facts: str
    outcome: str
    result: Literal["survived", "flipped", "unknown"]

    @property
    def text(self) -> str:
        """All of it in one line."""
        return f"{self.name}: {self.facts}: {self.outcome}"


def caption_of(run_log: RunLog) -> Caption:
    """The caption of a run that has a resolved scenario."""
    manoeuvre, tail = run_log.scenario["manoeuvre"], MODE_STYLES[tail_mode_of(run_log.scenario)].words
    if TAIL_LAW in run_log.extra:
        tail = f"tail law {run_log.extra[TAIL_LAW]}"
    speed = float(manoeuvre["speed"])
    turn = f"{manoeuvre['direction']} turn, " if manoeuvre["kind"] in ("turn", "auto_turn") else ""
    reckoned = ", path reckoned from the sensors" if RECKONED in run_log.extra else ""
    facts = f"{turn}{speed:.2f} m/s ({3.6 * speed:.1f} km/h), {tail}{reckoned}"
    try:
        outcome = outcome_of(run_log)
    except LogError:
        return Caption(run_log.scenario["name"], facts, "outcome not known, the log ends too early", "unknown")
    return Caption(run_log.scenario["name"], facts, outcome_in_words(outcome), outcome.result)


def outcome_in_words(outcome: Outcome) -> str:
    """For example `survived, clean` or `survived, tail touched the ground, board down 0.36 s before the turn`."""
    words: list[str] = [outcome.result]
    if outcome.result == "survived" and outcome.touched:
        words.append(f"{' and '.join(outcome.touched)} touched the ground")
    elif outcome.clean:
        words.append("clean")
    if outcome.board_before_turn_s:
        words.append(f"board down {outcome.board_before_turn_s:.2f} s before the turn")
    return ", ".join(words)


def speed_and_roll(run_log: RunLog) -> tuple[FloatArray, FloatArray]:
    """Speed over ground, m/s, and roll, rad, positive to the right, each of shape (n,); from the truth or reckoned."""
    speed = np.hypot(run_log.signal("velocity_x_truth_m_per_s"), run_log.signal("velocity_y_truth_m_per_s"))
    return speed, run_log.signal("roll_truth_rad")
