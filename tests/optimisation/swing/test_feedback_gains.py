"""Gains of the tracker: the regulator against known answers, and the feedback on the whole car."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from typer.testing import CliRunner, Result

from aerodima.optimisation.swing.feedback_gains import FEEDBACK_NAMES, discretise, lqr_gains, with_feedback
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.swing_file import SwingFile, car_mismatches, read_swing, swing_from_dict, write_swing
from aerodima.workbench.controllers.law_of_scenario import own_turn
from aerodima.workbench.controllers.swing_reference import SwingReference
from aerodima.workbench.controllers.swing_tracker_law import SwingTracker
from aerodima.workbench.errors import SwingError
from aerodima.workbench.metrics.turn_metrics import RunMetrics, metrics_of
from aerodima.workbench.resources import model_path
from aerodima.workbench.simulate.simulation import simulate

EARLIER = Path(__file__).parent / "data" / "roll_4_5.yaml"
"""A refined swing of version 0.1.0, for a car of its own."""


def test_a_long_horizon_gives_the_gains_of_the_algebraic_riccati_equation() -> None:
    A, B = discretise(np.array([[[0.0, 1.0], [4.0, 0.0]]]), np.array([[[0.0], [2.0]]]), 0.01)
    Q, R = np.diag([3.0, 0.5]), 0.1
    P = solve_discrete_are(A[0], B[0], Q, [[R]])
    expected = (B[0].T @ P @ A[0]) / (R + B[0].T @ P @ B[0])
    gains = lqr_gains(np.repeat(A, 2000, axis=0), np.repeat(B, 2000, axis=0), Q, R, Q)
    np.testing.assert_allclose(gains[0], expected[0], rtol=1e-9)


def test_one_tick_from_the_end_only_the_end_counts() -> None:
    """min R u^2 + q (a x + b u)^2 has u = -q a b x / (R + q b^2)."""
    (gain,) = lqr_gains(np.array([[[0.9]]]), np.array([[[0.2]]]), np.eye(1), 0.5, np.array([[7.0]]))
    assert gain[0] == pytest.approx(7.0 * 0.9 * 0.2 / (0.5 + 7.0 * 0.2**2))


def test_zero_order_hold_of_a_double_integrator() -> None:
    A, B = discretise(np.array([[[0.0, 1.0], [0.0, 0.0]]]), np.array([[[0.0], [1.0]]]), 0.1)
    np.testing.assert_allclose(A[0], [[1.0, 0.1], [0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(B[0], [[0.005], [0.1]], atol=1e-12)


def turn(*settings: str) -> Scenario:
    return load_scenario("turn_designed", ["manoeuvre.speed=3.61", "manoeuvre.duration=3.2", *settings])


def thesis() -> SwingFile:
    return read_swing(model_path("swings/thesis_8_rad_per_s.yaml"))


@pytest.fixture(scope="module")
def tracked() -> SwingFile:
    # The highest friction that the joints' own controllers survive is between 0.93 and 0.95.
    return with_feedback(thesis(), turn("car.tyre_friction=0.9"))


def play(swing: SwingFile, tracking: str, scenario: Scenario) -> RunMetrics:
    tracker = SwingTracker.from_scenario(swing, scenario)
    reference = SwingReference(swing, tracking, tracker.rate)  # type: ignore[arg-type]
    law = SwingTracker(reference, tracker.settings, tracker.filter_settings)
    return metrics_of(simulate(scenario, record="outcome", law=law))


def test_gains_push_a_late_tail_on_and_answer_a_leaning_car_with_torque_outwards(tracked: SwingFile) -> None:
    """The tail's reaction on the car is the torque's opposite, so a car that leans out asks for more of it."""
    feedback = tracked.gains.feedback
    assert feedback is not None
    assert feedback.states == FEEDBACK_NAMES
    gains = np.array(feedback.roll_gains)
    tail_roll, tail_rate = gains[5:30, 2], gains[5:30, 3]
    lifted = np.array(feedback.nominal)[:, 0] > math.radians(5.0)
    assert np.median(gains[lifted, 0]) < -5.0, "on two wheels the car falls by itself"
    assert np.median(tail_roll) > 1.0
    assert np.median(tail_rate) > 0.1
    assert swing_from_dict(tracked.model_dump(mode="json", by_alias=True, exclude_none=True)) == tracked


def test_on_the_car_it_was_made_for_every_tracking_gives_the_same_turn(tracked: SwingFile) -> None:
    quiet = [f"imu.{name}=0" for name in ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")]
    scenario = turn("car.tyre_friction=0.9", *quiet)
    peaks = [play(tracked, way, scenario).peak_roll_rad for way in ("joint_pd", "feedback", "torque")]
    assert max(peaks) - min(peaks) < math.radians(1.5)


def test_feedback_keeps_a_car_flatter_on_more_grip_than_it_was_made_for(tracked: SwingFile) -> None:
    scenario = turn("car.tyre_friction=0.93")
    roll = {way: play(tracked, way, scenario).peak_roll_rad for way in ("joint_pd", "feedback", "torque")}
    assert roll["feedback"] < 0.75 * roll["joint_pd"]
    assert roll["torque"] < 0.75 * roll["joint_pd"]


def test_gains_stay_finite_where_grip_and_lifted_wheels_undo_the_inertia_of_the_planar_model() -> None:
    swing = read_swing(EARLIER)
    found = swing.provenance.found
    friction = float(found["survived_friction"]) - 0.0125
    edge = load_scenario(
        "turn_designed", ["manoeuvre.speed=4.5", "manoeuvre.duration=3.4", f"car.tyre_friction={friction}"]
    )
    feedback = with_feedback(swing, edge).gains.feedback
    assert feedback is not None
    assert np.max(np.abs(feedback.roll_gains)) < 2000.0


def test_command(tmp_path: Path) -> None:
    def call(*words: object) -> Result:
        return CliRunner().invoke(build_app(), ["feedback", *map(str, words)], catch_exceptions=False)

    out, short = tmp_path / "tracked.yaml", ("--set", "manoeuvre.duration=3.0")
    result = call("thesis_8_rad_per_s", "--out", out, *short)
    assert result.exit_code == 0, result.output
    tracked = read_swing(out)
    assert tracked.gains.feedback is not None
    # The gains are those of a car and its turn, also of a swing that was for any.
    assert car_mismatches(tracked, load_scenario(*own_turn(tracked)).resolved()) == []
    others = car_mismatches(tracked, load_scenario("turn_swing", ["car.mass=6.5"]).resolved())
    assert [line.partition(":")[0] for line in others] == ["car.mass"]
    assert "exists already" in call("thesis_8_rad_per_s", "--out", out).stderr
    light = write_swing(thesis().model_copy(update={"car": {"tail.mass": 0.1}}), tmp_path / "light.yaml")
    refusal = call(light, "--out", tmp_path / "other.yaml", *short)
    assert (refusal.exit_code, "tail.mass: made for 0.1" in refusal.stderr) == (2, True)


def test_no_feedback_around_a_fall_or_around_a_swing_that_never_starts() -> None:
    with pytest.raises(SwingError, match="the car rolls over while its joints follow the knots"):
        with_feedback(thesis(), turn("car.tyre_friction=1.0", "manoeuvre.duration=2.8"))
    with pytest.raises(SwingError, match="the swing was never released"):
        with_feedback(thesis(), turn("manoeuvre.steer_angle=0.02", "manoeuvre.duration=2.8"))
