"""The search: wrong input ends in one line before anything is simulated; swing files are what was found."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from aerodima.optimisation.swing.search_state import LIMIT_REACHED, SearchOptions, SwingSearch, swing_of_rounds
from aerodima.optimisation.swing.solver import solve
from aerodima.optimisation.swing.swing_construction import RAMP, constant_rate_swing, swing_file
from aerodima.optimisation.swing.swing_problem import ANGLE, random_start
from aerodima.optimisation.swing.swing_search import optimise_swing
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.swing_curve import swing_at
from aerodima.workbench.config.swing_file import SwingFile, read_swing, write_swing
from aerodima.workbench.errors import SwingError, SwingFileError
from tests.optimisation.swing.turn import problem


@cache
def found(direction: str = "left") -> SwingFile:
    posed = problem(knots=21)
    solution = solve(posed, random_start(posed, np.random.default_rng(0)))
    assert solution.success
    scenario = load_scenario("turn_swing", [f"manoeuvre.direction={direction}", "controller.trigger_yaw_rate=0.5"])
    return swing_file("found", posed, solution, scenario, provenance={"source": "test", "seed": 1})


def test_a_swing_file_holds_the_found_motion_and_is_mirrored_for_a_right_turn(tmp_path: Path) -> None:
    left, right = found(), found("right")
    read = read_swing(write_swing(left, tmp_path / "swing.yaml"))
    assert read == left
    assert left.knots.roll_position_rad[0] == pytest.approx(-np.pi / 2 * ANGLE)
    assert right.knots.roll_position_rad == pytest.approx([-angle for angle in left.knots.roll_position_rad])
    assert right.knots.roll_torque_n_m == pytest.approx([-torque for torque in left.knots.roll_torque_n_m or ()])
    assert swing_at(left, 5.0).roll_velocity == 0.0
    assert left.car["car.com_height"] == load_scenario("turn_swing").car.com_height


@pytest.mark.parametrize(
    ("settings", "options", "words"),
    [
        (["tail.sail=free"], {}, "tail.sail"),
        (["tail.mode=none"], {}, "the car has no tail to swing"),
        (["manoeuvre.kind=straight"], {}, "manoeuvre.kind"),
        ([], {"torque": 0.0}, "torque limit: 0 N m"),
        ([], {"dof": 3}, "--dof: 3; allowed: 1, 2"),
        ([], {"rounds": 0}, "--rounds: 0; allowed: from 1 on"),
    ],
)
def test_wrong_input_is_refused_before_the_first_run(settings: list[str], options: dict, words: str) -> None:
    with pytest.raises(SwingError, match=words):
        optimise_swing(load_scenario("turn_swing", settings), SearchOptions(**options), name="x")


def even(*settings: str, length: float = 1.0) -> SwingFile:
    scenario = load_scenario("turn_swing", ["controller.trigger_yaw_rate=0.7", *settings])
    return constant_rate_swing("even", scenario, length=length, knots=41, provenance={"source": "test"})


def test_an_constant_rate_swing_goes_from_side_to_side_at_its_rate() -> None:
    swing = even("controller.swing_speed=7.0")
    time = np.linspace(0.0, 1.0, 400)
    point = swing_at(swing, time)
    assert point.roll_position[0] == pytest.approx(-np.pi / 2)
    assert point.roll_position[-1] == pytest.approx(np.pi / 2)
    assert np.all(np.diff(point.roll_position) >= -1e-3)
    assert swing_at(swing, 0.25).roll_velocity == pytest.approx(7.0, abs=1e-6)
    assert swing_at(swing, 0.25).roll_position == pytest.approx(-np.pi / 2 + 7.0 * (0.25 - RAMP / 2), abs=1e-6)
    assert swing.trigger.threshold_rad_per_s == 0.7
    right = even("controller.swing_speed=7.0", "manoeuvre.direction=right")
    assert right.knots.roll_position_rad == pytest.approx([-angle for angle in swing.knots.roll_position_rad])


@pytest.mark.parametrize(("rate", "length"), [("3.0", 1.0), ("7.0", 0.4), ("40.0", 1.0)])
def test_an_constant_rate_swing_that_cannot_arrive_or_asks_too_much_of_the_motor_is_refused(
    rate: str, length: float
) -> None:
    with pytest.raises(SwingError, match=rf"controller\.swing_speed: {float(rate):g} rad/s; allowed .* rad/s"):
        even(f"controller.swing_speed={rate}", length=length)


def test_a_warm_start_for_another_car_says_which_parameters_differ() -> None:
    scenario = load_scenario("turn_swing", ["car.com_height=0.21", "tail.length=0.8"])
    warm_start = found()
    made_for = warm_start.car["car.com_height"]
    assert made_for != 0.21
    words = rf"made for another car: car\.com_height: made for {made_for:g}, the scenario has 0\.21; .*the same car$"
    with pytest.raises(SwingFileError, match=words):
        optimise_swing(scenario, SearchOptions(), name="x", warm_start=warm_start)


@pytest.mark.parametrize(
    ("state", "limit"),
    [({}, "4 rounds"), ({"rounds": 2}, "wall time of 600 s"), ({"stalled": 1}, None), ({"finished": True}, None)],
)
def test_a_search_that_stops_while_it_gains_says_which_limit_stopped_it(state: dict[str, float], limit: str) -> None:
    search = SwingSearch(**({"friction": 0.6, "speed": 4.5, "swing": found(), "rounds": 4} | state))
    swing = swing_of_rounds(search, SearchOptions())
    assert swing.provenance.found.get(LIMIT_REACHED) == limit
    assert swing.knots == found().knots


@pytest.mark.parametrize("text", ["{}", '{"key": "x"}'])
def test_a_checkpoint_of_something_else_is_refused(tmp_path: Path, text: str) -> None:
    checkpoint = tmp_path / "swing.search.json"
    checkpoint.write_text(text, encoding="utf-8")
    with pytest.raises(SwingError, match="holds results of other parameters, settings"):
        optimise_swing(load_scenario("turn_swing"), SearchOptions(), name="x", checkpoint=checkpoint)


@pytest.mark.parametrize("flag", [["--objective", "fame"], ["--solver", "magic"], ["--dof", "3"]])
def test_a_wrong_flag_is_one_line_and_status_2(tmp_path: Path, flag: list[str]) -> None:
    arguments = ["optimise", "swing", "turn_swing", "--out", str(tmp_path / "x.yaml"), *flag]
    result = CliRunner().invoke(build_app(), arguments)
    assert result.exit_code == 2
    assert result.output.startswith(f"error: {flag[0]}")
    assert result.output.count("\n") == 1


def test_an_existing_swing_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text("mine", encoding="utf-8")
    result = CliRunner().invoke(build_app(), ["optimise", "swing", "turn_swing", "--out", str(path)])
    assert result.exit_code == 2
    assert path.read_text(encoding="utf-8") == "mine"


def test_a_folder_that_cannot_be_written_is_named_before_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(**_options: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    result = CliRunner().invoke(build_app(), ["optimise", "swing", "turn_swing", "--out", str(tmp_path / "x.yaml")])
    assert result.exit_code == 2
    assert result.output == f"error: {tmp_path}: cannot be written (Read-only file system); allowed: another --out\n"
