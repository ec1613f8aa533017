"""The suite: its names, the two tails, floors, and what is refused."""

import pytest

from aerodima.optimisation.entry import suite
from aerodima.workbench.cli.program import main
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import SweepError

CARS = load_ensemble("physical").split(1).test[:2]


@pytest.mark.parametrize("tail", suite.TAILS)
def test_every_manoeuvre_is_a_scenario_with_either_tail_and_the_mount_of_the_car(tail) -> None:
    for one in suite.manoeuvres(list(suite.MANOEUVRES), tail):
        scenario = load_scenario(one.scenario, (*CARS[0].settings_on(one.scenario), *one.settings))
        assert scenario.manoeuvre.rolling_start
        assert scenario.controller.delay == 0.0
        assert (scenario.manoeuvre.kind == "path") == (one.rule == "path")
        assert (scenario.tail.name == "designed") == (tail == "designed")
        own = load_scenario(one.scenario, CARS[0].settings_on(one.scenario))
        for key in ("roll_stop", "mount_height", "mount_x"):
            assert getattr(scenario.tail, key) == getattr(own.tail, key)


def test_a_search_sees_some_manoeuvres_alone() -> None:
    assert set(suite.TRAINED_ON) < set(suite.MANOEUVRES)
    assert not {"twice", "twice-late", "slalom", "corner"} & set(suite.TRAINED_ON)


def test_floors_are_shares_of_the_friction_of_each_car() -> None:
    cases = suite.floors(CARS, [0.8, 1.2])
    assert [floor.name for _, floor in cases] == ["x 0.8", "x 0.8", "x 1.2", "x 1.2"]
    for car, floor in cases:
        friction = load_scenario("turn_none", car.settings_on("turn_none")).car.tyre_friction
        there = load_scenario("turn_none", (*car.settings_on("turn_none"), *floor.settings)).car.tyre_friction
        assert there / friction == pytest.approx(float(floor.name[2:]), rel=1e-5)


def test_the_car_without_tail_comes_first_and_once() -> None:
    names = [one.name for one in suite.candidates(["feedback", "none", "held"])]
    assert names == ["no tail", "feedback", "held"]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: suite.manoeuvres(["fishhok"], "built"), "fishhok.*fishhook"),
        (lambda: suite.manoeuvres(["turn"], "longer"), "tail 'longer'"),
        (lambda: suite.manoeuvres(["turn", "turn"], "built"), "turn.*twice"),
        (lambda: suite.floors(CARS, [3.0]), "floor 3: allowed: 0.2 to 2"),
        (lambda: suite.candidates(["feedbak"]), "feedbak"),
    ],
)
def test_what_is_not_there_is_refused(make, words) -> None:
    with pytest.raises(SweepError, match=words):
        make()


@pytest.mark.parametrize(("flags", "words"), [(["--cars", "99"], "--cars 99"), (["--tail", "long"], "tail 'long'")])
def test_wrong_flags_are_one_line(tmp_path, capsys, monkeypatch, flags, words) -> None:
    monkeypatch.setattr("sys.argv", ["aerodima", "swing", "entry", "--out", str(tmp_path / "out"), *flags])
    with pytest.raises(SystemExit):
        main()
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
