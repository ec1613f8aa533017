from pathlib import Path

import numpy as np
import pytest

from optimisation.calibration.calibrate import BASE_SCENARIO, ENOUGH, Calibration, calibrate
from optimisation.calibration.design import Design, Runner, critical_groups, run_through
from optimisation.calibration.edge import Edge
from optimisation.calibration.output import ensemble_text, write_calibration
from optimisation.calibration.plan import CalibrationPlan, load_plan
from optimisation.calibration.runs import RunStore, car_values
from optimisation.calibration.shipped import shipped_car
from optimisation.calibration.tails import TailResult, add_tails
from optimisation.calibration.weights import log_likelihood, normalised
from optimisation.sweep.task import RunTask
from tests.optimisation.calibration.made_up_car import TAILLESS_GROUP, MadeUpEngine
from workbench.ensemble import load_ensemble
from workbench.errors import UserError
from workbench.scenario import load_scenario

LOW, HIGH = TAILLESS_GROUP - 0.1 * (3.61 - 3.47), TAILLESS_GROUP - 0.1 * (3.33 - 3.47)


def quiet(line: str) -> None:
    """Says nothing."""


def small_plan(**changes: object) -> CalibrationPlan:
    rounds = [{"cars": 16, "pilots": [4, 2]}, {"cars": 72, "pilots": [3, 2]}]
    size = {"points": 12, "pilots": [6, 3], "step": 0.004, "rounds": rounds}
    plan = load_plan("car").model_dump(by_alias=True) | {"car_stage": size, "tail_stage": {"tails": 4}} | changes
    return CalibrationPlan.model_validate(plan)


def store_in(folder: Path) -> RunStore:
    plan = small_plan()
    return RunStore(folder, load_scenario(BASE_SCENARIO), (*plan.car, *plan.tail))


def carried_out(folder: Path, engine: MadeUpEngine, plan: CalibrationPlan | None = None) -> Calibration:
    return calibrate(plan or small_plan(), store_in(folder), engine, quiet)


def groups(values: list[dict]) -> np.ndarray:
    return np.array([2 * v["car.tyre_friction"] * v["car.com_height"] / v["car.track"] for v in values])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def result(folder: Path) -> Calibration:
    return carried_out(folder, MadeUpEngine())


def test_every_member_lies_where_the_made_up_car_flips_between_the_two_speeds(result: Calibration) -> None:
    found = groups([result.values[place] for place in result.kept])
    assert np.all((found > LOW) & (found <= HIGH))
    assert result.car.effective_size >= ENOUGH
    assert result.check.tailless_share == pytest.approx(1.0)
    assert result.check.tailed_share == pytest.approx(1.0)


def test_the_weights_are_those_of_the_posterior_that_a_million_runs_would_find(result: Calibration) -> None:
    prior, target = result.car.prior, result.car.target
    scale = prior.plausible.highest_group.value - prior.plausible.lowest_group.value
    ends = [(group - prior.plausible.lowest_group.value) / scale for group in (LOW, HIGH)]
    points, density = prior.draw(2**13, 9, window=lambda p: (np.full(len(p), ends[0]), np.full(len(p), ends[1])))
    values = prior.values(points)
    engine = MadeUpEngine()
    rows = [
        engine.row(RunTask("", "turn_none", (*(f"{k}={v}" for k, v in car.items()), "manoeuvre.speed=3.33")))
        for car in car_values(prior.keys, values)
    ]
    metrics = {name: np.array([row[name] for row in rows]) for name in target.discrepancy}
    exact = normalised(density + log_likelihood(metrics, target.published, target.discrepancy))
    for key in ("car.tyre_friction", "car.com_height", "car.mass"):
        column = prior.keys.index(key)
        mean = exact @ values[:, column]
        error = np.sqrt(exact @ (values[:, column] - mean) ** 2 / result.car.effective_size)
        ours = result.car.weights @ prior.values(result.car.members.coordinates)[:, column]
        assert abs(ours - mean) < 3.0 * error, key


