"""When the swing should begin: signal, delay and travel (thesis 6.3.4), and what the signals look like in a turn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation.studies.grip_study import Setup, friction_study, read_friction
from aerodima.optimisation.studies.study_report import Findings
from aerodima.optimisation.sweep.study import Study
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import WHEELS
from aerodima.workbench.figures.figure_style import BLACK, BLUE, GREY, VERMILION, new_figure, shade_turn, styled
from aerodima.workbench.metrics.published_figures import flip_bracket
from aerodima.workbench.report.report_page import Plot


def _setup(**controller: float | str) -> Setup:
    return Setup("turn_swing", tuple(f"controller.{name}={value}" for name, value in controller.items()))


SETUPS: dict[str, Setup] = {
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
    return friction_study("Trigger: signal, delay and travel", SETUPS, settings, ensemble, members)


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
    picture = Plot(_signals_figure(log), caption, "Yaw rate and wheel load over time in a turn", "signals")
    return read_friction(frame, SETUPS, sentences, (picture,))


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
