"""Texts beside the pictures of a run: its title, how it ended, and readings of each moment."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import DIAGRAM, DRIVEN_BY, PLANT_RUN, TAIL_LAW, RunLog
from aerodima.workbench.metrics.run_summary import (
    MODE_WORDS,
    STOP,
    plant_air,
    plant_outcome,
    plant_speed,
    plant_tilt,
    tail_mode_of,
    tails_of,
)
from aerodima.workbench.metrics.turn_metrics import Outcome, outcome_of
from aerodima.workbench.view.dead_reckoning import DEAD_RECKONING

RESULT_COLOURS = {"survived": "#14713a", "flipped": "#b3261e", "unknown": "#6b5b00"}
"""Colours of the outcome in pictures."""


@dataclass(frozen=True)
class Caption:
    """Title of a replay.

    Attributes:
        name: name of the scenario.
        facts: commanded speed and tail mode, or the user's own tail law.
        outcome: how the run ended, in words; empty for a plant that does not start upright.
        result: `survived`, `flipped`, or `unknown` for a log that ends before its turn does.
    """

    name: str
    facts: str
    outcome: str
    result: Literal["survived", "flipped", "unknown"]

    @property
    def text(self) -> str:
        """Joins the caption in one line."""
        return ": ".join(filter(None, (self.name, self.facts, self.outcome)))


def run_caption(run_log: RunLog) -> Caption:
    """Makes the caption of a run of the car that has a resolved scenario, or of another plant."""
    if run_log.kind == PLANT_RUN:
        facts = _plant_facts(run_log)
        outcome = plant_outcome(run_log)
        unknown = ""
    else:
        facts = _car_facts(run_log)
        unknown = "outcome not known, the log ends too early"
        try:
            outcome = outcome_of(run_log)
        except LogError:
            outcome = None
    name = str(run_log.scenario.get("name") or run_log.name)
    if outcome is None:
        return Caption(name, facts, unknown, "unknown")
    return Caption(name, facts, outcome_in_words(outcome), outcome.result)


def _car_facts(run_log: RunLog) -> str:
    """Says who drove the car (manoeuvre and tail law, diagram or person), and what stopped it."""
    extra = run_log.extra
    if DRIVEN_BY in extra:
        facts = f"driven by {extra[DRIVEN_BY]}"
    elif DIAGRAM in extra:
        facts = f"driven by the diagram {extra[DIAGRAM]}"
    else:
        manoeuvre = run_log.scenario["manoeuvre"]
        speed = float(manoeuvre["speed"])
        facts = f"{speed:.2f} m/s ({3.6 * speed:.1f} km/h), "
        if manoeuvre["kind"] not in ("straight", "slalom"):
            facts = f"{manoeuvre['direction']} turn, {facts}"
        if TAIL_LAW in extra:
            facts += f"tail law {extra[TAIL_LAW]}"
        else:
            facts += MODE_WORDS[tail_mode_of(run_log.scenario)]
    if STOP[0] in extra:
        time, reason = map(extra.get, STOP)
        facts += f", stopped at {time:.2f} s ({reason})"
    if DEAD_RECKONING in extra:
        facts += ", path reckoned from the sensors"
    return facts


def _plant_facts(run_log: RunLog) -> str:
    """Gives the length of the run, and the tails that feel air."""
    bodies = ", ".join(body for _, body in tails_of(run_log))
    air = f"air on {bodies}" if bodies else "no tail"
    return f"{run_log.time[-1] - run_log.time[0]:.2f} s, {air}"


def outcome_in_words(outcome: Outcome) -> str:
    """Describes an outcome, for example `survived, clean` or `survived, tail touched the ground,
    board down 0.36 s before the turn`.
    """
    words = [str(outcome.result)]
    if outcome.result == "survived" and outcome.touched:
        words.append(f"{' and '.join(outcome.touched)} touched the ground")
    elif outcome.clean:
        words.append("clean")
    if outcome.board_before_turn_s:
        words.append(f"board down {outcome.board_before_turn_s:.2f} s before the turn")
    return ", ".join(words)


@dataclass(frozen=True)
class Reading:
    """A number that is shown at each moment of a replay.

    Attributes:
        label: text before the number; may be empty.
        unit: unit after the number, with its space.
        values: number in each row of the log, shape (n,).
        digits: number of digits after the decimal point.
        width: number of characters that are kept free for the number.
    """

    label: str
    unit: str
    values: FloatArray
    digits: int
    width: int

    def text(self, row: int) -> str:
        """Writes the value of a row, for example `roll −3.2°`."""
        value = round(float(self.values[row]), self.digits) + 0.0  # no minus before a zero
        return f"{self.label} {value:.{self.digits}f}{self.unit}".strip().replace("-", "\u2212")


def readings(run_log: RunLog) -> list[Reading]:
    """Reads speed over ground and roll (positive to the right) of a car; speed, tilt and force of
    the air of other plants.
    """
    if run_log.kind != PLANT_RUN:
        along, left = (run_log.signal(f"velocity_{axis}_truth_m_per_s") for axis in "xy")
        speed = np.hypot(along, left)
        roll = np.degrees(run_log.signal("roll_truth_rad"))
        return [Reading("", " m/s", speed, 2, 5), Reading("roll", "°", roll, 1, 6)]
    numbers = [Reading("", " m/s", plant_speed(run_log), 2, 5)]
    tilt = plant_tilt(run_log)
    if tilt is not None:
        numbers.append(Reading("tilt", "°", tilt, 1, 6))
    air = plant_air(run_log)
    if air is not None:
        numbers.append(Reading("air", " N", air, 2, 5))
    return numbers


def state_caption(run_log: RunLog, row: int) -> str:
    """Writes time and readings of one row of the log in one line."""
    texts = [reading.text(row) for reading in readings(run_log)]
    return "    ".join([f"t = {run_log.time[row]:.2f} s", *texts])
