from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from aerodima.optimisation.calibration import calibration_runs as runs
from aerodima.optimisation.calibration import surrogates
from aerodima.optimisation.calibration.bracket_design import Design, Runner, critical_ratios, run_through
from aerodima.optimisation.calibration.calibration import SHIPPED_DIGITS, Calibration, calibrate
from aerodima.optimisation.calibration.calibration_output import ensemble_text, write_calibration
from aerodima.optimisation.calibration.calibration_plan import CalibrationPlan, fitted_names, load_plan, prior_ranges
from aerodima.optimisation.calibration.calibration_runs import (
    Datum,
    RunStore,
    car_values,
    fitted,
    log_likelihood,
    plan_data,
)
from aerodima.optimisation.calibration.car_prior import HEIGHT, normalised
from aerodima.optimisation.calibration.identifiability import MU_OVER_SSF, sensitivities
from aerodima.optimisation.calibration.member_draw import Draw
from aerodima.optimisation.calibration.surrogates import Edge
from aerodima.optimisation.calibration.validation import shipped_car, validate
from aerodima.optimisation.sweep.runs import RunTask
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import load_parameter_entries, load_scenario
from aerodima.workbench.errors import ScenarioError, UserError
from tests.optimisation.calibration.made_up_car import TAILLESS_GROUP, MadeUpEngine, half_track

LOW, HIGH = TAILLESS_GROUP - 0.1 * (3.61 - 3.47), TAILLESS_GROUP - 0.1 * (3.33 - 3.47)


def quiet(line: str) -> None:
    """Says nothing."""


def small_plan(**changes: object) -> CalibrationPlan:
    rounds = [{"cars": cars, "pilots": [3, 2]} for cars in (16, 48, 80)]
    size = {"points": 12, "pilots": [6, 3], "step": 0.004, "rounds": rounds, "tails": 4, "enough": 32}
    plan = load_plan("car").model_dump(by_alias=True) | {"size": size} | changes
    return CalibrationPlan.model_validate(plan)


def store_in(folder: Path) -> RunStore:
    return RunStore.for_plan(folder, small_plan())


def carried_out(
    folder: Path,
    engine: MadeUpEngine,
    plan: CalibrationPlan | None = None,
    data: Sequence[Datum] | None = None,
) -> Calibration:
    store = store_in(folder)
    try:
        return calibrate(plan or small_plan(), store, engine, quiet, data)
    finally:
        store.close()


def groups(values: list[dict]) -> np.ndarray:
    return np.array([v["car.tyre_friction"] * v["car.com_height"] / half_track(v) for v in values])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def result(folder: Path) -> Calibration:
    return carried_out(folder, MadeUpEngine())


def test_every_member_lies_where_the_made_up_car_flips_between_the_two_speeds(result: Calibration) -> None:
    found = groups([result.values[place] for place in result.kept])
    assert np.all((found > LOW) & (found <= HIGH))
    assert result.draw.effective_size >= result.plan.size.enough
    assert result.check.share == pytest.approx(1.0)


def exact_likelihood(draw: Draw, data: Sequence[Datum], cars: Sequence[dict]) -> np.ndarray:
    """Log likelihood of cars by the formula of the made-up car."""
    engine, rows = MadeUpEngine(), {}
    for turn in dict.fromkeys(datum.turn for datum in data):
        tasks = [turn.wanted(car).task() for car in cars]
        rows[turn] = [engine.row(task) for task in tasks]
    values = {d.name: np.array([row[d.column] for row in rows[d.turn]]) for d in data}
    return log_likelihood(data, values, len(cars))


