"""Built-in studies: their runs can be made, their findings follow from the table, each writes a page."""

from functools import partial

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.studies import grip_study as critical_friction
from aerodima.optimisation.studies import mount_study as mount
from aerodima.optimisation.studies import shape_study as shapes
from aerodima.optimisation.studies import study_report as reading
from aerodima.optimisation.studies import survival_study as survival
from aerodima.optimisation.studies import turn_study as turn
from aerodima.optimisation.studies.shape_study import load_goals, mean_drag, published_goals
from aerodima.optimisation.studies.study_report import make_report
from aerodima.optimisation.sweep.study import Range, check_factors, plan_runs
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import UserError
from tests.optimisation.sweep.made_up_engine import MadeUpEngine

GOALS = published_goals()
STUDIES = {
    "turn": (turn.turn_study, turn.read_turn, 68),
    "tail": (critical_friction.tail_study, critical_friction.read_tail, 13 * 10),
    "mount": (mount.mount_study, mount.read_mount, 10 * 3),
    "shapes": (partial(shapes.shapes_study, GOALS), partial(shapes.read_shapes, GOALS), 10 * 10),
    "monte_carlo": (partial(survival.monte_carlo_study, 8, 1), survival.read_monte_carlo, 24),
}


@pytest.mark.parametrize("name", [*STUDIES, "trigger"])
def test_every_run_of_a_study_has_a_scenario_that_can_be_made(name):
    study = (critical_friction.trigger_study if name == "trigger" else STUDIES[name][0])()
    check_factors(study, name)
    runs = plan_runs(study)
    assert name == "trigger" or len(runs) == STUDIES[name][2]
    for run in runs[:: max(1, len(runs) // 26)]:
        load_scenario(run.task.scenario, list(run.task.settings))


@pytest.mark.parametrize("name", STUDIES)
def test_study_writes_table_findings_plots_and_page(tmp_path, name):
    make, read, number = STUDIES[name]
    page = make_report(make(), read, tmp_path, MadeUpEngine())
    assert len(pd.read_parquet(tmp_path / "table.parquet")) == number
    findings = pd.read_parquet(tmp_path / "findings.parquet")
    assert len(findings) == len(pd.read_csv(tmp_path / "findings.csv")) > 0
    text = page.read_text(encoding="utf-8")
    for picture in tmp_path.glob("*.png"):
        assert picture.stat().st_size > 5000
        assert f'src="{picture.name}"' in text
    assert list(tmp_path.glob("*.png"))


def test_critical_friction_of_each_case_is_between_survived_and_flipped(tmp_path):
    page = make_report(critical_friction.tail_study(), critical_friction.read_tail, tmp_path, MadeUpEngine())
    found = pd.read_parquet(page.parent / "findings.parquet").set_index("case")["critical_friction"]
    lost = 0.02 * (critical_friction.CASE_SPEED - 3.33)
    for case, limit in (("no tail", 0.62), ("tail held", 0.72), ("length 0.7 m", 0.82)):
        assert abs(found[case] - (limit - lost)) <= 0.025, case


def test_ensemble_gives_a_band_and_every_member_counts_by_its_weight(tmp_path):
    study = critical_friction.tail_study((), "car", 3)
    page = make_report(study, critical_friction.read_tail, tmp_path, MadeUpEngine())
    table = pd.read_parquet(tmp_path / "table.parquet")
    assert len(table) == 13 * 10 * table["member"].nunique()
    assert "members of the ensemble" in page.read_text(encoding="utf-8")


def test_survivors_beyond_the_first_flip_are_islands():
    frame = pd.DataFrame({"mu": [0.5, 0.6, 0.7, 0.8], "outcome": ["survived", "flipped", "survived", None]})
    step = reading.step_along(frame, "mu")
    assert (step.survived, step.flipped, step.islands) == (0.5, 0.6, (0.7,))
    assert step.words == "0.5 to 0.6; survives again at 0.7"


def test_a_run_that_tipped_over_before_its_turn_is_no_flip_of_the_threshold():
    speeds = {"speed_m_per_s": [3.0, 3.5, 4.0, 0.1], "commanded_speed_m_per_s": [3.0, 3.5, 4.0, 4.5]}
    frame = pd.DataFrame({"v": [3.0, 3.5, 4.0, 4.5], "outcome": ["survived"] * 3 + ["flipped"]} | speeds)
    step = reading.step_along(frame, "v")
    assert (step.survived, step.flipped, step.tipped) == (4.0, None, (4.5,))
    assert step.words == "no flip; tipped over before its turn at 4.5"
    assert reading.rollover_probability(frame).value == 0.25


def test_probability_has_the_exact_interval_of_its_effective_number():
    frame = pd.DataFrame({"outcome": ["flipped"] * 3 + ["survived"] * 17})
    found = reading.rollover_probability(frame)
    assert (found.value, found.runs, found.effective) == (pytest.approx(0.15), 20, pytest.approx(20.0))
    assert (found.low, found.high) == pytest.approx((0.0321, 0.3789), abs=1e-4)  # Clopper and Pearson, 3 of 20
    heavy = reading.rollover_probability(frame.assign(weight=[1.0] * 19 + [19.0]))
    assert heavy.effective == pytest.approx(38**2 / (19 + 361))
    assert heavy.high - heavy.low > found.high - found.low


def test_map_says_where_survival_is_not_monotone(tmp_path):
    axes = Range(first=3.0, last=5.0, number=3), Range(first=0.7, last=0.9, number=3)
    make_report(survival.survival_study("turn_swing", [], *axes), survival.read_survival, tmp_path, MadeUpEngine())
    assert "No row or column has survivors beyond" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_front_ballast_moves_the_centre_of_mass_by_the_lever_rule():
    car, heavier = (load_scenario("turn_swing", list(s)).car for s in ((), mount.ballast(1.0)))
    assert heavier.mass == pytest.approx(car.mass + 1.0)
    assert heavier.mass * heavier.com_x == pytest.approx(car.mass * car.com_x + 1.0 * 0.30)
    assert heavier.mass * heavier.com_height == pytest.approx(car.mass * car.com_height + 1.0 * 0.10)


def goals(folder, text):
    path = folder / "goals.csv"
    path.write_text(text)
    return path


def test_force_of_a_goal_becomes_a_coefficient_by_equation_5_1(tmp_path):
    text = "Shape,Speed [m/s],Angle,C_D,Drag_Force (N)\nplate,10,0,,0.6\nplate,10,30,1.5,\ntube,10,0,2.5,\n"
    table = load_goals(goals(tmp_path, text))
    assert table["c_d"].tolist() == pytest.approx([2 * 0.6 / (1.225 * 5e-3 * 100.0), 1.5, 2.5])
    assert mean_drag(table).to_dict() == pytest.approx({"tube": 2.5, "plate": 1.959}, abs=1e-3)
    assert list(mean_drag(table).index) == ["tube", "plate"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("shape,speed,angle\na,1,0\n", "neither c_d nor drag_force"),
        ("shape,speed,c_d\na,1,1\n", "column 'angle'"),
        ("shape,speed,angle,c_d,sped\na,1,0,1,1\n", "did you mean 'speed'"),
        ("shape,speed,angle,c_d\na,0,0,1\n", "row 1: speed 0 m/s; allowed: above 0"),
        ("shape,speed,angle,c_d\na,1,0,1\na,1,0,2\n", "row 2: a at 1 m/s and 0 degrees is there twice"),
        ("shape,speed,angle,c_d\na,1,0,x\n", "row 1: c_d 'x'; allowed: a number"),
        ("shape,speed,angle,c_d\na,1,0,\n", "row 1: has neither"),
        ("shape,speed,angle,c_d\n,1,0,1\n", "row 1: shape is empty"),
        ("shape,speed,angle,c_d\n", "holds no rows"),
    ],
)
def test_mistakes_in_a_goal_table_are_named(tmp_path, text, said):
    with pytest.raises(UserError) as raised:
        load_goals(goals(tmp_path, text))
    assert said in str(raised.value)


def test_a_car_that_tells_nothing_has_no_threshold_and_one_that_always_survives_a_bound():
    assert np.isnan(reading.Step(0.5, None, (), (0.55, 0.6)).middle(0.5, 0.95))
    assert np.isnan(reading.Step(None, None, ()).middle(0.5, 0.95))
    assert reading.Step(None, 0.5, ()).middle(0.5, 0.95) == 0.5
    assert reading.Step(0.95, None, ()).middle(0.5, 0.95) == 0.95


def test_runs_of_an_ensemble_are_worth_no_more_than_its_members():
    members = [name for name in "abcd" for _ in range(64)]
    frame = pd.DataFrame({"member": members, "weight": 0.25})
    frame["outcome"] = np.where(frame["member"] == "a", "flipped", "survived")
    found = reading.rollover_probability(frame)
    assert found.value == pytest.approx(0.25)
    assert found.effective == pytest.approx(4.0)
    assert found.high > 0.7
    with pytest.raises(UserError, match="made for one car"):
        mount.mount_study(ensemble="car")
