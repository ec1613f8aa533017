import math
from dataclasses import replace
from operator import attrgetter

import pytest

from aerodima.workbench.core.errors import EnsembleError
from aerodima.workbench.core.yaml_files import shipped_names
from aerodima.workbench.scenario.ensemble import Member, load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from tests.refusals import assert_refused

TEXT = """schema: aerodima/ensemble/1
name: two
provenance: {method: test}
best: b
members:
- {name: a, weight: 3.0, values: {car.com_height: 0.25, tail.sail: free}}
- {name: b, weight: 1.0, values: {car.mass: 6.5}}
"""


def written(folder, text):
    path = folder / "two.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_weights_are_scaled_to_one_and_the_best_is_found(tmp_path):
    ensemble = load_ensemble(written(tmp_path, TEXT))
    assert [member.weight for member in ensemble.members] == [0.75, 0.25]
    assert ensemble.best.settings_on("turn_swing") == ("car.mass=6.5",)
    assert ensemble.effective_size == pytest.approx(1 / (0.75**2 + 0.25**2))


def test_a_member_overrides_the_parameters_and_a_setting_overrides_the_member(
    tmp_path,
):
    ensemble = load_ensemble(written(tmp_path, TEXT))
    car = ensemble.scenario(ensemble.members[0], "turn_none", ["car.com_height=0.2"])
    assert (car.car.com_height, car.tail.sail) == (0.2, "free")
    assert ensemble.scenario(ensemble.members[0], "turn_none").car.com_height == 0.25


def test_shipped_ensembles_load_and_every_member_is_a_scenario():
    assert shipped_names("calibration") == ["physical", "simulated"]
    for name in shipped_names("calibration"):
        ensemble = load_ensemble(name)
        assert ensemble.best in ensemble.members
        for member in ensemble.members[:4]:
            ensemble.scenario(member, "turn_swing")


@pytest.mark.parametrize(
    ("system", "scenario"),
    [("simulated", "turn_swing"), ("physical", "field"), ("physical", "auto_turn")],
)
def test_the_default_cars_are_the_best_members(system, scenario):
    car = load_scenario(scenario)
    for key, value in load_ensemble(system).best.values.items():
        assert attrgetter(key)(car) == value, key


def test_drawn_members_stand_for_all_of_the_weight(tmp_path):
    ensemble = load_ensemble(written(tmp_path, TEXT))
    members = tuple(
        Member(str(place), weight, {}) for place, weight in enumerate((0.1, 0.55, 0.02, 0.33))
    )
    many = replace(ensemble, members=members)
    assert [(m.name, m.weight) for m in many.resample(3)] == [
        ("1", pytest.approx(2 / 3)),
        ("3", pytest.approx(1 / 3)),
    ]
    assert many.resample(4) == many.members
    assert sum(member.weight for member in ensemble.resample(1)) == 1.0
    assert_refused(lambda: ensemble.resample(0), EnsembleError, "0 members")


def test_another_tail_than_the_built_one_keeps_its_size_on_the_car_of_a_member():
    ensemble = load_ensemble()
    member = ensemble.members[0]
    built, designed = (ensemble.scenario(member, name) for name in ("turn_swing", "turn_designed"))
    assert built.tail.sail_width == pytest.approx(float(member.values["tail.sail_width"]))
    assert (
        designed.tail.sail_width
        == load_scenario("turn_designed").tail.sail_width
        != built.tail.sail_width
    )
    assert designed.tail.mount_height == built.tail.mount_height
    assert designed.car == built.car


def test_no_car_is_in_two_parts_of_the_split():
    shipped = load_ensemble()
    heavy = next(member for member in shipped.members if member.name != shipped.best.name)
    light = 0.5 / (len(shipped.members) - 1)
    members = [replace(m, weight=0.5 if m is heavy else light) for m in shipped.members]
    ensemble = replace(shipped, members=tuple(members))
    split = ensemble.split(1)
    names = [member.name for part in split for member in part]
    assert sorted(names) == sorted(m.name for m in ensemble.members if m.name != ensemble.best.name)
    assert split == ensemble.split(1)
    assert split != ensemble.split(2)
    # The first cars of all parts are drawn by weight: over many seeds the likeliest car is among
    # them most often.
    first = [part[0] for seed in range(400) for part in ensemble.split(seed)[:1]]
    share = 0.5 / (1.0 - light)
    drawn = sum(member.name == heavy.name for member in first) / len(first)
    assert drawn == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / len(first)))


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("ensemble/1", "ensemble/0", ("schema", "aerodima/ensemble/0")),
        ("best: b", "best: c", ("best", "'c'")),
        ("car.mass:", "car.masss:", ("'b'", "car.masss", "'car.mass'")),
        ("car.mass:", "cart.mass:", ("'cart'", "'car'")),
        ("weight: 3.0", "weight: -3.0", ("weight", "-3.0")),
        ("weight: 3.0", "weight: .nan", ("weight", "nan")),
        ("name: b,", "name: a,", ("'a'",)),
        ("provenance:", "origin:", ("origin",)),
        ("car.mass: 6.5", "car.gyration_roll: 0.4", ("'b'", "gyration_roll", "0.4")),
    ],
)
def test_a_wrong_file_is_refused_by_file_member_and_key(tmp_path, old, new, named):
    path = written(tmp_path, TEXT.replace(old, new))

    def load():
        ensemble = load_ensemble(path)
        ensemble.scenario(ensemble.members[1], "turn_none")

    assert_refused(load, EnsembleError, "two.yaml", *named)


@pytest.mark.parametrize(("name", "nearest"), [("fysical", "'physical'"), ("nowhere.yaml", "")])
def test_an_unknown_name_and_a_missing_file_are_named(name, nearest):
    assert_refused(lambda: load_ensemble(name), EnsembleError, name, nearest)