def test_the_weights_are_those_of_the_posterior_that_a_million_runs_would_find(result: Calibration) -> None:
    draw = result.draw
    limits = draw.prior.plausible
    scale = limits.highest_mu_over_ssf.value - limits.lowest_mu_over_ssf.value
    ends = [(group - limits.lowest_mu_over_ssf.value) / scale for group in (LOW, HIGH)]
    points, density = draw.prior.draw(2**13, 9, window=lambda p: (np.full(len(p), ends[0]), np.full(len(p), ends[1])))
    values = draw.prior.values(points)
    data = fitted(plan_data(result.plan))
    assert {datum.turn.tail_mode for datum in data} == {"none", "swing"}
    exact = normalised(density + exact_likelihood(draw, data, car_values(draw.prior.keys, values)))
    ours = draw.prior.values(draw.coordinates)
    for key in ("car.tyre_friction", "car.com_height", "car.mass", "tail.sail_width", "tail.mass"):
        column = draw.prior.keys.index(key)
        mean = exact @ values[:, column]
        error = np.sqrt(exact @ (values[:, column] - mean) ** 2 / draw.effective_size)
        assert abs(draw.weights @ ours[:, column] - mean) < 3.0 * error, key


def test_the_tailed_figures_tell_the_size_of_the_made_up_sail(result: Calibration) -> None:
    """Less yaw rate is published with the tail than the made-up car has with a small sail."""
    column = result.draw.prior.keys.index("tail.sail_width")
    low, high = result.draw.prior.ranges[column]
    widths = result.draw.prior.values(result.draw.coordinates)[:, column]
    assert result.draw.weights @ widths > 0.5 * (low + high) + 0.1 * (high - low)


def changed(data: Sequence[Datum], use: str) -> list[Datum]:
    """The figures with all those of one use doubled."""
    return [replace(datum, figure=2.0 * datum.figure) if datum.use == use else datum for datum in data]


def test_a_figure_that_is_held_out_enters_no_weight(result: Calibration, tmp_path: Path) -> None:
    data = plan_data(result.plan)
    held = [datum.source for datum in data if datum.use == "held out"]
    assert held.count("Table 7.3") == 7
    assert held.count("Table 7.4") == 4
    other = carried_out(tmp_path / "held", MadeUpEngine(), data=changed(data, "held out"))
    assert ensemble_text(other) == ensemble_text(result)


def test_each_fitted_figure_enters_the_weights(result: Calibration) -> None:
    draw, data = result.draw, plan_data(result.plan)
    cars = [result.values[place] for place in result.kept[:6]]
    plain = exact_likelihood(draw, fitted(data), cars)
    for datum in fitted(data):
        moved = [replace(d, figure=2.0 * d.figure) if d is datum else d for d in fitted(data)]
        assert not np.allclose(exact_likelihood(draw, moved, cars) - plain, 0.0, atol=1e-3), datum.name


def searched(result: Calibration, folder: Path, engine: MadeUpEngine, pilots: tuple[int, int]) -> Design:
    prior = result.draw.cars
    edge = (HIGH + 0.03 - prior.plausible.lowest_mu_over_ssf.value) / prior.ratio_scale
    beyond = np.full(len(result.draw.members.coordinates), edge)
    plausible = np.isfinite(prior.log_density_at(result.draw.members.coordinates, beyond))
    cars = result.draw.members.coordinates[plausible][:4]
    assert len(cars) == 4
    guess = Edge.around(prior.coordinates(prior.values(cars))[:, prior.leading] + 0.05, np.full(4, 0.1))
    runner = Runner(store_in(folder), engine, quiet)
    return critical_ratios(result.draw.target, prior, cars, (guess, np.full(4, 0.02)), pilots, None, runner)


def test_windows_hold_the_bracket_of_the_made_up_car_and_little_more(result: Calibration, tmp_path: Path) -> None:
    engine = MadeUpEngine()
    design = searched(result, tmp_path, engine, (5, 3))
    low, high = result.draw.cars.mu_over_ssf(design.windows).T
    assert np.all((low < LOW) & (low > LOW - 0.015))
    assert np.all((high > HIGH) & (high < HIGH + 0.015))
    assert engine.runs <= 4 * 8


def test_what_pilots_say_of_the_critical_group_is_right_within_what_they_claim(
    result: Calibration, tmp_path: Path
) -> None:
    rough = searched(result, tmp_path / "rough", MadeUpEngine(), (1, 1))
    sharp = searched(result, tmp_path / "sharp", MadeUpEngine(), (5, 3))
    truth = (np.array([HIGH, LOW]) - result.draw.cars.mu_over_ssf(np.zeros(1))) / result.draw.cars.ratio_scale
    for design in (rough, sharp):
        assert np.all(np.abs(design.edges - truth) < 3.5 * design.deviations)
    assert np.all(sharp.deviations < rough.deviations)


