"""The studies of `models/studies`: their runs can be made, and their cars are what their texts
say.
"""

import pytest

from aerodima.optimisation.studies.runs import load_any_scenario
from aerodima.optimisation.studies.study import load_study, plan_runs
from aerodima.workbench.core.yaml_files import shipped_names
from aerodima.workbench.scenario.scenario import load_scenario

RUNS = {
    "turn": 68,
    "tail": 13 * 10,
    "mount": 10 * 3,
    "trigger": 13 * 10,
    "shapes": 10 * 10,
    "monte_carlo": 3 * 32,
}
RUNS |= {"survival": 7 * 9}
# 3 tails x 2 axes x 6 angles x 3 speeds x 5; 30 swings of the robot's tail
RUNS |= {"static_holds": 540, "robot_swings": 30, "bar_swings": 120, "flicks": 120}


def test_every_shipped_study_is_held_here():
    assert set(shipped_names("studies")) == set(RUNS)


@pytest.mark.parametrize("name", RUNS)
def test_every_run_has_a_scenario_that_can_be_made(name):
    study = load_study(name)
    runs = plan_runs(study)
    assert len(runs) == RUNS[name]
    for run in runs[:: max(1, len(runs) // 26)]:
        load_any_scenario(run.task.scenario, run.task.settings)
    if study.logs:
        settings = {setting for run in runs for setting in run.task.settings}
        seeds = [setting for setting in settings if setting.startswith("seed=")]
        assert len(seeds) == len(runs), "a log has noise of its own"


@pytest.mark.parametrize("mass", [0.5, 1.0])
def test_front_ballast_moves_the_centre_of_mass_by_the_lever_rule(mass):
    blocks = {block.name: block for block in load_study("mount").blocks}
    block = blocks[f"ballast {mass:g} kg"]
    car, heavier = (load_scenario("turn_swing", settings).car for settings in ((), block.settings))
    assert heavier.mass == pytest.approx(car.mass + mass)
    for key, place in (("com_x", 0.30), ("com_height", 0.10)):
        expected = (car.mass * getattr(car, key) + mass * place) / heavier.mass
        # The file gives places to 0.1 mm.
        assert getattr(heavier, key) == pytest.approx(expected, abs=5e-5)
