"""The leaderboard on made-up cars: runs come out by a formula, so that every table has a known answer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from aerodima.optimisation.studies.contestants import Plan, swing_player, swing_players
from aerodima.optimisation.studies.leaderboard import make_leaderboard
from aerodima.optimisation.studies.leaderboard_page import PAGE
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED, Case, Search, find_thresholds
from aerodima.optimisation.sweep.study_engine import RunTask, run_key
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.swing_file import read_swing, write_swing
from aerodima.workbench.errors import UserError
from aerodima.workbench.resources import model_path

SWING = "thesis_8_rad_per_s"
CRITICAL = {"none": 0.6, "held": 0.7, "4.0": 0.74, "6.0": 0.78, "8.0": 0.72, SWING: 0.9}
"""Critical friction at 4.5 m/s by controller; the last by swing file. Clean is 0.05 less, and 0.02 at the fine step."""
OWN_FRICTION = load_scenario("turn_fast").car.tyre_friction
MEMBERS = (Member("likely", 0.75, {"car.mass": 6.0}), Member("unlikely", 0.25, {"car.mass": 5.0}))
PLAN = Plan(
    speeds=(3.6, 4.5),
    friction=Search(FRICTION, 0.3, 1.0, 0.1, 0.01),
    fine=Search(FRICTION, 0.3, 1.0, 0.02, 0.01),
    near=Search(FRICTION, 0.3, 1.0, 0.01, 0.01),
    robust=Search(FRICTION, 0.3, 1.0, 0.05, 0.01),
    top_speed=Search(SPEED, 3.0, 6.0, 1.0, 0.25),
    grip=1.0,
    map_speeds=(3.6, 4.5),
    map_strides=(0, 2),
    fixed=(4.0, 6.0),
    releases=(1.0,),
)


class MadeUp:
    """A car flips beyond a friction that falls with its speed; the tail touches the ground 0.05 below that.

    6 rad/s turns less than the rule asks for, 4 rad/s far enough.
    """

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
        critical -= 0.1 if given.get("car.mass") == "5.0" else 0.0
        critical -= 0.02 if given["simulation.step"] == "0.0005" else 0.0
        critical *= (float(given.get("environment.air_density", 1.225)) / 1.225) ** 0.1
        friction = float(given.get(FRICTION, OWN_FRICTION))
        turned = 0.5 * friction * (0.9 if mode == "held" or kind == "6.0" else 1.0)
        return {
            "outcome": "survived" if friction <= critical else "flipped", "clean": friction <= critical - 0.05 + 1e-9,
            "error": "", "heading_change_rad": turned, "peak_roll_rad": 0.1, "tail_energy_j": 5.0,
            "average_yaw_rate_rad_per_s": 2.0, "tail_torque_peak_n_m": 10.0, "two_wheel_time_s": 0.2,
        }  # fmt: skip


def test_every_table_has_its_known_answer(tmp_path: Path) -> None:
    board, files = make_leaderboard(tmp_path, PLAN, [SWING], MEMBERS, MadeUp(), replays=False)
    names = [contestant.name for contestant in board.contestants]
    assert names == ["no tail", "held", "thesis, 8 rad/s", "best fixed speed (4 @ 1)", SWING]
    claims = board.claims.set_index(["controller", "speed_m_per_s"])
    summary = pd.read_csv(tmp_path / "summary.csv").set_index("controller")
    for name, key in zip(names, ("none", "held", "8.0", "4.0", SWING), strict=True):
        assert claims.loc[(name, 4.5), "critical_friction"] == pytest.approx(CRITICAL[key] - 0.07), "of the own car"
        found = summary.loc[name, "critical_friction_at_4.5_m_per_s"]
        assert found == pytest.approx(CRITICAL[key] - 0.05), "of the likely car"
    assert claims.loc[(SWING, 4.5), "gain_over_8_rad_per_s"] == pytest.approx(0.83 / 0.65 - 1)
    assert summary.loc[SWING, "gain_over_8_rad_per_s"] == pytest.approx(0.85 / 0.67 - 1, abs=0.05)
    assert summary.loc[SWING, "gain_over_best_fixed_speed"] == pytest.approx(0.85 / 0.69 - 1, abs=0.05)
    assert summary.loc["no tail", "share_no_worse_than_8_rad_per_s"] == 0.0
    assert summary.loc[SWING, "share_no_worse_than_8_rad_per_s"] == 1.0
    assert summary.loc["held", "heading_ratio_median"] == pytest.approx(0.9)
    assert summary.loc["held", "share_heading_at_least_95_percent"] == 0.0
    assert summary.loc["held", "gain_over_8_rad_per_s"] < 0.0
    assert (summary.loc["held", "share_faster_turn"], summary.loc[SWING, "share_faster_turn"]) == (0.0, 1.0)
    assert set(board.frictions["two_wheel_time_with_8_rad_per_s_s"].dropna()) == {0.2}
    robust = board.robustness.set_index(["controller", "change"])["critical_friction"]
    assert robust[SWING, "C_N -30 %"] < robust[SWING, "as planned"] < robust[SWING, "C_N +30 %"]
    there = board.map.set_index(["controller", "speed_m_per_s", "friction"])["outcome"]
    first, last = (PLAN.friction.value(PLAN.friction.index(OWN_FRICTION) + count) for count in (0, 20))
    assert (there[SWING, 3.6, first], there["no tail", 4.5, last]) == ("survived", "flipped")
    page = (tmp_path / PAGE).read_text()
    assert page.count("data:image/png") == 3
    assert SWING in page
    assert {path.name for path in files} >= {"claims.csv", "summary.csv", "frictions.csv", "robustness.csv", PAGE}


def test_a_car_that_spins_with_the_published_swing_is_named(tmp_path: Path) -> None:
    class Spinning(MadeUp):
        """The light car spins, with the published swing alone."""

        @staticmethod
        def _row(task: RunTask) -> dict[str, Any]:
            row = MadeUp._row(task)
            if "car.mass=5.0" in task.settings and "controller.swing_speed=8.0" in task.settings:
                row["heading_change_rad"] += 2.0
            return row

    plan = replace(PLAN, perturbed=False)
    board, _ = make_leaderboard(tmp_path, plan, [SWING], MEMBERS, Spinning(), replays=False)
    for row in board.frictions.to_dict("records"):
        spins = row["member"] == MEMBERS[1].name
        assert row["spins_with_8_rad_per_s"] == spins
    summary = pd.read_csv(tmp_path / "summary.csv").set_index("controller")
    assert summary.loc[SWING, "share_that_spins_with_8_rad_per_s"] == pytest.approx(MEMBERS[1].weight)


def test_swings_of_one_kind_are_one_controller_that_plays_the_nearest(tmp_path: Path) -> None:
    thesis = read_swing(model_path(f"swings/{SWING}.yaml"))
    paths = []
    for speed in (3.6, 6.0):
        found = {"survived_speed_m_per_s": speed, "heading_ratio": 0.96}
        made = thesis.provenance.model_copy(update={"options": {"dof": 2}, "found": found})
        swing = thesis.model_copy(update={"name": f"made_{speed:g}", "provenance": made})
        paths.append(str(write_swing(swing, tmp_path / f"made_{speed:g}.yaml")))
    (kind,) = swing_players(paths)
    assert kind.name == "optimised roll and pitch"
    assert [kind.made_for(speed) for speed in (3.6, 4.5, 6.0)] == [True, False, True]
    for speed, path in ((3.6, paths[0]), (4.5, paths[0]), (5.5, paths[1]), (8.0, paths[1])):
        assert f"controller.swing_file={path}" in kind.at(speed)


@pytest.mark.parametrize(
    ("clean_below", "start", "survived", "lost"),
    [(0.72, 0.6, 0.72, 0.73), (0.72, 0.9, 0.72, 0.73), (2.0, 0.6, 1.0, None), (0.1, 0.6, None, 0.3)],
)
def test_a_climb_ends_at_the_first_loss(
    clean_below: float, start: float, survived: float | None, lost: float | None
) -> None:
    class Island(MadeUp):
        """Survives again above 0.86."""

        @staticmethod
        def _row(task: RunTask) -> dict[str, Any]:
            friction = float(task.settings[-1].partition("=")[2])
            clean = friction <= clean_below + 1e-9 or (clean_below == 0.72 and friction > 0.955)
            return {"outcome": "survived" if clean else "flipped", "clean": clean}

    (found,) = find_thresholds([Case("", "turn_fast")], PLAN.friction, Island(), starts=[start])
    assert found.survived == (None if survived is None else pytest.approx(survived))
    assert found.lost == (None if lost is None else pytest.approx(lost))


def test_stopped_it_goes_on_and_a_wider_plan_keeps_the_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = replace(PLAN, perturbed=False)
    with pytest.raises(KeyboardInterrupt):
        make_leaderboard(tmp_path, narrow, [SWING], MEMBERS[:1], MadeUp(stop_after=70), replays=False)
    second = MadeUp()
    make_leaderboard(tmp_path, narrow, [SWING], MEMBERS[:1], second, replays=False)
    whole = MadeUp()
    make_leaderboard(tmp_path / "other", narrow, [SWING], MEMBERS[:1], whole, replays=False)
    assert {run_key(task) for task in second.tasks} < {run_key(task) for task in whole.tasks}
    assert len(second.tasks) == len(whole.tasks) - 70
    first = (tmp_path / "summary.csv").read_text()
    assert first == (tmp_path / "other" / "summary.csv").read_text()
    wider = MadeUp()
    make_leaderboard(tmp_path, PLAN, [SWING], MEMBERS, wider, replays=False)
    assert not {run_key(task) for task in wider.tasks} & {run_key(task) for task in whole.tasks}
    fewer = MadeUp()
    make_leaderboard(tmp_path, narrow, [], MEMBERS, fewer, replays=False)
    assert not fewer.tasks, "a swing less asks for no new runs"
    monkeypatch.setattr("aerodima.optimisation.studies.leaderboard.default_values", lambda: {"car": {"mass": 7.0}})
    with pytest.raises(UserError, match="holds results of other parameters"):
        make_leaderboard(tmp_path, narrow, [SWING], MEMBERS, MadeUp(), replays=False)


def test_another_swing_of_the_same_name_is_another_run(tmp_path: Path) -> None:
    thesis = read_swing(model_path(f"swings/{SWING}.yaml"))
    keys = []
    for number, limit in enumerate((8.0, 9.0)):
        limits = thesis.limits.model_copy(update={"velocity_rad_per_s": limit})
        path = write_swing(thesis.model_copy(update={"limits": limits}), tmp_path / f"{number}.yaml")
        keys.append(run_key(RunTask("", "turn_fast", (f"controller.swing_file={path}",))))
    assert keys[0] != keys[1]
    plain = RunTask("one", "turn_fast", ("controller.swing_file=none",))
    assert run_key(plain) == run_key(replace(plain, name="other"))


def test_a_swing_that_is_not_there_or_is_for_another_car_is_refused(tmp_path: Path) -> None:
    other = read_swing(model_path(f"swings/{SWING}.yaml")).model_copy(update={"car": {"car.mass": 6.5}})
    path = str(write_swing(other, tmp_path / "other.yaml"))
    with pytest.raises(UserError, match=r"made for another car: car\.mass: made for 6\.5, .*allowed: the same car$"):
        make_leaderboard(tmp_path / "board", PLAN, [path], (), MadeUp(), replays=False)
    with pytest.raises(UserError, match="none of this name"):
        swing_player("nowhere")
