"""The leaderboard on made-up cars: runs come out by a formula, so that every table has a known answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from optimisation.leaderboard.contestants import swing_player
from optimisation.leaderboard.make import make_leaderboard
from optimisation.leaderboard.measure import Plan
from optimisation.leaderboard.memory import task_key
from optimisation.leaderboard.page import PAGE
from optimisation.sweep.task import RunTask
from optimisation.sweep.threshold import FRICTION, SPEED, Search
from workbench.ensemble import Member
from workbench.errors import UserError

SWING = "thesis_8_rad_per_s"
CRITICAL = {"none": 0.6, "held": 0.7, "4.0": 0.74, "6.0": 0.78, "8.0": 0.72, SWING: 0.9}
"""Critical friction at 4.5 m/s by controller; the last by swing file."""
MEMBERS = (Member("likely", 0.75, {"car.mass": 6.0}), Member("unlikely", 0.25, {"car.mass": 5.0}))
PLAN = Plan(
    speeds=(3.6, 4.5),
    friction=Search(FRICTION, 0.4, 1.0, 0.1, 0.02),
    top_speed=Search(SPEED, 3.0, 6.0, 1.0, 0.25),
    map_speeds=(3.6, 4.5),
    map_frictions=(0.6, 0.8),
    fixed=(4.0, 6.0),
)


class MadeUp:
    """A car flips beyond a friction that falls with its speed; the tail touches the ground 0.05 below that."""

    workers, startup = 1, 0.0

    def __init__(self, stop_after: int | None = None) -> None:
        self.tasks: list[RunTask] = []
        self._stop_after = stop_after

    def rows(self, tasks: Sequence[RunTask], done: Any = None) -> list[dict[str, Any]]:
        rows = []
        for place, task in enumerate(tasks):
            if self._stop_after is not None and len(self.tasks) >= self._stop_after:
                raise KeyboardInterrupt
            self.tasks.append(task)
            rows.append(self._row(task))
            if done is not None:
                done(place, rows[-1])
        return rows

    def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
        return [function(item) for item in items]

    @staticmethod
    def _row(task: RunTask) -> dict[str, Any]:
        given = dict(setting.partition("=")[::2] for setting in task.settings)
        mode, swing = given["tail.mode"], given.get("controller.swing_file", "none")
        kind = mode if mode != "swing" else swing if swing != "none" else given["controller.swing_speed"]
        critical = CRITICAL[kind] - 0.1 * (float(given.get(SPEED, 3.33)) - 4.5)
        critical -= 0.1 if given["car.mass"] == "5.0" else 0.0
        critical *= (float(given.get("environment.air_density", 1.225)) / 1.225) ** 0.1
        friction = float(given.get(FRICTION, 0.6))
        turned = 0.5 * friction * (0.9 if mode == "held" else 1.0)
        return {
            "outcome": "survived" if friction <= critical else "flipped", "clean": friction <= critical - 0.05,
            "error": "", "heading_change_rad": turned, "peak_roll_rad": 0.1, "tail_energy_j": 5.0,
            "average_yaw_rate_rad_per_s": 2.0, "tail_torque_peak_n_m": 10.0, "two_wheel_time_s": 0.2,
        }  # fmt: skip


def test_every_table_has_its_known_answer(tmp_path: Path) -> None:
    board, files = make_leaderboard(tmp_path, PLAN, [SWING], MEMBERS, MadeUp(), replays=False)
    names = [contestant.name for contestant in board.contestants]
    assert names == ["no tail", "held", "thesis, 8 rad/s", "best fixed, 6 rad/s", SWING]
    summary = board.summary.set_index("controller")
    for name, key in zip(names, ("none", "held", "8.0", "6.0", SWING), strict=True):
        found = summary.loc[name, "critical_friction_at_4.5_m_per_s"]
        assert CRITICAL[key] - 0.05 - 0.02 <= found <= CRITICAL[key] - 0.05, "clean, of the likely car"
    assert summary.loc[SWING, "gain_over_8_rad_per_s"] == pytest.approx(0.85 / 0.67 - 1, abs=0.05)
    assert summary.loc["no tail", "share_no_worse_than_8_rad_per_s"] == 0.0
    assert summary.loc[SWING, "share_no_worse_than_8_rad_per_s"] == 1.0
    assert summary.loc["held", "heading_ratio_median"] == pytest.approx(0.9)
    assert summary.loc["held", "share_heading_at_least_95_percent"] == 0.0
    assert summary.loc["held", "gain_over_8_rad_per_s"] < 0.0
    assert (summary.loc["held", "share_faster_turn"], summary.loc[SWING, "share_faster_turn"]) == (0.0, 1.0)
    assert set(board.frictions["two_wheel_time_with_8_rad_per_s_s"].dropna()) == {0.2}
    assert summary.loc["no tail", "rollover_probability_at_4.5_m_per_s"] == pytest.approx(0.25), "the unlikely car"
    assert summary.loc[SWING, "rollover_probability_at_4.5_m_per_s"] == 0.0
    robust = board.robustness.set_index(["controller", "change"])["critical_friction"]
    assert robust[SWING, "C_N -30 %"] < robust[SWING, "as planned"] < robust[SWING, "C_N +30 %"]
    assert (f"{SWING} (joint pd)", "as planned") in robust.index
    there = board.map.set_index(["controller", "speed_m_per_s", "friction"])["outcome"]
    assert (there["no tail", 3.6, 0.6], there["no tail", 4.5, 0.8]) == ("survived", "flipped")
    page = (tmp_path / PAGE).read_text()
    assert page.count("data:image/png") == 2
    assert SWING in page
    assert {path.name for path in files} >= {"summary.csv", "frictions.csv", "map.csv", "robustness.csv", PAGE}


def test_stopped_it_goes_on_and_a_wider_plan_keeps_the_runs(tmp_path: Path) -> None:
    narrow = replace(PLAN, perturbed=False)
    with pytest.raises(KeyboardInterrupt):
        make_leaderboard(tmp_path, narrow, [SWING], MEMBERS[:1], MadeUp(stop_after=70), replays=False)
    second = MadeUp()
    make_leaderboard(tmp_path, narrow, [SWING], MEMBERS[:1], second, replays=False)
    whole = MadeUp()
    make_leaderboard(tmp_path / "other", narrow, [SWING], MEMBERS[:1], whole, replays=False)
    assert {task_key(task) for task in second.tasks} < {task_key(task) for task in whole.tasks}
    assert len(second.tasks) == len(whole.tasks) - 70
    first = (tmp_path / "summary.csv").read_text()
    assert first == (tmp_path / "other" / "summary.csv").read_text()
    wider = MadeUp()
    make_leaderboard(tmp_path, PLAN, [SWING], MEMBERS, wider, replays=False)
    assert not {task_key(task) for task in wider.tasks} & {task_key(task) for task in whole.tasks}
    with pytest.raises(UserError, match="holds results of another study"):
        make_leaderboard(tmp_path, narrow, [], MEMBERS, MadeUp(), replays=False)


def test_a_swing_that_is_not_there_is_refused() -> None:
    with pytest.raises(UserError, match="does not exist"):
        swing_player("nowhere")
