"""Is a more passive tail better at higher speed (thesis 7.2.2)? Critical friction over speed, tail by tail.

From passive to active: a tail that lies loose on its inner stop, one that is held there softly, one that is held with
the gains of the thesis, and tails that swing slowly to fast. Each runs the same turn on the car of the parameter files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.contestants import (
    FRICTION_CLIMB,
    HELD,
    NO_TAIL,
    SWINGING,
    THESIS,
    Contestant,
    fixed_law,
)
from aerodima.optimisation.studies.study_store import SCENARIO
from aerodima.optimisation.sweep.rollover_threshold import SPEED, Case, find_thresholds, is_clean
from aerodima.optimisation.sweep.run_study import make_frame
from aerodima.optimisation.sweep.study_engine import RunEngine
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.figures.figure_style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    new_figure,
    png,
    styled,
)
from aerodima.workbench.report.report_page import write_files

SPEEDS = (3.6, 4.5, 5.25, 6.0)
"""m/s."""
SOFT = (2.0, 0.5)
"""Gains of a soft hold, N m/rad and N m s/rad; the thesis holds with (17, 5). Its tail gives way 0.4 rad to 0.8 N m."""
RATES = (3.0, 6.0, 12.0)
"""rad/s, beside the published 8."""
_STYLES = (
    (GREY, "o", ":", 7),
    (SKY, "v", "-", 15),
    (BLUE, "s", "-", 10),
    (GREEN, "D", "-", 5),
    (ORANGE, "^", "--", 7),
    (VERMILION, "P", "--", 7),
    (BLACK, "X", "--", 7),
    (PURPLE, "*", "--", 9),
)
"""No tail, held tails, swinging tails: colour, marker, line, size. Held tails may coincide: each is smaller than the
one below it."""


def tails() -> list[Contestant]:
    """No tail, then from passive to active."""
    return [
        NO_TAIL,
        _held("loose on its stop", 0.0, 0.0),
        _held(f"held softly ({SOFT[0]:g}, {SOFT[1]:g})", *SOFT),
        HELD,
        *(Contestant(f"{rate:g} rad/s", (*SWINGING, *fixed_law(rate))) for rate in RATES[:2]),
        THESIS,
        *(Contestant(f"{rate:g} rad/s", (*SWINGING, *fixed_law(rate))) for rate in RATES[2:]),
    ]


def _held(name: str, kp: float, kd: float) -> Contestant:
    return Contestant(name, ("tail.mode=held", f"controller.hold_kp={kp!r}", f"controller.hold_kd={kd!r}"))


def measure_passivity(engine: RunEngine, speeds: Sequence[float] = SPEEDS) -> pd.DataFrame:
    """One row per tail and speed: critical friction, and roll and heading there.

    Args:
        engine: where to run.
        speeds: of the turn, m/s.
    """
    numerics = ("simulation.step=0.002", "simulation.log_rate=500")
    keys = [(tail, speed) for tail in tails() for speed in speeds]
    cases = [Case(t.name, SCENARIO, (*numerics, *t.at(v), f"{SPEED}={v!r}")) for t, v in keys]
    start = load_scenario(SCENARIO).car.tyre_friction
    found = find_thresholds(cases, FRICTION_CLIMB, engine, starts=[start] * len(cases))
    rows = []
    for (tail, speed), one in zip(keys, found, strict=True):
        row = {"tail": tail.name, "speed_m_per_s": speed, "critical_friction": one.survived, "lost_at": one.lost}
        edge = {} if one.survived is None else one.rows[one.survived]
        row |= {name: edge.get(name) for name in ("peak_roll_rad", "heading_change_rad", "two_wheel_time_s")}
        row["runs_clean"] = sum(is_clean(run) for run in one.rows.values())
        rows.append(row)
    return make_frame(rows)


def plot_passivity(table: pd.DataFrame) -> Figure:
    """Critical friction over speed, one line per tail, the passive ones solid."""
    with styled():
        image, grid = new_figure(8.5, 5.2)
        axes = grid[0, 0]
        for look, (name, part) in zip(_STYLES, table.groupby("tail", sort=False), strict=True):
            colour, marker, line, size = look
            x, y = part["speed_m_per_s"], part["critical_friction"]
            axes.plot(x, y, marker=marker, markersize=size, linestyle=line, color=colour, label=name)
        axes.set_xlabel("speed of the turn [m/s]")
        axes.set_ylabel("critical friction [1]")
        image.legend(loc="outside upper center", ncols=4)
    return image


def write_passivity(table: pd.DataFrame, folder: Path) -> list[Path]:
    """`passivity.csv` and `passivity.png`; earlier ones are replaced."""
    return write_files(folder, {"passivity.csv": table, "passivity.png": png(plot_passivity(table))})