def test_a_car_that_cannot_be_plausible_where_it_flips_takes_no_run(result: Calibration, tmp_path: Path) -> None:
    prior = result.draw.cars
    cars = result.draw.members.coordinates[:3]
    nowhere = Edge.around(np.full(3, 1.25), np.full(3, 1e-3))
    engine = MadeUpEngine()
    guess = (nowhere, np.full(3, 0.02))
    runner = Runner(store_in(tmp_path), engine, quiet)
    design = critical_ratios(result.draw.target, prior, cars, guess, (3, 2), None, runner)
    assert engine.runs == 0
    assert len(design.rows) == 0


def test_a_car_that_flips_only_when_slow_is_no_member(result: Calibration, tmp_path: Path) -> None:
    class FlipsOnlyWhenSlow(MadeUpEngine):
        def row(self, task: RunTask) -> dict:
            row = super().row(task)
            return row | {"outcome": "survived"} if row["commanded_speed_m_per_s"] > 3.5 else row

    runner = Runner(store_in(tmp_path), FlipsOnlyWhenSlow(), quiet)
    meet, found = run_through(result.draw.members.coordinates[:2], result.draw.cars, result.draw.target, runner)
    assert not np.any(meet)
    assert len(found.coordinates) == 0


def test_every_member_has_a_tail_that_exists_and_its_own_runs(result: Calibration) -> None:
    draw = result.draw
    values = draw.prior.values(draw.coordinates)
    length, sail = (values[:, draw.prior.keys.index(f"tail.{name}")] for name in ("length", "sail_length"))
    assert np.all(sail <= length)
    np.testing.assert_array_equal(draw.coordinates[:, : len(draw.cars.keys)], draw.members.coordinates)
    assert draw.tails.log_weights.shape == (len(draw.weights), 4)


def test_the_tailed_bracket_is_reported_and_decides_nothing(result: Calibration, tmp_path: Path) -> None:
    class NeverFlipsWithTail(MadeUpEngine):
        def row(self, task: RunTask) -> dict:
            row = super().row(task)
            return row | {"outcome": "survived"} if task.scenario == "turn_swing" else row

    other = carried_out(tmp_path, NeverFlipsWithTail())
    assert ensemble_text(other) == ensemble_text(result)


def test_tipping_over_before_the_turn_is_no_flip_in_the_turn(tmp_path: Path) -> None:
    class TipsOverBackwards(MadeUpEngine):
        def row(self, task: RunTask) -> dict:
            row = super().row(task)
            tipped = task.scenario == "turn_swing" and row["commanded_speed_m_per_s"] > 4.6
            return row | {"outcome": "flipped", "speed_m_per_s": 0.5} if tipped else row

    members = load_ensemble("car").drawn(3)
    store = RunStore(tmp_path, {key for member in members for key in member.values})
    _, outcomes = validate(members, small_plan(), store, TipsOverBackwards())
    found = {outcome.claim: outcome for outcome in outcomes}
    assert (found["tail: flips 4.72 m/s"].share, found["tail: flips 4.72 m/s"].tipped) == (0.0, pytest.approx(1.0))
    assert found["tail: survives 6.1 m/s"].tipped == pytest.approx(1.0)
    assert {claim: outcome.use for claim, outcome in found.items()} == {
        "no tail: survives 3.33 m/s": "fitted",
        "no tail: flips 3.61 m/s": "fitted",
        "tail: survives 4.44 m/s": "held out",
        "tail: flips 4.72 m/s": "held out",
        "tail: survives 6.1 m/s": "held out",
    }


