"""What `aerodima swing verify` leaves in its folder: runs (CSV), verdict (YAML), a page of motion and tip path."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from aerodima.optimisation.swing.verification import Verification
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.swing_file import SwingFile, swing_at
from aerodima.workbench.controllers.swing_law import SwingState
from aerodima.workbench.errors import SwingError
from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    GREY,
    TURN_SHADE,
    VERMILION,
    new_figure,
    shade_turn,
    styled,
)
from aerodima.workbench.logs.schema import RunLog, software_versions
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.metrics.turn_signals import turn_window
from aerodima.workbench.report.report_page import (
    Bullets,
    Page,
    Plot,
    Preformatted,
    Section,
    Table,
    write_files,
    zoomable,
)

SCHEMA = "aerodima/verification/1"
RUNS, VERDICT, PAGE = "verification.csv", "verification.yaml", "report.html"


def write_verification(folder: Path, swing: SwingFile, found: Verification, *, force: bool = False) -> list[Path]:
    """Writes the three files; SwingError when one exists and `force` is not set, or cannot be written."""
    verdict = yaml.safe_dump(_verdict(swing, found), sort_keys=False, width=110)
    page = _page(swing, found, verdict)
    return write_files(folder, {RUNS: found.rows, VERDICT: verdict, PAGE: page}, force=force, error=SwingError)


def _verdict(swing: SwingFile, found: Verification) -> dict[str, Any]:
    metrics = found.summary.metrics
    return {
        "schema": SCHEMA,
        "swing": swing.name,
        "verified": not found.complaints,
        "complaints": list(found.complaints),
        "heading_over_8_rad_per_s": _number(found.heading_ratio),
        "heading_compared_at_friction": _number(found.heading_friction),
        "share_of_ensemble_clean": {who: _number(share) for who, share in found.survival.items()},
        "own_car": {
            "outcome": metrics.outcome.result,
            "clean": metrics.outcome.clean,
            "peak_roll_rad": _number(metrics.peak_roll_rad),
            "heading_change_rad": _number(metrics.heading_change_rad),
            "tail_energy_j": _number(metrics.tail_energy_j),
            **{f"state_error_{key}": _number(value) for key, value in asdict(found.errors).items()},
        },
        "step_s": found.own.scenario["simulation"]["step"],
        "scenario": {key: found.own.scenario[key] for key in ("name", "seed", "manoeuvre", "controller")},
        "versions": software_versions(),
    }


def _number(value: Any) -> Any:
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _page(swing: SwingFile, found: Verification, verdict: str) -> Page:
    errors = found.errors
    result = ["Not verified:", Bullets(found.complaints)] if found.complaints else ["Verified."]
    step = 1000 * found.own.scenario["simulation"]["step"]
    lead = f"Forward simulation of the full car at a step of {step:g} ms, and of the cars of the ensemble."
    share = ", ".join(f"{who} {value:.0%}" for who, value in found.survival.items())
    facts = [
        f"distance of the tail from its curve: at most {np.degrees(errors.tail_roll):.1f} deg in roll, "
        f"{np.degrees(errors.tail_pitch):.1f} deg in pitch; {np.degrees(errors.tail_roll_at_end):.1f} deg at the end",
        f"motor torque up to {errors.largest_torque:.1f} N m of {swing.limits.torque_n_m:g} N m",
        f"clearance of the tail from the car {1000 * errors.clearance:.0f} mm, from the ground "
        f"{1000 * errors.ground:.0f} mm at the roll of the car",
        f"heading change {found.heading_ratio:.1%} of that with 8 rad/s, at friction {found.heading_friction:.2f} "
        f"(needed: {LEAST_HEADING:.0%})",
        f"share of the ensemble that survives clean: {share}",
    ]
    motion = zoomable(
        plot_verification(swing, found),
        "The turn on the car that the swing was made for, with the swing and with that of the thesis "
        "(8 rad/s). Shaded: the turn; dotted: the knots, and the limit of the torque.",
        "Three curves over time: tail roll, car roll, torque of the roll motor",
    )
    path = Plot(
        plot_tip_path(swing, scenario_from_dict(found.own.scenario)),
        "Planned path of the tail's tip in the axes of the car, with a mark every 0.1 s; grey: the tail at "
        "rest before and after; shaded: track, wheelbase and height of the joints.",
        "Path of the tip from behind and from above",
    )
    sections = [
        Section("Verdict", [*result, Bullets(facts), motion, path]),
        Section("Ensemble", [_members(found)]),
        Section("Provenance", [Preformatted(verdict)]),
    ]
    return Page(f"Verification of {swing.name}", lead, sections)


def _members(found: Verification) -> Table:
    rows = []
    for row in found.rows.to_dict("records"):
        failed = isinstance(row["error"], str) and row["error"] != ""
        clean = "" if failed else ("clean" if row["clean"] else "touched " + str(row["touched"]))
        numbers = ("", "") if failed else (
            f"{np.degrees(row['peak_roll_rad']):.1f}", f"{np.degrees(row['heading_change_rad']):.0f}"
        )  # fmt: skip
        outcome = row["error"] if failed else row["outcome"]
        rows.append([row["member"], f"{row['weight']:.3f}", row["who"], outcome, clean, *numbers])
    header = ["member", "weight", "controller", "outcome", "", "peak roll [deg]", "heading change [deg]"]
    return Table(header, rows)


def plot_verification(swing: SwingFile, found: Verification) -> Figure:
    """Tail roll, car roll and torque over time, with the swing and with the reference."""
    log, other = found.own, found.reference
    release = log.time[np.flatnonzero(log.signal("controller_state") == SwingState.SWING)[0]]
    side = log.scenario["manoeuvre"]["direction"]
    with styled():
        image, grid = new_figure(11.0, 7.5, 3, 1, sharex=True)
        tail, car, torque = grid[:, 0]
        for axes in grid[:, 0]:
            shade_turn(axes, turn_window(log))
            axes.axvline(release, color=GREY, linewidth=0.8)
        time = np.linspace(release, release + swing.knots.time_s[-1], 200)
        tail.plot(time, np.degrees(swing_at(swing, time - release, side).roll_position), color=BLACK, linestyle=":")
        car.axhline(0.0, color=GREY, linewidth=0.6)
        for run, look, name in ((other, (BLUE, (0, (5, 2))), "8 rad/s"), (log, (VERMILION, "-"), swing.name)):
            _curves(run, (tail, car, torque), look, name)
        limit = swing.limits.torque_n_m
        for level in (-limit, limit):
            torque.axhline(level, color=BLACK, linestyle=":")
        tail.set_ylabel("tail roll [deg]")
        car.set_ylabel("car roll [deg]")
        torque.set(ylabel="torque of the roll motor [N m]", xlabel="time [s]")
        torque.set_xlim(release - 0.3, min(log.time[-1], release + swing.knots.time_s[-1] + 1.0))
        tail.legend(loc="lower right")
    return image


def _curves(run: RunLog, axes: tuple[Any, ...], look: tuple[str, Any], name: str) -> None:
    tail, car, torque = axes
    colour, line = look
    tail.plot(run.time, np.degrees(run.signal("tail_roll_angle_rad")), color=colour, linestyle=line, label=name)
    car.plot(run.time, np.degrees(run.signal("roll_truth_rad")), color=colour, linestyle=line)
    torque.plot(run.time, run.signal("tail_roll_torque_n_m"), color=colour, linestyle=line)


TICKS = 0.1
"""s between two marks on the path."""


def tip_position(roll: ArrayLike, pitch: ArrayLike, scenario: Scenario) -> FloatArray:
    """Place of the tip (..., 3) in the axes of the car: forwards, left, up from the ground below the rear axle, m.

    Args:
        roll, pitch: of the tail, rad; roll is positive to the right, pitch forwards.
        scenario: geometry.
    """
    q, p, tail = np.asarray(roll), np.asarray(pitch), scenario.tail
    parts = np.broadcast_arrays(
        tail.mount_x + tail.length * np.sin(p) * np.cos(q),
        -tail.length * np.sin(q),
        tail.mount_height + tail.length * np.cos(p) * np.cos(q),
    )
    return np.stack(parts, axis=-1)


def plot_tip_path(swing: SwingFile, scenario: Scenario) -> Figure:
    """The planned path of the tip with a mark every 0.1 s; the tail at rest before and after as grey lines."""
    direction: Any = scenario.manoeuvre.direction
    end = swing.knots.time_s[-1]
    path, marks = (_tip(swing, times, scenario, direction) for times in _times(end))
    car, tail = scenario.car, scenario.tail
    mount = np.array([tail.mount_x, 0.0, tail.mount_height])
    with styled():
        image, grid = new_figure(11.0, 4.6, 1, 2)
        for axes, (across, up) in zip(grid[0], ((1, 2), (1, 0)), strict=True):
            sign = np.array([1.0, -1.0, 1.0])  # to the right is to the right
            for point in (path[0], path[-1]):
                line = np.array([mount, point]) * sign
                axes.plot(line[:, across], line[:, up], color=GREY, linewidth=1.0)
            axes.plot((path * sign)[:, across], (path * sign)[:, up], color=VERMILION)
            axes.plot((marks * sign)[:, across], (marks * sign)[:, up], "o", color=BLACK, markersize=4)
            for number, point in enumerate(marks * sign):
                if number == 0 or np.max(np.abs(marks[number] - marks[number - 1])) > 0.03:
                    words = f" {TICKS * number:.1f} s"
                    axes.annotate(words, (point[across], point[up]), fontsize=8, va="bottom")
            axes.set_aspect("equal")
            axes.margins(0.12)
            axes.set_xlabel("to the right [m]")
        behind, above = grid[0]
        half, length = car.outer_half_track, car.wheelbase
        behind.fill([-half, half, half, -half], [0, 0, mount[2], mount[2]], color=TURN_SHADE, zorder=0)
        above.fill([-half, half, half, -half], [0, 0, length, length], color=TURN_SHADE, zorder=0)
        behind.axhline(0.0, color=BLACK, linewidth=1.0)
        behind.set(ylabel="above the ground [m]", title="From behind")
        above.set(ylabel="forwards from the rear axle [m]", title="From above")
    return image


def _times(end: float) -> tuple[FloatArray, FloatArray]:
    return np.linspace(0.0, end, 301), np.arange(0.0, end + 1e-9, TICKS)


def _tip(swing: SwingFile, times: FloatArray, scenario: Scenario, direction: Any) -> FloatArray:
    point = swing_at(swing, times, direction)
    return tip_position(point.roll_position, point.pitch_position, scenario)
