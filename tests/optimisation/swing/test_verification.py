"""`aerodima swing verify`: what it measures, what it refuses, what it leaves behind."""

import math

import numpy as np
import pytest
import yaml

from aerodima.optimisation import AIMS
from aerodima.optimisation.swerve.steering import steering_settings
from aerodima.optimisation.swing.bound import Bound
from aerodima.optimisation.swing.motion_search import write_verified
from aerodima.optimisation.swing.solution import solution_swing
from aerodima.optimisation.swing.swerve_nlp import SwerveNlp, SwerveSolution
from aerodima.optimisation.swing.swerve_shooting import KNOTS, SwerveShooting, read_limits
from aerodima.optimisation.swing.verification import (
    Check,
    Verification,
    car_clearance,
    car_limit,
    verify_swing,
)
from aerodima.workbench.core.errors import SwingError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import read_swing, write_swing
from tests.certain_cars import HIGH_CAR
from tests.commands import call, refused
from tests.refusals import assert_refused


def thesis():
    return read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))


VERIFY = ("swing", "verify")


@pytest.mark.parametrize(
    ("value", "limits", "kept"),
    [
        (1.5, {"high": 1.571}, True),
        (0.01, {"low": 0.0}, True),
        (math.nan, {}, True),
        (25.0, {"high": 24.8}, False),
        (-0.1, {"low": 0.0}, False),
        (math.nan, {"low": 0.95}, False),
    ],
)
def test_each_limit_that_is_broken_is_named_with_its_value(value, limits, kept):
    check = Check("motor torque", value, "N m", **limits)
    complaints = Verification(thesis(), "", (check,), None).complaints
    assert check.is_kept == kept
    assert bool(complaints) != kept
    assert all(f"motor torque: {value:g}" in words for words in complaints)


@pytest.mark.slow
def test_the_published_swing_is_measured_and_a_report_is_left(tmp_path):
    short = ("--set", "manoeuvre.speed=3.33", "--set", "manoeuvre.duration=3", "--step", 0.002)
    car = [word for setting in HIGH_CAR for word in ("--set", setting)]
    words = (*VERIFY, "thesis_8_rad_per_s", "--out", tmp_path / "a", *car, *short)
    result = call(*words)
    verdict = yaml.safe_load((tmp_path / "a" / "verification.yaml").read_text())
    assert result.exit_code == (0 if verdict["verified"] else 1)
    own = {one["name"]: one["value"] for one in verdict["checks"]}
    assert own["survives and touches nothing"] == 1.0
    assert 0.0 < own["tail roll off the knots"] < 0.6
    assert own["motor torque"] < 24.8
    assert own["tail roll"] == pytest.approx(math.pi / 2, abs=0.01)
    page = (tmp_path / "a" / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert call(*words).exit_code == 2


@pytest.mark.parametrize(
    ("section", "change", "named"),
    [
        ("knots", {"roll_velocity_rad_per_s": [8.0, math.nan, 0.0]}, "nan"),
        ("car", {"car.mass": 7.5}, "car.mass: made for 7.5"),
    ],
)
def test_bad_swings_are_refused_before_anything_runs(tmp_path, section, change, named):
    data = thesis().model_dump(mode="json", by_alias=True, exclude_none=True)
    data[section] = data.get(section, {}) | change
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(data))
    assert named in refused(*VERIFY, path, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def low_mount():
    return ("tail.mode=swing", "manoeuvre.speed=6.0", "tail.mount_height=0.18")


def test_a_search_keeps_the_distance_from_the_car_that_a_verification_measures(low_mount):
    """A tail that leans forwards meets the cage, one that lies back does not."""
    scenario = load_scenario("swerve", low_mount)
    limit = car_limit(scenario)
    shooting = SwerveShooting.from_scenarios([scenario], AIMS["aside-0.5"], [limit])
    rolls = np.zeros(len(KNOTS) - 1)
    steering = [0.06, 0.04, 0.02, 0.2, 0.4]
    for pitch, is_clear in ((0.29, False), (-0.8, True)):
        x = np.concatenate([[pitch], rolls, steering]) / shooting.variables.units
        swerve = shooting.drive(x[:, None], np.zeros(1, int))
        overlap = limit.function(swerve)
        measured = car_clearance(scenario)(swerve.tail[:, 0, 0], swerve.tail[:, 1, 0])
        assert -np.max(overlap) == np.min(measured[swerve.steered])
        assert (np.max(overlap) <= limit.upper) == is_clear


@pytest.mark.slow
@pytest.mark.parametrize(("pitch", "refused_for"), [(0.29, "from the car"), (-0.8, "")])
def test_the_file_of_a_search_claims_what_is_verified_or_names_what_is_wrong(
    low_mount, tmp_path, pitch, refused_for
):
    scenario = load_scenario("swerve", low_mount)
    program = SwerveNlp(SwerveShooting.from_scenarios([scenario], AIMS["aside-0.5"]), 0.3)
    steering = np.array([0.06, 0.04, 0.02, 0.2, 0.4])
    x = np.concatenate([[pitch], np.zeros(len(KNOTS) - 1), steering])
    x /= program.shooting.variables.units
    solution = SwerveSolution(x, program.at(x).aims, 0.0, 0.0, "nothing", 1)
    tried = tmp_path / "tried.yaml"
    bound = Bound((scenario,), program, solution, 1.0)
    write_swing(solution_swing("tried", low_mount, bound, "aside-0.5"), tried)
    path = tmp_path / "swing.yaml"
    driven = (*low_mount, f"controller.swing_file={tried}", *steering_settings(0.9 * steering))
    complaints = write_verified(path, (*driven, "simulation.step=0.002"))
    swing = read_swing(path)
    found = swing.provenance.found
    assert swing.name == "swing"
    assert any(refused_for in words for words in complaints) == bool(refused_for)
    assert found.get("refused", "") == "; ".join(complaints)
    assert ("aim_value" in found) != bool(refused_for)
    assert "manoeuvre.level_1=0.054" in swing.provenance.settings
    assert verify_swing(str(path)).complaints == complaints
    origin = swing.provenance.model_copy(update={"options": {"limits": "roll=0.01 speed=1"}})
    write_swing(swing.model_copy(update={"provenance": origin}), path, force=True)
    (broken,) = set(verify_swing(str(path)).complaints) - set(complaints)
    assert broken.startswith("limit roll: 0.")
    assert broken.endswith("rad; must be at most 0.01")


@pytest.mark.parametrize("text", ["roll=nan", "roll=-0.3", "energy=0", "speed=inf", "roll=wide"])
def test_a_limit_is_a_number_above_zero(text):
    assert_refused(lambda: read_limits([text]), SwingError, text, "above 0")


@pytest.mark.slow
def test_a_swing_that_is_never_released_is_said_to_be(tmp_path):
    lazy = thesis().model_copy(
        update={"trigger": thesis().trigger.model_copy(update={"threshold_rad_per_s": 50.0})}
    )
    path = write_swing(lazy, tmp_path / "lazy.yaml")
    short = ("--set", "manoeuvre.duration=2.7", "--step", 0.002)
    result = call(*VERIFY, path, "--out", tmp_path / "out", *short)
    assert thesis().name in result.stderr
    assert not (tmp_path / "out").exists()
