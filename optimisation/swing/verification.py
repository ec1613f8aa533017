"""Verification of a swing on its full car by forward simulation at the fine step.

It measures how far the motion is from the knots, whether anything leaves its limits or touches the
car, whether the car survives and touches nothing, and whether its aim reaches the file's claim.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import ArrayLike

from aerodima.optimisation.studies.runs import (
    FINE_STEP,
    RunTask,
    is_clean,
    measured_row,
    step_settings,
)
from aerodima.optimisation.swerve.aims import find_aim
from aerodima.optimisation.swerve.candidate import swing_player
from aerodima.optimisation.swing.solution import AIM, AIM_VALUE, LIMITS_OPTION
from aerodima.optimisation.swing.swerve_shooting import Limit, peaks, read_limits
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.clearance import ground_clearance, make_range_of_motion
from aerodima.workbench.car.swerve import swerve_counts, swerve_of
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_library import (
    find_swing,
    refuse_other_car,
    turn_of_swing,
    turn_words,
)
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.core.file_reading import Facts
from aerodima.workbench.logs.schema import RunLog, software_versions
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.scenario.swing_file import SwingFile, swing_at
from aerodima.workbench.view.report_page import (
    Page,
    Preformatted,
    Section,
    Table,
    write_files,
    zoomable,
)
from aerodima.workbench.view.run_figures import plot_overlay

CAR_CLEARANCE = 1e-3
"""Least distance of a reduced car's tail from the car, m: a margin for its difference from the
full car."""
CLEARANCE_NODES = 25
"""Number of angles of each joint at which the distance of the tail from the car is computed."""
MAX_TILT = 0.8
"""Largest tilt at which the height of the tail over the ground is checked, rad."""
_MARGIN = 1e-3
"""Tolerance of angles (rad) and torques (N m); an encoder and a stop give this much."""
AIM_MARGIN = 0.01
"""Share of its claim by which an aim may be missed."""
SCHEMA = "aerodima/verification/3"
VERDICT = "verification.yaml"
PAGE = "report.html"


@dataclass(frozen=True)
class Check:
    """A number of the run, in `unit`, with its allowed range."""

    name: str
    value: float
    unit: str
    low: float = -math.inf
    high: float = math.inf

    @property
    def is_kept(self) -> bool:
        """Whether the number lies in its range, which NaN does not; True where it has no limits."""
        return not self.allowed or self.low <= self.value <= self.high

    @property
    def allowed(self) -> str:
        """Limits of the number in words; empty if it has none."""
        ends = (("at least", self.low), ("at most", self.high))
        return ", ".join(f"{words} {end:.4g}" for words, end in ends if math.isfinite(end))


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Attributes:
        swing: swing that was driven.
        where: speed and friction of the run, beside those that the file claims, in words.
        checks: checks of the run.
        log: log of the run.
    """

    swing: SwingFile
    where: str
    checks: tuple[Check, ...]
    log: RunLog

    @property
    def complaints(self) -> list[str]:
        """Checks that fail, in words; empty if the swing is verified."""
        return [
            f"{one.name}: {one.value:.4g} {one.unit}".rstrip() + f"; must be {one.allowed}"
            for one in self.checks
            if not one.is_kept
        ]


def verify_swing(
    swing: str,
    scenario: str | None = None,
    settings: Sequence[str] = (),
    *,
    step: float = FINE_STEP,
    other_car: bool = False,
) -> Verification:
    """Checks on the full car that a swing keeps what it promises.

    Args:
        swing: path or name of the swing.
        scenario: scenario of the turn; by default that of the file.
        settings: settings that override the scenario.
        step: step of the plant, s.
        other_car: whether the car may differ from the one that the swing was made for.

    Raises:
        SwingError: the swing is never released in this turn.
        UserError: a scenario or file that is missing or invalid; another car, unless `other_car`.
    """
    played = find_swing(swing)
    player = swing_player(swing)
    turn, overrides = turn_of_swing(played, scenario)
    settings = (*settings, *step_settings(step))
    driven = load_scenario(turn, (*overrides, *settings, *player.settings))
    if not other_car:
        refuse_other_car(driven)
    log = simulate(driven, stop_when_certain=True)
    row = measured_row(RunTask("", turn), driven, log)
    if row["swing_trigger_time_s"] is None:
        raise SwingError(
            f"swing {played.name}: was never released in this turn ({turn} {' '.join(settings)})"
        )
    checks = (*_turn_checks(row), *_aim_checks(played, driven), *_tail_checks(played, driven, log))
    return Verification(played, turn_words(played, driven), checks, log)


def _turn_checks(row: Facts) -> list[Check]:
    return [
        Check("survives", float(row["outcome"] == "survived"), "", low=1.0),
        Check("survives and touches nothing", float(is_clean(row)), "", low=1.0),
        Check("heading change", row["heading_change_rad"], "rad"),
        Check("peak roll of the car", row["peak_roll_rad"], "rad"),
        Check("energy of the tail", row["tail_energy_j"], "J"),
    ]