def searched(result: Calibration, folder: Path, engine: MadeUpEngine, pilots: tuple[int, int]) -> Design:
    prior = result.car.prior
    edge = (HIGH + 0.03 - prior.plausible.lowest_group.value) / prior.group_scale
    beyond = np.full(len(result.car.members.coordinates), edge)
    plausible = np.isfinite(prior.log_density_at(result.car.members.coordinates, beyond))
    cars = result.car.members.coordinates[plausible][:4]
    assert len(cars) == 4
    guess = Edge.around(prior.coordinates(prior.values(cars))[:, prior.leading] + 0.05, np.full(4, 0.1))
    runner = Runner(store_in(folder), engine, quiet)
    return critical_groups(result.car.target, prior, cars, (guess, np.full(4, 0.02)), pilots, None, runner)


def test_windows_hold_the_bracket_of_the_made_up_car_and_little_more(result: Calibration, tmp_path: Path) -> None:
    engine = MadeUpEngine()
    design = searched(result, tmp_path, engine, (5, 3))
    low, high = result.car.prior.group(design.windows).T
    assert np.all((low < LOW) & (low > LOW - 0.015))
    assert np.all((high > HIGH) & (high < HIGH + 0.015))
    assert engine.runs <= 4 * 8


def test_what_pilots_say_of_the_critical_group_is_right_within_what_they_claim(
    result: Calibration, tmp_path: Path
) -> None:
    rough = searched(result, tmp_path / "rough", MadeUpEngine(), (1, 1))
    sharp = searched(result, tmp_path / "sharp", MadeUpEngine(), (5, 3))
    truth = (np.array([HIGH, LOW]) - result.car.prior.group(np.zeros(1))) / result.car.prior.group_scale
    for design in (rough, sharp):
        assert np.all(np.abs(design.edges - truth) < 3.5 * design.deviations)
    assert np.all(sharp.deviations < rough.deviations)


def test_a_car_that_cannot_be_plausible_where_it_flips_takes_no_run(result: Calibration, tmp_path: Path) -> None:
    prior = result.car.prior
    cars = result.car.members.coordinates[:3]
    nowhere = Edge.around(np.full(3, 1.25), np.full(3, 1e-3))
    engine = MadeUpEngine()
    guess = (nowhere, np.full(3, 0.02))
    runner = Runner(store_in(tmp_path), engine, quiet)
    design = critical_groups(result.car.target, prior, cars, guess, (3, 2), None, runner)
    assert engine.runs == 0
    assert len(design.rows) == 0


def test_a_car_that_flips_only_when_slow_is_no_member(result: Calibration, tmp_path: Path) -> None:
    class FlipsOnlyWhenSlow(MadeUpEngine):
        def row(self, task: RunTask) -> dict:
            row = super().row(task)
            return row | {"outcome": "survived"} if row["commanded_speed_m_per_s"] > 3.5 else row

    runner = Runner(store_in(tmp_path), FlipsOnlyWhenSlow(), quiet)
    upright, found = run_through(result.car.members.coordinates[:2], result.car.prior, result.car.target, runner)
    assert np.all(upright)
    assert not np.any(found.meet)


def test_a_larger_sail_saves_the_made_up_car_so_the_members_have_the_right_one(result: Calibration) -> None:
    assert result.tail.is_met
    values = [result.values[place] for place in result.kept]
    area = np.array([v["tail.sail_length"] * v["tail.sail_width"] for v in values])
    above = groups(values) - TAILLESS_GROUP - 0.6 * (area - 0.05)
    assert np.all((above > -0.3 * (4.72 - 4.58)) & (above <= -0.3 * (4.44 - 4.58)))


def with_tails(result: Calibration, folder: Path, engine: MadeUpEngine) -> TailResult:
    tail, car = result.tail, result.car
    runner = Runner(store_in(folder), engine, quiet)
    return add_tails(tail.target, tail.prior, car.members.coordinates, car.weights, 2, ENOUGH, 7, runner)


def test_a_tailed_bracket_that_is_missed_leaves_the_tails_as_the_prior_has_them(
    result: Calibration, tmp_path: Path
) -> None:
    class NeverFlipsWithTail(MadeUpEngine):
        def row(self, task: RunTask) -> dict:
            row = super().row(task)
            return row | {"outcome": "survived"} if task.scenario == "turn_swing" else row

    tail = with_tails(result, tmp_path, NeverFlipsWithTail())
    assert not tail.is_met
    assert (tail.survive, tail.flip, tail.meet) == (pytest.approx(1.0), 0.0, 0.0)
    by_car = np.bincount(tail.cars, tail.weights, len(result.car.weights))
    np.testing.assert_allclose(by_car, result.car.weights)
    values = tail.prior.values(tail.members.coordinates)
    length, sail = (values[:, tail.prior.keys.index(f"tail.{name}")] for name in ("length", "sail_length"))
    assert np.all(sail <= length)