def test_validation_asks_for_the_runs_of_each_turn_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    members = load_ensemble("car").drawn(2)
    store = RunStore(tmp_path, {key for member in members for key in member.values})
    asked: list[tuple[str, float]] = []
    run = store.run

    def noted(wanted: Sequence[runs.Wanted], engine: MadeUpEngine) -> pd.DataFrame:
        asked.append((wanted[0].tail_mode, wanted[0].speed))
        return run(wanted, engine)

    monkeypatch.setattr(store, "run", noted)
    validate(members, small_plan(), store, MadeUpEngine())
    speeds = {"none": (3.33, 3.37, 3.61), "swing": (4.44, 4.72, 6.1)}
    assert sorted(asked) == [(mode, speed) for mode, group in speeds.items() for speed in group]


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
    plan["size"]["rounds"] = [*plan["size"]["rounds"], {"cars": 500, "pilots": [4, 2]}]
    again = carried_out(tmp_path, MadeUpEngine(), CalibrationPlan.model_validate(plan))
    assert (again.runs, again.draw.drawn) == (result.runs, result.draw.drawn)


def test_too_few_cars_are_refused_with_what_to_do(tmp_path: Path) -> None:
    few = small_plan().model_dump(by_alias=True)
    few["size"]["rounds"] = [{"cars": 8, "pilots": [4, 2]}]
    with pytest.raises(UserError, match=r"needed is 32: more cars in the rounds of the plan"):
        carried_out(tmp_path, MadeUpEngine(), CalibrationPlan.model_validate(few))


@pytest.mark.parametrize("scenario", ["turn_none", "turn_swing", "turn_held"])
def test_runs_of_other_parameters_are_refused_unless_forced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenario: str
) -> None:
    def other(name: str) -> object:
        return load_scenario(name, ["tail.normal_force_coefficient=1.5"] if name == scenario else ["car.mass=7.0"])

    RunStore(tmp_path, ["car.mass"]).close()
    RunStore(tmp_path, ["car.mass"]).close()
    monkeypatch.setattr(runs, "load_scenario", other)
    with pytest.raises(UserError, match="holds results of other parameters"):
        RunStore(tmp_path, ["car.mass"])
    RunStore(tmp_path, ["car.mass"], force=True).close()
    assert len(RunStore(tmp_path, ["car.mass"])) == 0


def test_a_folder_in_which_another_calibration_works_is_refused(tmp_path: Path) -> None:
    first = store_in(tmp_path)
    with pytest.raises(UserError, match="another process works in it"):
        store_in(tmp_path)
    first.close()
    store_in(tmp_path).close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"figures": {}}, r"figures: \[\]; allowed: Table 7\.1"),
        ({"outcomes": {"tailless_bracket": "held out"}}, r"tailless_bracket"),
        ({"schema": "aerodima/calibration-plan/1"}, r"schema"),
    ],
)
def test_a_plan_that_leaves_open_what_a_figure_is_for_is_refused(tmp_path: Path, change: dict, message: str) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(load_plan("car").model_dump(by_alias=True, mode="json") | change))
    with pytest.raises(ScenarioError, match=message):
        load_plan(path)


def test_the_shipped_car_stands_beside_the_ensemble(result: Calibration, folder: Path) -> None:
    shipped = shipped_car(result, Runner(store_in(folder), MadeUpEngine(), quiet))
    keys, base = result.draw.prior.keys, result.draw.prior.base
    assert shipped.values[keys.index("car.com_height")] == base.car.com_height
    members = result.draw.prior.values(result.draw.coordinates)[:, keys.index("car.track")]
    mean = result.draw.weights @ members
    assert np.sign(shipped.z[keys.index("car.track")]) == np.sign(base.car.track - mean)
    group = base.car.tyre_friction * base.car.com_height / base.car.outer_half_track
    assert (shipped.relative_density > 0.0) == bool(LOW < group <= HIGH)


