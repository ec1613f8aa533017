"""Does a swing do on the full car what its file promises? Forward simulation at the fine step, over the ensemble.

Three questions. On the car the swing was made for: how far is the motion from the knots, does anything leave its limits
or touch the car? On the ensemble: which share of the members survives, clean? And is the turn still the turn: is the
heading change at least 95 % of that with the thesis' swing (8 rad/s), at the highest friction that both survive
(design section 10)?
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, is_clean
from aerodima.optimisation.sweep.runs import FINE_STEP, Runs, RunTask, make_frame, measured_row, step_settings
from aerodima.optimisation.swing.candidate import THESIS, Candidate, swing_player
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile, swing_at
from aerodima.workbench.controllers.law_of_scenario import find_swing, own_turn, refuse_other_car, turn_words
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.errors import SwingError
from aerodima.workbench.figures.figure_style import BLACK, BLUE, GREY, VERMILION, new_figure, shade_turn, styled
from aerodima.workbench.logs.schema import RunLog, software_versions
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.metrics.turn_signals import turn_window
from aerodima.workbench.plants.clearance import ground_clearance, make_range_of_motion
from aerodima.workbench.report.report_page import Page, Preformatted, Section, Table, write_files, zoomable
from aerodima.workbench.simulate.simulation import simulate
from aerodima.workbench.text_table import shown_value

LOWER_FRICTION, MOST_LOWER = 0.05, 6
"""Where one of both flips, headings are compared at a friction lower by this, at most so many times."""
UPRIGHT = 0.8
"""Largest tilt at which the height of the tail over the ground is asked for, rad."""
_MARGIN = 1e-3
"""rad and N m; an encoder and a stop give this much."""
SCHEMA = "aerodima/verification/2"
RUNS, VERDICT, PAGE = "verification.csv", "verification.yaml", "report.html"
SHOWN = ("who", "member", "weight", "outcome", "clean", "touched", "peak_roll_rad", "heading_change_rad", "error")
"""Columns of the runs of the ensemble on the page."""


@dataclass(frozen=True)
class Check:
    """A number of the car that the swing was made for, in `unit`, and what it may be."""

    name: str
    value: float
    unit: str
    low: float = -math.inf
    high: float = math.inf

    @property
    def is_kept(self) -> bool:
        """Whether it lies within its limits; a number that there is not does not."""
        return not self.allowed or self.low <= self.value <= self.high

    @property
    def allowed(self) -> str:
        """Its limits in words; empty without."""
        ends = (("at least", self.low), ("at most", self.high))
        return ", ".join(f"{words} {end:.4g}" for words, end in ends if math.isfinite(end))


@dataclass(frozen=True)
class Verification:
    """What was found.

    Attributes:
        swing: what was driven.
        where: speed and friction, beside those that the file claims.
        checks: on the car that it was made for.
        rows: one per run of the ensemble: who, member, weight, outcome, metrics.
        survival: weighted share of the ensemble that survives clean, with the swing and with that of the thesis.
        own: the run of the swing on that car; `reference` the same turn with the thesis' swing.
    """

    swing: SwingFile
    where: str
    checks: tuple[Check, ...]
    rows: pd.DataFrame
    survival: dict[str, float]
    own: RunLog
    reference: RunLog

    @property
    def complaints(self) -> list[str]:
        """What speaks against the swing; empty when it is verified."""
        return [
            f"{one.name}: {one.value:.4g} {one.unit}".rstrip() + f"; allowed: {one.allowed}"
            for one in self.checks
            if not one.is_kept
        ]


def verify_swing(
    swing: str,
    scenario: str | None = None,
    settings: Sequence[str] = (),
    *,
    ensemble: str = "car",
    members: int | None = None,
    step: float = FINE_STEP,
    other_car: bool = False,
    engine: Engine | None = None,
) -> Verification:
    """Does a swing keep what it promises, on the full car and on the cars of an ensemble?

    Args:
        swing: path or name.
        scenario: turn to make; by default that of the file.
        settings: override it.
        ensemble: of cars; `members` of it, drawn by weight.
        step: of the plant, s.
        other_car: also on another car than it was made for.
        engine: where the runs are made.

    Raises:
        SwingError: the swing is never released in this turn.
        UserError: what the scenario or the file lacks; another car.
    """
    played, player = find_swing(swing), swing_player(swing)
    turn, own = own_turn(played, scenario)
    fine = (*own, *settings, *step_settings(step))
    scenarios = [load_scenario(turn, (*fine, *who.settings)) for who in (player, THESIS)]
    if not other_car:
        refuse_other_car(scenarios[0])
    engine = engine or Engine()
    runs = Runs(engine)
    logs = engine.map(_logged, scenarios)
    rows = [measured_row(RunTask("", turn), *each) for each in zip(scenarios, logs, strict=True)]
    if rows[0]["swing_trigger_time_s"] is None:
        raise SwingError(f"swing {played.name}: was never released in this turn ({turn} {' '.join(settings)})")
    heading = heading_ratio(runs, turn, fine, (player, THESIS), scenarios[0].car.tyre_friction, rows)
    checks = (*_turn_checks(rows[0], *heading), *_tail_checks(played, scenarios[0], logs[0]))
    cars = load_ensemble(ensemble)
    chosen = cars.members if members is None else cars.drawn(members)
    pairs = [(who, car) for who in (player, THESIS) for car in chosen]
    tasks = [RunTask(car.name, turn, (*car.settings_on(turn), *fine, *who.settings)) for who, car in pairs]
    heads = [{"who": who.name, "member": car.name, "weight": car.weight} for who, car in pairs]
    frame = make_frame([head | row for head, row in zip(heads, runs.rows(tasks), strict=True)])
    clean = frame["weight"].where(frame["clean"].fillna(False).astype(bool), 0.0)
    share = clean.groupby(frame["who"], sort=False).sum() / frame.groupby("who", sort=False)["weight"].sum()
    survival = {str(who): float(value) for who, value in share.items()}
    return Verification(played, turn_words(played, scenarios[0]), checks, frame, survival, *logs)


def _logged(scenario: Scenario) -> RunLog:
    return simulate(scenario, stop_when_certain=True)


def heading_ratio(
    runs: Runs,
    scenario: str,
    settings: Sequence[str],
    candidates: Sequence[Candidate],
    friction: float,
    pair: Sequence[Mapping[str, Any]],
) -> tuple[float, float]:
    """Heading change over the reference's at the highest friction that both survive clean, and that friction.

    From `friction`, where the rows of both are `pair`, downwards in steps; NaN twice where there is none. SwingError
    when a run fails.
    """
    for lower in range(MOST_LOWER + 1):
        mu = friction - lower * LOWER_FRICTION
        if lower:
            here = (*settings, f"{FRICTION}={mu:.9g}")
            pair = runs.rows([RunTask("", scenario, (*here, *who.settings)) for who in candidates])
            for row in pair:
                if row["error"]:
                    raise SwingError(f"{scenario} {' '.join(here)}: {row['error']}")
        own, other = pair
        if is_clean(own) and is_clean(other):
            return own["heading_change_rad"] / other["heading_change_rad"], mu
    return math.nan, math.nan


def _turn_checks(row: Mapping[str, Any], ratio: float, friction: float) -> Iterator[Check]:
    yield Check("survives", float(row["outcome"] == "survived"), "", low=1.0)
    yield Check("survives and touches nothing", float(is_clean(row)), "", low=1.0)
    yield Check("heading change over that with 8 rad/s", ratio, "", low=LEAST_HEADING)
    yield Check("friction at which headings compare", friction, "")
    yield Check("heading change", row["heading_change_rad"], "rad")
    yield Check("peak roll of the car", row["peak_roll_rad"], "rad")
    yield Check("energy of the tail", row["tail_energy_j"], "J")


def _tail_checks(swing: SwingFile, scenario: Scenario, log: RunLog) -> Iterator[Check]:
    state, limits = log.signal("controller_state"), swing.limits
    since = log.time - log.time[np.flatnonzero(state == SwingState.SWING)[0]]
    after = since >= 0.0
    during = after & (since <= swing.knots.time_s[-1])
    point = swing_at(swing, since, scenario.manoeuvre.direction)
    roll, pitch = log.signal("tail_roll_angle_rad"), log.signal("tail_pitch_angle_rad")
    torque = np.maximum(np.abs(log.signal("tail_roll_torque_n_m")), np.abs(log.signal("tail_pitch_torque_n_m")))
    upright = after & (log.signal("tilt_truth_rad") < UPRIGHT)
    ground = ground_clearance(scenario, pitch[upright], roll[upright], log.signal("roll_truth_rad")[upright])
    motion = make_range_of_motion(scenario, 25, 25)
    car = motion.clearance(pitch[after], roll[after], ("cage", "deck", "wheels"))
    off = np.abs(roll - point.roll_position)[during]
    yield Check("knots followed to their end", float(not np.any(state == SwingState.FALLBACK)), "", low=1.0)
    yield Check("tail roll off the knots", float(np.max(off)), "rad")
    yield Check("tail roll off the last knot", float(off[-1]), "rad")
    yield Check("tail pitch off the knots", float(np.max(np.abs(pitch - point.pitch_position)[during])), "rad")
    for name, values, unit, limit in (
        ("tail roll", np.abs(roll), "rad", limits.roll_position_rad),
        ("tail pitch", np.abs(pitch), "rad", limits.pitch_position_rad),
        ("motor torque", torque, "N m", limits.torque_n_m),
    ):
        yield Check(name, float(np.max(values[after])), unit, high=limit + _MARGIN)
    yield Check("distance of the tail from the car", float(np.min(car)), "m", low=0.0)
    yield Check("height of the tail over the ground", float(np.min(ground)), "m", low=0.0)


def write_verification(folder: Path, found: Verification, *, force: bool = False) -> list[Path]:
    """Writes runs (CSV), verdict (YAML) and page; SwingError when one exists and `force` is not set."""
    scenario, swing = found.own.scenario, found.swing
    verdict = yaml.safe_dump(
        {
            "schema": SCHEMA,
            "swing": swing.name,
            "where": found.where,
            "verified": not found.complaints,
            "complaints": found.complaints,
            "checks": [asdict(one) for one in found.checks],
            "share_of_ensemble_clean": found.survival,
            "scenario": {key: scenario[key] for key in ("name", "seed", "manoeuvre", "controller", "simulation")},
            "versions": software_versions(),
        },
        sort_keys=False,
        width=110,
    )
    rows = [[one.name, f"{one.value:.4g}", one.unit, one.allowed] for one in found.checks]
    broken = [place for place, one in enumerate(found.checks) if not one.is_kept]
    drawn = plot_verification(found)
    motion = zoomable(drawn, "Dotted: knots, and limit of the torque.", "Tail roll, car roll and torque over time")
    shares = [[who, f"{share:.0%}"] for who, share in found.survival.items()]
    members = found.rows[[name for name in SHOWN if name in found.rows]]
    cells = [["" if pd.isna(value) else shown_value(value) for value in row] for row in members.itertuples(index=False)]
    sections = [
        Section("The car of the swing", [Table(["check", "value", "unit", "allowed"], rows, broken), motion]),
        Section("Ensemble", [Table(["controller", "survives clean"], shares), Table(list(members.columns), cells)]),
        Section("Provenance", [Preformatted(verdict)]),
    ]
    page = Page(f"Verification of {swing.name}", found.where, sections)
    return write_files(folder, {RUNS: found.rows, VERDICT: verdict, PAGE: page}, force=force, error=SwingError)


def plot_verification(found: Verification) -> Figure:
    """Tail roll, car roll and torque over time, with the swing and with that of the thesis."""
    log, swing = found.own, found.swing
    release = log.time[np.flatnonzero(log.signal("controller_state") == SwingState.SWING)[0]]
    end = release + swing.knots.time_s[-1]
    with styled():
        image, grid = new_figure(11.0, 7.5, 3, 1, sharex=True)
        tail, car, torque = grid[:, 0]
        for axes in grid[:, 0]:
            shade_turn(axes, turn_window(log))
            axes.axvline(release, color=GREY, linewidth=0.8)
        time = np.linspace(release, end, 200)
        knots = swing_at(swing, time - release, log.scenario["manoeuvre"]["direction"]).roll_position
        tail.plot(time, np.degrees(knots), color=BLACK, linestyle=":")
        for run, colour, line, name in ((found.reference, BLUE, "--", THESIS.name), (log, VERMILION, "-", swing.name)):
            look = {"color": colour, "linestyle": line}
            tail.plot(run.time, np.degrees(run.signal("tail_roll_angle_rad")), label=name, **look)
            car.plot(run.time, np.degrees(run.signal("roll_truth_rad")), **look)
            torque.plot(run.time, run.signal("tail_roll_torque_n_m"), **look)
        for level in (-swing.limits.torque_n_m, swing.limits.torque_n_m):
            torque.axhline(level, color=BLACK, linestyle=":")
        tail.set_ylabel("tail roll [deg]")
        car.set_ylabel("car roll [deg]")
        torque.set(ylabel="torque of the roll motor [N m]", xlabel="time [s]")
        torque.set_xlim(release - 0.3, min(log.time[-1], end + 1.0))
        tail.legend(loc="lower right")
    return image
