"""What is said of a run beside its pictures: its title, how it ended, and what is read off at each
moment.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import DIAGRAM, DRIVEN_BY, PLANT_RUN, TAIL_LAW, RunLog
from aerodima.workbench.metrics.run_summary import (
    MODE_WORDS,
    plant_air,
    plant_outcome,
    plant_speed,
    plant_tilt,
    tail_mode_of,
    tails_of,
)
from aerodima.workbench.metrics.turn_metrics import Outcome, outcome_of
from aerodima.workbench.view.dead_reckoning import RECKONED

RESULT_COLOURS = {"survived": "#14713a", "flipped": "#b3261e", "unknown": "#6b5b00"}
"""Colours of the outcome in pictures."""


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
        """The whole caption in one line."""
        return f"{self.name}: {self.facts}: {self.outcome}"


def caption_of(run_log: RunLog) -> Caption:
    """The caption of a run of the car that has a resolved scenario, or of another plant."""
    if run_log.kind == PLANT_RUN:
        return _caption_of_plant(run_log)
    manoeuvre = run_log.scenario["manoeuvre"]
    tail = MODE_WORDS[tail_mode_of(run_log.scenario)]
    if TAIL_LAW in run_log.extra:
        tail = f"tail law {run_log.extra[TAIL_LAW]}"
    speed = float(manoeuvre["speed"])
    turn = ""
    if manoeuvre["kind"] not in ("straight", "slalom"):
        turn = f"{manoeuvre['direction']} turn, "
    reckoned = ", path reckoned from the sensors" if RECKONED in run_log.extra else ""
    facts = f"{turn}{speed:.2f} m/s ({3.6 * speed:.1f} km/h), {tail}{reckoned}"
    if DIAGRAM in run_log.extra:
        facts = f"driven by the diagram {run_log.extra[DIAGRAM]}{reckoned}"
    if DRIVEN_BY in run_log.extra:
        facts = f"driven by {run_log.extra[DRIVEN_BY]}{reckoned}"
    try:
        outcome = outcome_of(run_log)
    except LogError:
        return Caption(
            run_log.scenario["name"], facts, "outcome not known, the log ends too early", "unknown"
        )
    return Caption(run_log.scenario["name"], facts, outcome_in_words(outcome), outcome.result)


def outcome_in_words(outcome: Outcome) -> str:
    """For example `survived, clean` or `survived, tail touched the ground, board down 0.36 s before
    the turn`.
    """
    words: list[str] = [outcome.result]
    if outcome.result == "survived" and outcome.touched:
        words.append(f"{' and '.join(outcome.touched)} touched the ground")
    elif outcome.clean:
        words.append("clean")
    if outcome.board_before_turn_s:
        words.append(f"board down {outcome.board_before_turn_s:.2f} s before the turn")
    return ", ".join(words)


def _caption_of_plant(run_log: RunLog) -> Caption:
    bodies = [body for _, body in tails_of(run_log)]
    air = "no tail"
    if bodies:
        air = f"air on {', '.join(bodies)}"
    facts = f"{run_log.time[-1] - run_log.time[0]:.2f} s, {air}"
    name = str(run_log.scenario.get("name") or run_log.name)
    outcome = plant_outcome(run_log)
    if outcome is None:
        return Caption(name, facts, "no outcome: no base stands upright at the start", "unknown")
    return Caption(name, facts, outcome_in_words(outcome), outcome.result)


@dataclass(frozen=True)
class Reading:
    """A number that is shown at each moment of a replay.

    Attributes:
        label: before it; may be empty.
        unit: after it, with its space.
        values: shape (n,).
        digits: behind the point.
        width: characters that are kept free for it.
    """

    label: str
    unit: str
    values: FloatArray
    digits: int
    width: int

    def text(self, row: int) -> str:
        """For example `roll −3.2°`."""
        value = round(float(self.values[row]), self.digits) + 0.0  # no minus before a zero
        return f"{self.label} {value:.{self.digits}f}{self.unit}".strip().replace("-", "\u2212")


def readings(run_log: RunLog) -> list[Reading]:
    """For a car speed over ground and roll, positive to the right; for other plants speed, tilt,
    force of the air.
    """
    if run_log.kind != PLANT_RUN:
        speed = np.hypot(
            run_log.signal("velocity_x_truth_m_per_s"), run_log.signal("velocity_y_truth_m_per_s")
        )
        roll = np.degrees(run_log.signal("roll_truth_rad"))
        return [Reading("", " m/s", speed, 2, 5), Reading("roll", "°", roll, 1, 6)]
    found = [Reading("", " m/s", plant_speed(run_log), 2, 5)]
    tilt = plant_tilt(run_log)
    if tilt is not None:
        found.append(Reading("tilt", "°", tilt, 1, 6))
    air = plant_air(run_log)
    if air is not None:
        found.append(Reading("air", " N", air, 2, 5))
    return found


def now_text(run_log: RunLog, row: int) -> str:
    """Time and readings of one row of the log, in one line."""
    return "    ".join(
        [f"t = {run_log.time[row]:.2f} s", *(reading.text(row) for reading in readings(run_log))]
    )