def test_everything_is_written_and_the_ensemble_reads_back(result: Calibration, folder: Path, tmp_path: Path) -> None:
    store = store_in(folder)
    page = write_calibration(result, tmp_path, store, MadeUpEngine(), quiet)
    store.close()
    ensemble = load_ensemble(tmp_path / "car.yaml")
    assert len(ensemble.members) == len(result.kept)
    assert ensemble.best.values == result.values[result.best]
    assert ensemble.provenance["fitted"] == fitted_names(result.plan)
    np.testing.assert_allclose(ensemble.weights, result.draw.weights[result.kept], atol=1e-5)
    text = page.read_text()
    for said in (
        "Table 7.4",
        "not identifiable",
        "log car.tyre_friction",
        "effective",
        "survives 3.33 m/s",
        "held out",
    ):
        assert said.lower() in text.lower()
    names = {"validation.csv", "outcomes.csv", "sensitivities.csv", "parameters.csv", "directions.csv"}
    assert names | {"members.parquet"} <= {path.name for path in tmp_path.iterdir()}
    assert len((tmp_path / "validation.csv").read_text().splitlines()) == 1 + 4 * 8 + 2
    assert set(pd.read_csv(tmp_path / "sensitivities.csv")["parameter"]) >= {MU_OVER_SSF, "car.tyre_friction"}
    assert len((tmp_path / "outcomes.csv").read_text().splitlines()) == 6


def test_sobol_indices_are_those_of_the_coefficients(result: Calibration) -> None:
    """The basis is orthonormal over the cube: squares of the coefficients are the parts of the variance."""
    draw = result.draw
    keys, table = list(draw.prior.keys), sensitivities(draw, seed=1)
    pd.testing.assert_frame_equal(table, sensitivities(draw, seed=1), check_exact=True)  # its intervals too
    datum, surrogate = next(iter(draw.surrogates.tailed.items()))
    own = table[table["target"] == datum.name].set_index("parameter")
    assert list(own.index) == [MU_OVER_SSF if key == HEIGHT else key for key in keys]
    n, parts = len(keys), surrogate.coefficients[1:] ** 2
    alone = parts[:n] + parts[n : 2 * n]
    first, second = np.triu_indices(n, 1)
    together = np.zeros(n)
    np.add.at(together, first, parts[2 * n :])
    np.add.at(together, second, parts[2 * n :])
    assert own["first"].to_numpy() == pytest.approx(alone / parts.sum(), abs=0.04)
    assert own["total"].to_numpy() == pytest.approx((alone + together) / parts.sum(), abs=0.04)
    assert (own["total_low"] <= own["total"]).all()
    assert (own["total"] <= own["total_high"]).all()


def test_quantities_predicted_together_are_those_predicted_alone_and_share_their_polynomials(
    result: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    tailed = list(result.draw.surrogates.tailed.values())
    points = result.draw.prior.points(surrogates.CHUNK + 2, seed=3)
    alone = [surrogates.predictions(points, [each])[0] for each in tailed]
    sizes: list[int] = []

    def counted(part: np.ndarray) -> np.ndarray:
        sizes.append(len(part))
        return basis(part)

    basis = surrogates.basis
    monkeypatch.setattr(surrogates, "basis", counted)
    together = surrogates.predictions(points, tailed)
    np.testing.assert_array_equal(together, alone)
    assert len(tailed) > 1
    assert sizes == [len(points)]
    assert surrogates.predictions(points, []) == []


def test_the_shipped_ensemble_holds_what_the_shipped_plan_fits() -> None:
    ensemble, plan = load_ensemble("car"), load_plan("car")
    assert ensemble.provenance["fitted"] == fitted_names(plan)
    keys = (*plan.car, *plan.tail)
    ranges = prior_ranges(keys)
    for member in ensemble.members:
        values = np.array([member.values[key] for key in keys])
        assert np.all((values >= ranges[:, 0] - 1e-6) & (values <= ranges[:, 1] + 1e-6)), member.name


def test_the_parameter_files_hold_the_best_member_of_the_shipped_ensemble() -> None:
    ensemble = load_ensemble("car")
    for key, value in ensemble.best.values.items():
        section, _, name = key.partition(".")
        entry = load_parameter_entries(section)[name]
        assert entry.value == float(f"{value:.{SHIPPED_DIGITS}g}"), key
        assert entry.source == f"calibrated: calibration/car.yaml, member {ensemble.best.name}", key