def _aim_checks(swing: SwingFile, scenario: Scenario) -> Iterator[Check]:
    """Compares the aim of a solution with the value that its file claims for the full car, and the
    swerve with the limits of its search.
    """
    found = swing.provenance.found
    if AIM not in found:
        return
    aim = find_aim(str(found[AIM]))
    swerve = swerve_of(simulate(scenario, record="outcome", stop_when_certain=True))
    yield Check("the swerve counts", float(swerve_counts(swerve)[0]), "", low=1.0)
    asked = str(swing.provenance.options.get(LIMITS_OPTION, ""))
    for limit in read_limits(asked.split()):
        values = limit.function(swerve)
        worst = np.max(values) if limit.upper < math.inf else np.min(values)
        yield Check(f"limit {limit.name}", float(worst), limit.unit, limit.lower, limit.upper)
    claimed = float(found.get(AIM_VALUE, -math.inf))
    value = float(aim(swerve)[0])
    yield Check(f"aim {aim.name}", value, aim.unit, low=claimed - AIM_MARGIN * abs(claimed))


def _tail_checks(swing: SwingFile, scenario: Scenario, log: RunLog) -> list[Check]:
    state = log.signal("controller_state")
    limits = swing.limits
    since = log.time - log.time[np.flatnonzero(state == SwingState.SWING)[0]]
    after = since >= 0.0
    during = after & (since <= swing.knots.time_s[-1])
    point = swing_at(swing, since, scenario.manoeuvre.direction)
    roll = log.signal("tail_roll_angle_rad")
    pitch = log.signal("tail_pitch_angle_rad")
    torques = [log.signal(f"tail_{joint}_torque_n_m")[after] for joint in ("roll", "pitch")]
    upright = after & (log.signal("tilt_truth_rad") < MAX_TILT)
    car_roll = log.signal("roll_truth_rad")[upright]
    ground = ground_clearance(scenario, pitch[upright], roll[upright], car_roll)
    car = car_clearance(scenario)(pitch[after], roll[after])
    off = (roll - point.roll_position)[during]
    pitch_off = (pitch - point.pitch_position)[during]
    followed = float(not np.any(state == SwingState.FALLBACK))
    max_roll = limits.roll_position_rad + _MARGIN
    max_pitch = limits.pitch_position_rad + _MARGIN
    return [
        Check("knots followed to their end", followed, "", low=1.0),
        _peak("tail roll off the knots", off, "rad"),
        _peak("tail roll off the last knot", off[-1], "rad"),
        _peak("tail pitch off the knots", pitch_off, "rad"),
        _peak("tail roll", roll[after], "rad", max_roll),
        _peak("tail pitch", pitch[after], "rad", max_pitch),
        _peak("motor torque", torques, "N m", limits.torque_n_m + _MARGIN),
        Check("distance of the tail from the car", float(np.min(car)), "m", low=0.0),
        Check("height of the tail over the ground", float(np.min(ground)), "m", low=0.0),
    ]


def _peak(name: str, values: ArrayLike, unit: str, high: float = math.inf) -> Check:
    """Returns the check of the largest magnitude of some values."""
    return Check(name, float(np.max(np.abs(values))), unit, high=high)


def car_clearance(scenario: Scenario) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Returns the distance of the tail from cage, deck and wheels, m, as a function of its pitch
    and roll, rad.
    """
    return partial(
        make_range_of_motion(scenario, CLEARANCE_NODES, CLEARANCE_NODES).clearance,
        parts=("cage", "deck", "wheels"),
    )


def car_limit(scenario: Scenario) -> Limit:
    """Returns the limit of a swerve that a verification requires beside `STANDARD_LIMITS`: the tail
    keeps clear of the car.
    """
    distance = car_clearance(scenario)
    return Limit(
        "overlap of tail and car",
        lambda s: peaks(s, -distance(s.tail[:, 0], s.tail[:, 1])),
        "m",
        0.1,
        upper=-CAR_CLEARANCE,
    )


def write_verification(folder: Path, result: Verification) -> list[Path]:
    """Writes verdict (YAML) and page over existing ones; raises SwingError if that fails."""
    scenario = result.log.scenario
    name = result.swing.name
    keys = ("name", "seed", "manoeuvre", "controller", "simulation")
    content = {
        "schema": SCHEMA,
        "swing": name,
        "where": result.where,
        "verified": not result.complaints,
        "complaints": result.complaints,
        "checks": [asdict(check) for check in result.checks],
        "scenario": {key: scenario[key] for key in keys},
        "versions": software_versions(),
    }
    verdict = yaml.safe_dump(content, sort_keys=False, width=110)
    rows = [[one.name, f"{one.value:.4g}", one.unit, one.allowed] for one in result.checks]
    broken = [index for index, one in enumerate(result.checks) if not one.is_kept]
    table = Table(["check", "value", "unit", "allowed"], rows, broken)
    motion = zoomable(plot_overlay([result.log], [name]), "Six signals of the run over time")
    sections = [
        Section("The car of the swing", [table, motion]),
        Section("Provenance", [Preformatted(verdict)]),
    ]
    page = Page(f"Verification of {name}", result.where, sections)
    return write_files(folder, {VERDICT: verdict, PAGE: page}, error=SwingError)
