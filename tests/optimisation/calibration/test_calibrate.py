from pathlib import Path

import numpy as np
import pytest

from optimisation.calibration.calibrate import BASE_SCENARIO, Calibration, calibrate
from optimisation.calibration.output import ensemble_text, write_calibration
from optimisation.calibration.plan import CalibrationPlan, load_plan
from optimisation.calibration.runs import RunStore
from tests.optimisation.calibration.made_up_car import TAILLESS_GROUP, MadeUpEngine
from workbench.ensemble import load_ensemble
from workbench.errors import UserError
from workbench.scenario import load_scenario


def small_plan(**changes: object) -> CalibrationPlan:
    size = {"points": 24, "halvings": 5, "step": 0.004, "members": 72}
    plan = load_plan("car").model_dump(by_alias=True) | {"car_stage": size, "tail_stage": size} | changes
    return CalibrationPlan.model_validate(plan)


def carried_out(
    folder: Path, engine: MadeUpEngine, plan: CalibrationPlan | None = None
) -> tuple[Calibration, RunStore]:
    plan = plan or small_plan()
    store = RunStore(folder, load_scenario(BASE_SCENARIO), (*plan.car, *plan.tail))
    return calibrate(plan, store, engine, lambda line: None), store


def groups(result: Calibration) -> np.ndarray:
    values = [result.values[place] for place in result.kept]
    return np.array([2 * v["car.tyre_friction"] * v["car.com_height"] / v["car.track"] for v in values])


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    return carried_out(tmp_path_factory.mktemp("calibration"), MadeUpEngine())[0]


def test_every_member_lies_where_the_made_up_car_flips_between_the_two_speeds(result: Calibration) -> None:
    low, high = TAILLESS_GROUP - 0.1 * (3.61 - 3.47), TAILLESS_GROUP - 0.1 * (3.33 - 3.47)
    assert np.all((groups(result) > low) & (groups(result) <= high))
    assert result.tail.effective_size >= 32
    assert result.check.shares == pytest.approx((1.0, 1.0))


def test_the_metrics_pull_the_friction_below_its_prior(result: Calibration) -> None:
    friction = result.tail.prior.values(result.tail.members.coordinates)[
        :, result.tail.prior.keys.index("car.tyre_friction")
    ]
    plausible, density = result.car.prior.draw(4096, 3)
    before = np.average(result.car.prior.values(plausible)[:, 1], weights=np.exp(density))
    assert result.car.prior.keys[1] == "car.tyre_friction"
    assert result.tail.weights @ friction < before - 0.05


def test_a_larger_sail_saves_the_made_up_car_so_the_members_have_the_right_one(result: Calibration) -> None:
    assert result.tail.target.must_flip
    for place in result.kept:
        v = result.values[place]
        limit = 0.6 * (v["tail.sail_length"] * v["tail.sail_width"] - 0.05)
        group = 2 * v["car.tyre_friction"] * v["car.com_height"] / v["car.track"] - TAILLESS_GROUP
        assert limit - 0.3 * (4.72 - 4.58) < group <= limit - 0.3 * (4.44 - 4.58)


def test_same_seed_same_text_other_seed_other_cars(result: Calibration, tmp_path: Path) -> None:
    again, _ = carried_out(tmp_path / "again", MadeUpEngine())
    assert ensemble_text(again) == ensemble_text(result)
    other, _ = carried_out(tmp_path / "other", MadeUpEngine(), small_plan(seed=6))
    assert ensemble_text(other) != ensemble_text(result)


def test_an_interrupted_calibration_goes_on_and_runs_nothing_twice(result: Calibration, tmp_path: Path) -> None:
    stopped = MadeUpEngine(stop_after=100)
    with pytest.raises(KeyboardInterrupt):
        carried_out(tmp_path, stopped)
    with (tmp_path / "runs.jsonl").open("a") as stream:
        stream.write('{"run": "cut o')
    goes_on = MadeUpEngine()
    again, _ = carried_out(tmp_path, goes_on)
    assert goes_on.runs == result.runs - 100
    assert ensemble_text(again) == ensemble_text(result)


def test_runs_of_other_parameters_are_refused_unless_forced(tmp_path: Path) -> None:
    base = load_scenario(BASE_SCENARIO)
    RunStore(tmp_path, base, ["car.mass"])
    RunStore(tmp_path, load_scenario(BASE_SCENARIO, ["car.mass=7.0"]), ["car.mass"])
    other = load_scenario(BASE_SCENARIO, ["environment.gravity=3.7"])
    with pytest.raises(UserError, match="holds runs of other parameters"):
        RunStore(tmp_path, other, ["car.mass"])
    assert len(RunStore(tmp_path, other, ["car.mass"], force=True)) == 0


def test_a_tail_that_never_flips_is_held_to_the_survived_speed_alone(tmp_path: Path) -> None:
    class NeverFlipsWithTail(MadeUpEngine):
        def row(self, task: object) -> dict:
            row = super().row(task)
            return row | {"outcome": "survived"} if task.scenario == "turn_swing" else row

    result, _ = carried_out(tmp_path, NeverFlipsWithTail())
    assert not result.tail.target.must_flip
    assert result.check.shares == pytest.approx((1.0, 1.0))
    assert "flips at 4.72" not in ensemble_text(result)


def test_tipping_over_before_the_turn_is_no_flip_in_the_turn(tmp_path: Path) -> None:
    class TipsOverBackwards(MadeUpEngine):
        def row(self, task: object) -> dict:
            row = super().row(task)
            tipped = task.scenario == "turn_swing" and row["commanded_speed_m_per_s"] > 4.6
            return row | {"outcome": "flipped", "speed_m_per_s": 0.5} if tipped else row

    result, _ = carried_out(tmp_path, TipsOverBackwards())
    assert not result.tail.target.must_flip


def test_everything_is_written_and_the_ensemble_reads_back(tmp_path: Path) -> None:
    engine = MadeUpEngine()
    result, store = carried_out(tmp_path, engine)
    page = write_calibration(result, tmp_path, store, engine, lambda line: None)
    ensemble = load_ensemble(tmp_path / "car.yaml")
    assert len(ensemble.members) == len(result.kept)
    assert ensemble.best.values == result.values[result.best]
    np.testing.assert_allclose(ensemble.weights, result.tail.weights[result.kept], atol=1e-5)
    text = page.read_text()
    for said in ("Table 7.4", "not identifiable", "log car.tyre_friction", "effective", "survives 3.33 m/s"):
        assert said.lower() in text.lower()
    names = {"validation.csv", "sensitivities.csv", "parameters.csv", "directions.csv", "members.parquet"}
    assert names <= {path.name for path in tmp_path.iterdir()}
    assert len((tmp_path / "validation.csv").read_text().splitlines()) == 33
