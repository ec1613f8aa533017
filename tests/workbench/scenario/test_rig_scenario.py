"""Rig scenarios: the parameters are the published ones, and a refusal names key and value."""

import pytest

from aerodima.workbench.core.errors import ScenarioError
from aerodima.workbench.core.resources import published_rows
from aerodima.workbench.scenario.rig_scenario import (
    RigScenario,
    load_rig_scenario,
    rig_scenario_from_dict,
)
from aerodima.workbench.scenario.scenario import scenario_from_dict
from tests.refusals import assert_refused

RIG = rig_scenario_from_dict({})


def test_tails_are_those_of_the_published_tables():
    for tail, properties, offsets in zip(
        (RIG.tail_1, RIG.tail_2, RIG.tail_3),
        published_rows("tail_properties"),
        published_rows("force_offsets"),
        strict=True,
    ):
        for key, column in (
            ("length", "length_m"),
            ("major_axis", "major_axis_m"),
            ("minor_axis", "minor_axis_m"),
            ("mass", "mass_kg"),
        ):
            assert getattr(tail, key) == float(properties[column])
        assert tail.offsets == tuple(
            float(value) for key, value in offsets.items() if "_offset_" in key
        )


def test_mount_bar_and_pivot_are_those_of_the_published_tables():
    mount, bar = published_rows("rig_bodies")
    for key in ("xx", "yy", "zz", "xy", "xz", "yz"):
        assert getattr(RIG.mount, f"inertia_{key}") == pytest.approx(
            float(mount[f"inertia_{key}_kg_m2"]), rel=1e-12
        )
    assert (RIG.mount.mass, RIG.bar.mass) == (float(mount["mass_kg"]), float(bar["mass_kg"]))
    # ERRATA E11: the remainders behind the common offset, in g cm2.
    for key in ("xx", "yy", "zz"):
        remainder = float(bar[f"printed_inertia_{key}_g_mm2"]) - 673108e6
        assert getattr(RIG.bar, f"inertia_{key}") == pytest.approx(remainder * 1e-7, rel=1e-9)
    terms = {(row["body"], row["term_no"]): row for row in published_rows("rig_positions")}
    for key in "xyz":
        assert getattr(RIG.mount, f"com_{key}") == float(
            terms["Mounting Structure", "1"][f"{key}_m"]
        )
        assert getattr(RIG.mount, f"pivot_{key}") == float(terms["Steel Bar", "2"][f"{key}_m"])
    assert -RIG.bar.com_distance == float(terms["Steel Bar", "3"]["z_m"])
    assert -RIG.bar.tail_distance == float(terms["Tail", "3"]["z_m"])


def test_friction_and_accuracies_are_those_of_the_published_tables():
    (average,) = (
        row
        for row in published_rows("bar_friction")
        if row["record"] == "published_weighted_average"
    )
    assert RIG.friction.coulomb == float(average["coulomb_friction_n_m"])
    assert RIG.friction.viscous == float(average["viscous_friction_n_m_s_per_rad"])
    accuracies = [float(row["uncertainty_factor"]) for row in published_rows("residual_weights")][
        :6
    ]
    assert list(RIG.force_sensor.accuracies) == accuracies


def test_the_robot_tail_is_the_one_on_the_car():
    car = scenario_from_dict({})
    assert RIG.robot_tail == car.tail
    assert RIG.robot_motor == car.tail_motor
    assert RIG.robot_friction == car.friction
    assert RIG.environment == car.environment


@pytest.mark.parametrize("section", sorted(RigScenario.sections()))
def test_every_number_has_unit_and_source(section):
    assert set(RigScenario.parameters(section)) == set(RigScenario.sections()[section].model_fields)


def test_shipped_scenarios_resolve_and_survive_a_round_trip():
    assert RigScenario.names() == ["bar", "flick", "robot", "static"]
    for name in RigScenario.names():
        scenario = load_rig_scenario(name)
        assert rig_scenario_from_dict(scenario.resolved()) == scenario
        assert scenario.varied() == scenario


def test_a_key_of_an_earlier_version_has_its_name_of_today():
    now = rig_scenario_from_dict({"tunnel": {"misalignment": 0.07}})
    assert rig_scenario_from_dict({"tunnel": {"kilter": 0.07}}) == now
    resolved = now.resolved()
    resolved["tunnel"]["kilter"] = resolved["tunnel"].pop("misalignment")
    assert rig_scenario_from_dict(resolved) == now


def test_what_is_not_varied_stays():
    varied = RIG.varied(seed=9, experiment={"tail": 2})
    assert (varied.seed, varied.experiment.tail, varied.tail_name) == (9, 2, "2")
    assert varied.varied(seed=RIG.seed, experiment={"tail": 1}) == RIG


@pytest.mark.parametrize(
    ("overrides", "named"),
    [
        ({"experiment": {"kind": "bar_swing"}}, ("experiment.wind_speed", "10", "bar_swing")),
        ({"experiment": {"kind": "swing", "rest": 30.0}}, ("experiment.rest", "30", "20")),
        ({"experiment": {"target": 1.749}}, ("experiment.target", "1.749", "mount.angle_limit")),
        ({"experiment": {"tail": 4}}, ("experiment.tail", "4")),
        ({"experiment": {"angle": 1.749}}, ("experiment.angle", "1.749", "mount.angle_limit")),
        ({"encoder": {"rate": 1001.0}}, ("encoder.rate", "1001", "0.001")),
        ({"force_sensor": {"rate": 2000.0}}, ("force_sensor.rate", "2000", "0.001")),
        (
            {"aero": {"added_mass": 0.02}, "tunnel": {"misalignment": 0.05}},
            ("aero.added_mass", "0.02", "tunnel.misalignment"),
        ),
        (
            {"robot_tail": {"added_mass": 0.05}},
            ("robot_tail.added_mass", "0.05", "aero.added_mass"),
        ),
        (
            {"experiment": {"kind": "robot_swing", "actuated": False}},
            ("experiment.actuated", "robot_swing"),
        ),
        (
            {"experiment": {"kind": "robot_swing"}, "tunnel": {"misalignment": 0.05}},
            ("tunnel.misalignment", "0.05", "robot_swing"),
        ),
        ({"schema": "aerodima/scenario/1"}, ("schema", "'aerodima/rig-scenario/1'")),
    ],
    ids=str,
)
def test_wrong_scenarios_are_refused_by_name(overrides, named):
    assert_refused(lambda: rig_scenario_from_dict(overrides), ScenarioError, *named)