def test_tipping_over_before_the_turn_is_no_flip_in_the_turn(result: Calibration, tmp_path: Path) -> None:
    class TipsOverBackwards(MadeUpEngine):
        def row(self, task: RunTask) -> dict:
            row = super().row(task)
            tipped = task.scenario == "turn_swing" and row["commanded_speed_m_per_s"] > 4.6
            return row | {"outcome": "flipped", "speed_m_per_s": 0.5} if tipped else row

    tail = with_tails(result, tmp_path, TipsOverBackwards())
    assert tail.flip == 0.0
    assert not tail.is_met


def test_another_seed_gives_other_cars(result: Calibration, tmp_path: Path) -> None:
    other = carried_out(tmp_path, MadeUpEngine(), small_plan(seed=6))
    assert ensemble_text(other) != ensemble_text(result)


def test_an_interrupted_calibration_goes_on_runs_nothing_twice_and_ends_alike(
    result: Calibration, tmp_path: Path
) -> None:
    stopped = MadeUpEngine(stop_after=150)
    with pytest.raises(KeyboardInterrupt):
        carried_out(tmp_path, stopped)
    with (tmp_path / "runs.jsonl").open("a") as stream:
        stream.write('{"run": "cut o')
    goes_on = MadeUpEngine()
    again = carried_out(tmp_path, goes_on)
    assert goes_on.runs == result.runs - 150
    assert ensemble_text(again) == ensemble_text(result)


def test_no_more_rounds_are_run_than_are_needed(result: Calibration, tmp_path: Path) -> None:
    plan = small_plan().model_dump(by_alias=True)
    plan["car_stage"]["rounds"] = [*plan["car_stage"]["rounds"], {"cars": 500, "pilots": [4, 2]}]
    again = carried_out(tmp_path, MadeUpEngine(), CalibrationPlan.model_validate(plan))
    assert (again.runs, again.car.drawn) == (result.runs, result.car.drawn)


def test_too_few_cars_are_refused_with_what_to_do(tmp_path: Path) -> None:
    few = small_plan().model_dump(by_alias=True)
    few["car_stage"]["rounds"] = [{"cars": 8, "pilots": [4, 2]}]
    with pytest.raises(UserError, match=r"needed are 32: more cars in the rounds of the plan"):
        carried_out(tmp_path, MadeUpEngine(), CalibrationPlan.model_validate(few))


def test_runs_of_other_parameters_are_refused_unless_forced(tmp_path: Path) -> None:
    base = load_scenario(BASE_SCENARIO)
    RunStore(tmp_path, base, ["car.mass"])
    RunStore(tmp_path, load_scenario(BASE_SCENARIO, ["car.mass=7.0"]), ["car.mass"])
    other = load_scenario(BASE_SCENARIO, ["environment.gravity=3.7"])
    with pytest.raises(UserError, match="holds runs of other parameters"):
        RunStore(tmp_path, other, ["car.mass"])
    assert len(RunStore(tmp_path, other, ["car.mass"], force=True)) == 0


def test_the_shipped_car_stands_beside_the_ensemble(result: Calibration, folder: Path) -> None:
    shipped = shipped_car(result, Runner(store_in(folder), MadeUpEngine(), quiet))
    keys, base = result.tail.prior.keys, result.tail.prior.base
    assert shipped.values[keys.index("car.com_height")] == base.car.com_height
    members = result.tail.prior.values(result.tail.members.coordinates)[:, keys.index("car.track")]
    mean = result.tail.weights @ members
    assert np.sign(shipped.z[keys.index("car.track")]) == np.sign(base.car.track - mean)
    group = 2 * base.car.tyre_friction * base.car.com_height / base.car.track
    assert (shipped.relative_density > 0.0) == bool(LOW < group <= HIGH)


def test_everything_is_written_and_the_ensemble_reads_back(result: Calibration, folder: Path, tmp_path: Path) -> None:
    page = write_calibration(result, tmp_path, store_in(folder), MadeUpEngine(), quiet)
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
