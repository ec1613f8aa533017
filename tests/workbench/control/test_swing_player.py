"""The player on a made-up swing: by hand, tick by tick, without plant."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_library import refuse_other_car, turn_of_swing, turn_words
from aerodima.workbench.control.swing_machine import SwingLaw
from aerodima.workbench.control.swing_player import LARGEST_ERROR, SwingPlayer
from aerodima.workbench.control.tail_law import UNKNOWN_IMU, Observation
from aerodima.workbench.core.errors import SwingFileError
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.swing_file import swing_from_dict
from tests.refusals import assert_named, assert_refused
from tests.workbench.control.published_law import published

INSIDE, OUTSIDE, LENGTH = -1.5, 1.2, 0.5
TICK = 0.01


def swing(**changes):
    """From -1.5 to 1.2 rad in 0.5 s, evenly: 5.4 rad/s at 0.4 N m."""
    rate = (OUTSIDE - INSIDE) / LENGTH
    data = {
        "schema": "aerodima/swing/1", "name": "made up", "direction": "left",
        "trigger": {"kind": "yaw_rate", "threshold_rad_per_s": 1.0},
        "knots": {
            "time_s": [0.0, LENGTH], "roll_position_rad": [INSIDE, OUTSIDE],
            "roll_velocity_rad_per_s": [rate, rate],
            "pitch_position_rad": [0.1, 0.3], "pitch_velocity_rad_per_s": [0.4, 0.4],
            "roll_torque_n_m": [0.4, 0.4],
        },
        "gains": {
            "hold": {"kp": 17.0, "kd": 5.0},
            "phases": [{"start_s": 0.0, "roll": {"kp": 6.0, "kd": 1.0}, "pitch": {"kp": 17.0,
            "kd": 2.0}}],
        },
        "limits": {
            "roll_position_rad": 1.571, "pitch_position_rad": 0.6, "velocity_rad_per_s": 12.0,
            "torque_n_m": 3.0,
        },
        "provenance": {"source": "a test"},
    }  # fmt: skip
    for key, value in changes.items():
        place = data
        *path, last = key.split("__")
        for part in path:
            place = place[part]
        place[last] = value
    return swing_from_dict(data)


def player(**changes):
    return SwingPlayer(swing(**changes), published())


def see(time, roll=INSIDE, *, yaw_rate=0.0, plan=1.0, **more):
    imu = (0.1, 0.0, 0.0, 0.0, 0.0, yaw_rate, 0.0, 0.0, 0.0)
    given = {
        "time": time, "yaw_rate": yaw_rate, "roll_angle": roll, "pitch_angle": 0.1,
        "planned_turn": plan,
        "imu_valid": True, "roll_rate": 0.0, "pitch_rate": 0.0, "imu": imu, "speed": 0.0,
    }  # fmt: skip
    return Observation(**(given | more))


def run(law, *seen):
    """Name of the state, pitch command and roll command after each tick."""
    memory = law.start()
    ticks = []
    for observation in seen:
        memory, pitch, roll, state = law.step(memory, observation)
        ticks.append((SwingState(state).name, pitch, roll))
    return ticks


def states(law, *seen):
    """Name of the state after each tick."""
    return [state for state, _, _ in run(law, *seen)]


def released(time, **at_release):
    """Hold, trigger, and one look at `time` s after the release."""
    return [see(0.0), see(0.5, yaw_rate=1.5), see(0.5 + time, **at_release)]


def test_waits_at_the_first_knot_and_releases_on_a_yaw_rate_into_the_turn_only():
    ticks = run(
        player(),
        see(0.0),
        see(0.1, yaw_rate=-2.0),
        see(0.2, yaw_rate=math.nan),
        see(0.25, yaw_rate=2.0, imu_valid=False, imu=UNKNOWN_IMU),
        see(0.3, yaw_rate=1.2),
    )
    assert [state for state, _, _ in ticks] == ["HOLD"] * 4 + ["SWING"]
    _, pitch, roll = ticks[0]
    assert_allclose(roll, [INSIDE, 0.0, 17.0, 5.0, 0.0])
    assert_allclose(pitch, [0.1, 0.0, 17.0, 5.0, 0.0])


def test_delay_and_time_since_the_announcement():
    delayed = player(trigger={"kind": "yaw_rate", "threshold_rad_per_s": 1.0, "delay_s": 0.05})
    seen = [see(0.0), see(0.1, yaw_rate=2.0), see(0.14), see(0.15)]
    assert states(delayed, *seen) == ["HOLD", "DELAY", "DELAY", "SWING"]
    later = replace(delayed, settings=delayed.settings.model_copy(update={"delay": 0.02}))
    seen = [see(0.0), see(0.1, yaw_rate=2.0), see(0.16), see(0.17)]
    assert states(later, *seen) == ["HOLD", "DELAY", "DELAY", "SWING"], (
        "the controller's delay comes on top of the file's"
    )
    steered = player(trigger={"kind": "steering", "threshold_rad": 0.1})
    seen = [see(0.0, steering_angle=-0.5), see(0.1, yaw_rate=2.0), see(0.2, steering_angle=0.5)]
    assert states(steered, *seen) == ["HOLD", "HOLD", "SWING"]
    timed = player(trigger={"kind": "time", "delay_s": 0.3})
    seen = [see(1.0, plan=0.0), see(2.0), see(2.29, yaw_rate=3.0), see(2.3)]
    assert states(timed, *seen) == ["HOLD", "HOLD", "HOLD", "SWING"]


def test_torque_stays_inside_the_limit_of_the_file():
    late = INSIDE + 5.4 * 0.1 - 0.45
    _, _, roll = run(player(), *released(0.1, roll=late, roll_rate=5.4))[-1]
    position, velocity, kp, kd, torque = roll
    assert kp * (position - late) + kd * (velocity - 5.4) + torque == pytest.approx(3.0)


def test_the_joints_follow_the_knots_with_their_gains_and_torque():
    _, pitch, roll = run(player(), *released(0.1, roll=INSIDE + 0.5, roll_rate=5.0))[-1]
    assert_allclose(roll, [INSIDE + 5.4 * 0.105, 5.4, 6.0, 1.0, 0.4], atol=1e-12)
    assert_allclose(pitch, [0.1 + 0.4 * 0.105, 0.4, 17.0, 2.0, 0.0], atol=1e-12)


def test_after_the_last_knot_the_tail_is_held_there():
    end = see(0.5 + LENGTH, roll=OUTSIDE)
    state, pitch, roll = run(player(), see(0.0), see(0.5, yaw_rate=1.5), end)[-1]
    assert state == "SETTLE"
    assert_allclose(roll, [OUTSIDE, 0.0, 6.0, 1.0, 0.0])
    assert_allclose(pitch, [0.3, 0.0, 17.0, 2.0, 0.0])


def test_a_blocked_tail_is_given_up_and_the_thesis_law_finishes():
    seen = [*released(0.25), see(0.76, roll=-1.4), see(1.0, roll=1.0), see(1.01, roll=1.0)]
    ticks = run(player(), *seen)
    assert [state for state, _, _ in ticks] == ["HOLD", "SWING", *["FALLBACK"] * 4]
    assert_allclose(ticks[3][2], [0.0, 8.0, 0.0, 3.0, 0.0])  # Table 6.4: over the top with 8 rad/s
    assert_allclose(ticks[5][2], [math.pi / 2, 0.0, 5.0, 2.0, 0.0])  # then to the outside
    *_, last = run(player(), *seen, see(1.5, roll=1.2, plan=0.0))
    assert last[0] == "FALLBACK"
    assert_allclose(last[2], ticks[5][2])  # also once the turn is over


def test_is_led_back_slowly_for_a_second_turn_to_the_same_side():
    """Announcement withdrawn and given again: from where it is, at 1 rad/s, without a step, then a
    second swing.
    """
    first = [
        see(0.0),
        see(0.5, yaw_rate=1.5),
        see(1.0, roll=OUTSIDE),
        see(1.5, roll=OUTSIDE, plan=0.0),
    ]
    angles = OUTSIDE - np.arange(0.0, 2.7, TICK)
    back = [see(2.0 + i * TICK, roll=roll) for i, roll in enumerate(angles)]
    ticks = run(player(), *first, *back, see(4.8), see(4.9, yaw_rate=1.5))
    names = [state for state, _, _ in ticks]
    assert names[:5] == ["HOLD", "SWING", "SETTLE", "SETTLE", "RECOCK"]
    assert names[-2:] == ["HOLD", "SWING"]
    asked = np.array([roll[0] for state, _, roll in ticks if state == "RECOCK"])
    assert asked[0] == pytest.approx(OUTSIDE)
    assert_allclose(np.diff(asked), -TICK, atol=1e-9)


def test_a_right_turn_is_the_exact_mirror_image():
    """Every angle about x, every yaw rate and the plan change sign: so do the roll commands, and
    nothing else.
    """
    noise = 0.05 * np.random.default_rng(3).normal(size=(90, 9))

    def seen(side):
        for tick, imu in enumerate(noise * [side, 1.0, side, side, 1.0, side, 1.0, side, 1.0]):
            roll = side * np.clip(INSIDE + 5.4 * (tick * TICK - 0.2), INSIDE, OUTSIDE)
            more = {"plan": side, "roll_rate": side * 5.0, "imu": tuple(imu)}
            yield see(tick * TICK, roll, yaw_rate=side * 1.5, **more)

    for (state, pitch, roll), (state_m, pitch_m, roll_m) in zip(
        run(player(), *seen(1.0)), run(player(), *seen(-1.0)), strict=True
    ):
        assert state == state_m
        assert_array_equal(pitch, pitch_m)
        assert_array_equal(roll * [-1, -1, 1, 1, -1], roll_m)


def test_unknown_angles_give_no_unknown_commands():
    unknown = {"roll": math.nan, "roll_rate": math.nan, "pitch_angle": math.nan, "imu": UNKNOWN_IMU}
    assert run(player(), see(0.0, **unknown))[0][0] == "OFF"
    state, pitch, roll = run(player(), *released(0.1, roll=-1.0), see(0.61, **unknown))[-1]
    assert state == "SWING"
    assert_allclose(roll, [-1.0, 0.0, 17.0, 5.0, 0.0])
    assert np.all(np.isfinite(pitch))


def test_a_scenario_names_its_law():
    assert isinstance(law_of_scenario(load_scenario("turn_swing")), SwingLaw)
    named = load_scenario("turn_swing", ["controller.swing_file=thesis_8_rad_per_s"])
    assert isinstance(law_of_scenario(named), SwingPlayer)
    for name in ("nowhere", "nowhere.yaml"):
        unknown = load_scenario("turn_swing", [f"controller.swing_file={name}"])
        assert_refused(partial(law_of_scenario, unknown), SwingFileError, name)
    held = load_scenario("turn_held", ["controller.swing_file=nowhere"])
    assert isinstance(law_of_scenario(held), SwingLaw), "a tail that is held plays no swing"


def test_a_swing_for_another_car_is_refused_by_name(tmp_path):
    from aerodima.workbench.scenario.swing_file import write_swing

    path = write_swing(swing(car={"car.mass": 6.5}), tmp_path / "heavy.yaml")
    scenario = load_scenario("turn_swing", [f"controller.swing_file={path}"])
    named = ("car.mass", "6.5", f"{scenario.car.mass:g}")
    assert_refused(lambda: refuse_other_car(scenario), SwingFileError, *named)
    refuse_other_car(load_scenario("turn_swing", [f"controller.swing_file={path}", "car.mass=6.5"]))


def made_with(scenario, *settings, **found):
    return swing(
        provenance={"source": "made up", "scenario": scenario, "settings": settings, "found": found}
    )


def test_a_swing_brings_its_turn_along():
    """Car and turn of its file, at the speed and friction that it claims to survive; another turn
    sets nothing.
    """
    claims = {"survived_speed_m_per_s": 4.44, "survived_friction": 0.7}
    mine = made_with("turn_fast", "car.mass=6.5", "tail.mode=held", **claims)
    turn = load_scenario(*turn_of_swing(mine))
    assert (turn.car.mass, turn.tail.mode) == (6.5, "swing")
    assert (turn.manoeuvre.speed, turn.car.tyre_friction) == (4.44, 0.7)
    assert_named(turn_words(mine, turn), ("4.44", "0.7"))
    slippery = turn.varied(car={"tyre_friction": 0.9})
    assert_named(turn_words(mine, slippery), ("4.44", "0.9", "0.7"))
    assert turn_of_swing(mine, "turn_held") == ("turn_held", ("tail.mode=swing",))
    assert turn_of_swing(made_with(None)) == ("turn_swing", ("tail.mode=swing",))
    assert_refused(lambda: turn_of_swing(made_with("my_car.yaml")), SwingFileError, "my_car.yaml")
    boast = made_with(None, survived_speed_m_per_s="fast")
    assert_refused(lambda: turn_of_swing(boast), SwingFileError, "survived_speed_m_per_s", "'fast'")


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("pitch_error", "state"), [(0.9, "SWING"), (1.1, "FALLBACK")])
def test_pitch_that_is_too_far_from_its_curve_gives_the_swing_up_to_both_sides(
    side, pitch_error, state
):
    """Roll changes sign with the turn, pitch does not: 0.14 rad is its place after 0.1 s."""
    place = {"roll": side * (INSIDE + 0.54), "pitch_angle": 0.14 + pitch_error * LARGEST_ERROR}
    inside = side * INSIDE
    ticks = run(
        player(),
        see(0.0, inside, plan=side),
        see(0.5, inside, plan=side, yaw_rate=side * 1.5),
        see(0.6, plan=side, **place),
    )
    assert ticks[-1][0] == state
