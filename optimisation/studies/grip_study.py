"""Cars, tails and triggers compared by the grip that they survive at one speed (design section 7).

`tail`: what would be worth building: length, width, mass and C_N one at a time, and inertial tails of the same size.
`trigger`: when the swing should begin: signal, delay and travel (thesis 6.3.4), and the signals in a turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.study_report import Findings, band, ran, steps_of_members
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.study import Block, Range, Study
from aerodima.workbench.config.ensemble import weighted_quantiles
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.figures.figure_style import BLACK, BLUE, GREY, VERMILION, new_figure, shade_turn, styled
from aerodima.workbench.metrics.published_values import flip_bracket
from aerodima.workbench.metrics.run_summary import KM_PER_H
from aerodima.workbench.report.report_page import Plot, zoomable

CASE_SPEED = 16 / KM_PER_H
"""m/s; the published tailed car survived it (section 7.1.2)."""
FRICTIONS = Range(first=0.5, last=0.95, number=10)
REFERENCE_FRICTION = 0.6
"""Where heading changes are compared: of `FRICTIONS` the nearest to `models/parameters`; most cases survive there."""


@dataclass(frozen=True)
class Setup:
    """One case: scenario and overrides; `reference` ones are drawn apart."""

    scenario: str
    settings: tuple[str, ...] = ()
    reference: bool = False


def friction_study(
    name: str,
    setups: Mapping[str, Setup],
    settings: Sequence[str],
    ensemble: str | None,
    members: int | None,
    frictions: Range = FRICTIONS,
) -> Study:
    """Every case at every friction, at `CASE_SPEED` unless `settings` say otherwise."""
    speed = f"{SPEED}={CASE_SPEED!r}"
    blocks = tuple(
        Block(
            name=label,
            scenario=setup.scenario,
            settings=(speed, *settings, *setup.settings),
            grid={FRICTION: frictions},
        )
        for label, setup in setups.items()
    )
    return Study(name=name, ensemble=ensemble, members=members, blocks=blocks)


def friction_rows(frame: pd.DataFrame, setups: Mapping[str, Setup]) -> list[dict[str, Any]]:
    """Critical friction of each case with the band of an ensemble, islands, and the heading change beside."""
    low, high = float(frame[FRICTION].min()), float(frame[FRICTION].max())
    rows = []
    for label in setups:
        part = frame[frame["block"] == label]
        steps, weights = steps_of_members(part, FRICTION)
        middles = [step.middle(low, high) for step in steps]
        five, median, ninety_five = weighted_quantiles(middles, weights)
        upright = ran(part)[(ran(part)[FRICTION] - REFERENCE_FRICTION).abs() < 1e-9]
        upright = upright[upright["outcome"] == "survived"]
        rows.append(
            {
                "case": label,
                "critical_friction": float(median),
                "low_5_percent": float(five),
                "high_95_percent": float(ninety_five),
                "outside_the_range": sum(step.survived is None or step.flipped is None for step in steps),
                "without_a_result": int(np.count_nonzero(np.isnan(middles))),
                "step": steps[0].words if len(steps) == 1 else "",
                "members_with_islands": sum(bool(step.islands) for step in steps),
                "heading_change_rad": band(upright, "heading_change_rad")[1] if len(upright) else None,
                "peak_roll_rad": band(upright, "peak_roll_rad")[1] if len(upright) else None,
            }
        )
    return rows


def read_friction(
    frame: pd.DataFrame, setups: Mapping[str, Setup], sentences: Sequence[str], more: Sequence[Plot] = ()
) -> Findings:
    """The cases in order of their critical friction, and the plot."""
    rows = friction_rows(frame, setups)
    best = max(rows, key=lambda row: -np.inf if np.isnan(row["critical_friction"]) else row["critical_friction"])
    step = float(np.diff(np.unique(frame[FRICTION]))[0]) if frame[FRICTION].nunique() > 1 else float("nan")
    said = (
        f"The highest critical friction has {best['case']!r}: {best['critical_friction']:.3f}; the grid resolves "
        f"{step:.2f}, so differences below that are none.",
        "The critical friction is the middle between the last friction survived and the first flip; a value at the end "
        "of the range is only a bound (column outside_the_range). Cars whose runs failed or tipped over before their "
        "turn up to the end of the range are left out (column without_a_result).",
        f"Heading change and peak roll are those at a friction of {REFERENCE_FRICTION:g}, where survived. A car that "
        "turns less far survives more easily.",
        *sentences,
    )
    picture = zoomable(
        friction_figure(frame, setups, rows),
        "Critical friction of each case. Bar: from the last friction survived to the first flip, over an ensemble 5 to "
        "95 %. Small crosses: frictions beyond the first flip that are survived again (islands).",
        "Critical friction of each case",
        "critical_friction",
    )
    columns = ("block", FRICTION, "outcome", "clean", "heading_change_rad", "peak_roll_rad", "swing_trigger_time_s")
    return Findings(rows, said, (picture, *more), columns)


def friction_figure(frame: pd.DataFrame, setups: Mapping[str, Setup], rows: Sequence[Mapping[str, Any]]) -> Figure:
    """One line per case, references in black and blue."""
    with styled():
        figure, axes = new_figure(7.6, 0.32 * len(rows) + 1.2)
        ax = axes[0, 0]
        for level, row in enumerate(rows):
            setup = setups[row["case"]]
            colour = (BLACK if "none" in setup.scenario else BLUE) if setup.reference else VERMILION
            steps, _ = steps_of_members(frame[frame["block"] == row["case"]], FRICTION)
            ends = (row["low_5_percent"], row["high_95_percent"])
            if len(steps) == 1:
                low, high = float(frame[FRICTION].min()), float(frame[FRICTION].max())
                ends = (steps[0].survived or low, steps[0].flipped or high)
                ax.plot(steps[0].islands, [level] * len(steps[0].islands), "x", color=colour, markersize=5)
            ax.plot(ends, [level, level], color=colour, linewidth=4, alpha=0.4, solid_capstyle="butt")
            ax.plot(row["critical_friction"], level, "o", color=colour, markersize=6)
        ax.set_yticks(range(len(rows)), [row["case"] for row in rows])
        ax.invert_yaxis()
        ax.set(xlabel="tyre friction", title="Critical friction")
    return figure


INERTIAL = (
    "tail.normal_force_coefficient=0.0",
    "tail.sail_length=0.05",
    "tail.sail_width=0.05",
    "tail.sail_mass_fraction=0.9",
)
"""An inertial tail: no air, nine tenths of its mass within 0.05 m of its tip."""


def _tail(*settings: str) -> Setup:
    return Setup("turn_swing", settings)


TAILS: dict[str, Setup] = {
    "no tail": Setup("turn_none", reference=True),
    "tail held": Setup("turn_held", reference=True),
    "tail of models/parameters": Setup("turn_swing", reference=True),
    "length 0.7 m": _tail("tail.length=0.7"),
    "length 1.1 m": _tail("tail.length=1.1"),
    "width 0.1 m": _tail("tail.sail_width=0.1"),
    "width 0.3 m": _tail("tail.sail_width=0.3"),
    "mass 0.1 kg": _tail("tail.mass=0.1"),
    "mass 0.25 kg": _tail("tail.mass=0.25"),
    "C_N 1.2": _tail("tail.normal_force_coefficient=1.2"),
    "C_N 2.6": _tail("tail.normal_force_coefficient=2.6"),
    "inertial, same mass and length": _tail(*INERTIAL),
    "inertial, 0.4 kg": _tail(*INERTIAL, "tail.mass=0.4"),
}


def tail_study(settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None) -> Study:
    """Every tail at every friction."""
    return friction_study("Tail: what would be worth building", TAILS, settings, ensemble, members)


def read_tail(frame: pd.DataFrame) -> Findings:
    """Critical friction of every tail."""
    sentences = (
        "One number differs at a time; tails that differ in two may do better than both.",
        "The inertial tails have the same length and the same controller as the others, not one made for them.",
    )
    return read_friction(frame, TAILS, sentences)


def _setup(**controller: float | str) -> Setup:
    return Setup("turn_swing", tuple(f"controller.{name}={value}" for name, value in controller.items()))


TRIGGERS: dict[str, Setup] = {
    "tail held": Setup("turn_held", reference=True),
    "yaw rate 1 rad/s (published)": Setup("turn_swing", reference=True),
    "yaw rate 0.5 rad/s": _setup(trigger_yaw_rate=0.5),
    "yaw rate 2 rad/s": _setup(trigger_yaw_rate=2.0),
    "acceleration 2 m/s2": _setup(trigger="lateral_acceleration", trigger_lateral_acceleration=2.0),
    "acceleration 4 m/s2": _setup(trigger="lateral_acceleration", trigger_lateral_acceleration=4.0),
    "steering": _setup(trigger="steering"),
    "steering + 0.05 s": _setup(trigger="steering", delay=0.05),
    "steering + 0.1 s": _setup(trigger="steering", delay=0.1),
    "steering + 0.2 s": _setup(trigger="steering", delay=0.2),
    "yaw rate, delay 0.1 s": _setup(delay=0.1),
    "yaw rate, travel 90 degrees": _setup(travel=1.5707963267948966),
    "yaw rate, travel 160 degrees": _setup(travel=2.792526803190927),
}


def trigger_study(settings: Sequence[str] = (), ensemble: str | None = None, members: int | None = None) -> Study:
    """Every trigger at every friction."""
    return friction_study("Trigger: signal, delay and travel", TRIGGERS, settings, ensemble, members)


def read_trigger(frame: pd.DataFrame) -> Findings:
    """Critical friction of every trigger; load of the inner wheels against yaw rate in the tailless turn."""
    from aerodima.workbench.simulate.simulation import simulate

    speed = flip_bracket("tailless").survived
    log = simulate(load_scenario("turn_none", [f"manoeuvre.speed={speed!r}"]), record="outcome")
    sentences = _lead(log)
    caption = (
        f"Tailless turn at {speed:.2f} m/s: yaw rate and lateral acceleration, and the share of the load that "
        "the inner wheels carry. Dotted: the yaw rate of the published trigger, and inner wheels without load."
    )
    picture = zoomable(_signals_figure(log), caption, "Yaw rate and wheel load over time in a turn", "signals")
    return read_friction(frame, TRIGGERS, sentences, (picture,))


def _wheel_loads(log: Any) -> tuple[np.ndarray, np.ndarray]:
    loads = {wheel: log.signal(f"wheel_force_{wheel}_z_truth_n") for wheel in WHEELS}
    inner, outer = (loads[f"front_{side}"] + loads[f"rear_{side}"] for side in ("left", "right"))
    return inner, outer


def _lead(log: Any) -> tuple[str, ...]:
    """How long before the inner wheels are empty each threshold is passed, in the tailless left turn."""
    time, (inner, _) = log.time, _wheel_loads(log)
    turning = time >= 2.0
    crossed = {
        "yaw rate 1 rad/s": log.signal("gyro_z_truth_rad_per_s") > 1.0,
        "lateral acceleration 3 m/s2": log.signal("acceleration_y_truth_m_per_s2") > 3.0,
        "inner wheels empty": inner < 0.1,
    }
    first = {name: time[turning & over] for name, over in crossed.items()}
    told = [f"{name} at {times[0] - 2.0:.3f} s" if times.size else f"{name}: never" for name, times in first.items()]
    return ("After the steering command of the tailless turn: " + "; ".join(told) + ".",)


def _signals_figure(log: Any) -> Figure:
    time, (inner, outer) = log.time, _wheel_loads(log)
    shown = (time >= 1.9) & (time <= 3.0)
    with styled():
        figure, axes = new_figure(7.2, 4.4, 2, 1, sharex=True)
        top, bottom = axes[:, 0]
        for ax in (top, bottom):
            shade_turn(ax, (2.0, 2.64))
        top.plot(time[shown], log.signal("gyro_z_truth_rad_per_s")[shown], color=BLACK, label="yaw rate")
        acceleration = log.signal("acceleration_y_truth_m_per_s2")[shown]
        top.plot(time[shown], acceleration, color=BLUE, label="lateral acceleration, m/s²")
        top.axhline(1.0, color=GREY, linestyle=":")
        top.set(ylabel="yaw rate, rad/s", title="Signals that can start the swing")
        top.legend()
        total = np.maximum(inner + outer, 1e-9)
        bottom.plot(time[shown], (inner / total)[shown], color=VERMILION)
        bottom.axhline(0.0, color=GREY, linestyle=":")
        bottom.set(ylabel="share of the load on\nthe inner wheels", xlabel="time, s", ylim=(-0.05, 0.65))
    return figure
