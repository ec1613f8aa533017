import csv
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_machine import SwingLaw, SwingMemory
from aerodima.workbench.control.tail_law import Observation
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.resources import model_path
from tests.refusals import assert_refused
from tests.workbench.control.published_law import published

INSIDE_LEFT = -math.pi / 2
"""Where the tail waits for a left turn: it lies to the left."""


SETTINGS = published()
LEFT, RIGHT, NONE = 1.0, -1.0, 0.0
HELD_LEFT = [INSIDE_LEFT, 0.0, 17.0, 5.0, 0.0]
"""Command of a tail that waits for a left turn."""


def see(time=0.0, roll=INSIDE_LEFT, yaw_rate=0.0, plan=LEFT, valid=True, pitch=0.0):
    return Observation(time, yaw_rate, roll, pitch, plan, valid)


def run(observations, settings=SETTINGS, memory=None):
    """States and roll commands, tick by tick, and the last memory."""
    memory = memory or SwingMemory()
    states = []
    commands = []
    for observation in observations:
        memory, _, command = SwingLaw(settings).tick(memory, observation)
        states.append(SwingState(memory.state).name)
        commands.append(command)
    return states, np.array(commands), memory


def memory_in(state, settings=SETTINGS):
    """Memory of a law that a left turn led into a state; the time is then at most 1 s."""
    seen = [see(0.0)]
    if state != "HOLD":
        seen.append(see(0.5, yaw_rate=1.5))
    if state == "SETTLE":
        seen.append(see(0.8, INSIDE_LEFT + settings.travel))
    states, _, memory = run(seen, settings)
    assert states[-1] == state
    return memory


def test_defaults_are_table_6_4_read_with_the_errata():
    with model_path("published/tail_controller_states.csv").open() as file:
        rows = {int(row["sequence_no"]): row for row in csv.DictReader(file)}
    rows_of_states = {
        SwingState.HOLD: (rows[1], SETTINGS.hold_kp, SETTINGS.hold_kd),
        SwingState.DELAY: (rows[2], SETTINGS.hold_kp, SETTINGS.hold_kd),
        SwingState.SWING: (rows[3], SETTINGS.swing_kp, SETTINGS.swing_kd),
        SwingState.SETTLE: (rows[4], SETTINGS.settle_kp, SETTINGS.settle_kd),
    }
    for state, (row, kp, kd) in rows_of_states.items():
        assert int(row["sequence_no"]) == state
        assert (float(row["kp"]), float(row["kd"])) == (kp, kd)
    assert float(rows[3]["velocity_rad_per_s"]) == SETTINGS.swing_speed
    assert abs(float(rows[1]["position_rad"])) == pytest.approx(SETTINGS.hold_angle)


def test_a_left_turn_from_hold_to_the_end():
    observations = [
        see(0.00),
        see(0.01, yaw_rate=0.99),
        see(0.02, yaw_rate=1.01),
        see(0.10, roll=INSIDE_LEFT + math.radians(129.9), yaw_rate=3.0),
        see(0.30, roll=INSIDE_LEFT + math.radians(130.1), yaw_rate=3.0),
        see(0.50, roll=math.pi / 2, yaw_rate=2.0),
        see(2.00, roll=math.pi / 2, yaw_rate=5.0),
    ]
    states, commands, _ = run(observations)
    assert states == [
        *["HOLD"] * 2,
        *["SWING"] * 2,
        *["SETTLE"] * 3,
    ]
    assert_allclose(commands[0], HELD_LEFT)
    assert_allclose(commands[2], [0.0, 8.0, 0.0, 3.0, 0.0])
    assert_allclose(commands[4], [math.pi / 2, 0.0, 5.0, 2.0, 0.0])


def test_travel_is_measured_from_where_the_swing_began():
    drooped = INSIDE_LEFT + 0.2
    memory = run([see(0.0, drooped), see(0.5, drooped, yaw_rate=1.5)])[2]
    assert memory.state == SwingState.SWING
    at_nominal = run([see(0.7, INSIDE_LEFT + SETTINGS.travel + 0.01)], memory=memory)[0]
    assert at_nominal == ["SWING"]
    assert run([see(0.7, drooped + SETTINGS.travel + 0.01)], memory=memory)[0] == ["SETTLE"]


@pytest.mark.parametrize(
    "observation",
    [
        see(0.5, yaw_rate=-3.0),
        see(0.5, yaw_rate=1.0),
        see(0.5, yaw_rate=3.0, valid=False),
        see(0.5, yaw_rate=math.nan),
        see(0.5, yaw_rate=3.0, roll=math.nan),
        see(math.nan, yaw_rate=3.0),
        see(0.5, yaw_rate=3.0, plan=math.nan),
        see(0.5, yaw_rate=3.0, plan=NONE),
    ],
    ids=[
        "wrong sign",
        "at the limit",
        "silent",
        "NaN rate",
        "NaN angle",
        "NaN time",
        "NaN plan",
        "no plan",
    ],
)
def test_what_must_not_trigger(observation):
    memory = memory_in("HOLD")
    states, commands, _ = run([observation], memory=memory)
    assert states == ["HOLD"]
    assert_allclose(commands[0], HELD_LEFT)


def test_delay_state_waits_with_the_hold_command_even_if_the_yaw_rate_is_gone():
    settings = published(delay=0.05)
    observations = [
        see(0.0),
        *(see(0.01 * tick, yaw_rate=1.5 if tick == 10 else 0.0) for tick in range(10, 17)),
    ]
    states, commands, _ = run(observations, settings)
    assert states == ["HOLD", *["DELAY"] * 5, "SWING", "SWING"]
    assert_allclose(commands[3], HELD_LEFT)


@pytest.mark.parametrize("plan", [NONE, RIGHT])
def test_withdrawing_the_turn_cancels_the_delay(plan):
    settings = published(delay=0.05)
    memory = memory_in("DELAY", settings)
    states, _, _ = run([see(0.52, plan=plan), see(0.60, plan=plan)], settings, memory)
    assert states[0] == ("HOLD" if plan == NONE else "RECOCK")
    assert "SWING" not in states


def test_a_swing_once_begun_ignores_the_plan_and_the_imu():
    memory = memory_in("SWING")
    for change in ({"plan": NONE}, {"plan": RIGHT}, {"yaw_rate": math.nan}, {"valid": False}):
        states, commands, _ = run([see(0.6, roll=0.0, **change)], memory=memory)
        assert states == ["SWING"]
        assert commands[0][1] == 8.0


def test_swinging_tail_whose_angle_is_lost_is_held_where_it_was_last_seen():
    memory = run([see(0.6, roll=0.3)], memory=memory_in("SWING"))[2]
    states, commands, memory = run([see(0.61, roll=math.nan)], memory=memory)
    assert states == ["SWING"]
    assert_allclose(commands[0], [0.3, 0.0, 17.0, 5.0, 0.0])
    assert run([see(0.62, roll=0.35)], memory=memory)[1][0][1] == 8.0


def test_blocked_swing_gives_up_instead_of_pushing_for_ever():
    """Three times the 0.284 s that 130 degrees take at 8 rad/s."""
    memory = memory_in("SWING")
    assert run([see(0.5 + 0.84, roll=-1.0)], memory=memory)[0] == ["SWING"]
    assert run([see(0.5 + 0.86, roll=-1.0)], memory=memory)[0] == ["SETTLE"]


def test_held_tail_never_swings():
    settings = published(mode="held")
    states, commands, _ = run(
        [see(0.0), *(see(0.1 * k, yaw_rate=4.0) for k in range(1, 20))], settings
    )
    assert set(states) == {"HOLD"}
    assert np.all(commands == commands[0])


def test_no_tail_gets_no_command():
    settings = published(mode="none")
    memory, pitch_command, roll_command = SwingLaw(settings).tick(
        SwingMemory(), see(0.0, yaw_rate=4.0)
    )
    assert memory.state == SwingState.OFF
    assert not pitch_command.any()
    assert not roll_command.any()


def test_gains_are_zero_until_the_tail_angle_is_known():
    memory, pitch_command, roll_command = SwingLaw(SETTINGS).tick(
        SwingMemory(), see(0.0, roll=math.nan)
    )
    assert not pitch_command.any()
    assert not roll_command.any()
    assert run([see(0.01)], memory=memory)[0] == ["HOLD"]


def test_next_turn_to_the_same_side_recocks_slowly_then_swings_again():
    outside = math.pi / 2
    memory = memory_in("SETTLE")
    states, _, memory = run([see(3.0, outside, plan=NONE)], memory=memory)
    assert states == ["SETTLE"]
    on_the_way = [see(4.0 + 0.5 * k, outside - 0.5 * k, yaw_rate=4.0) for k in range(5)]
    states, commands, memory = run(on_the_way, memory=memory)
    assert set(states) == {"RECOCK"}, "a tail that is not on the inside must not swing"
    assert_allclose(commands[:, 0], outside - SETTINGS.recock_speed * 0.5 * np.arange(5))
    assert_allclose(commands[:, 1], -SETTINGS.recock_speed)
    assert_allclose(commands[:, 2:], [[5.0, 2.0, 0.0]] * 5)
    end = 4.0 + math.pi / SETTINGS.recock_speed
    states, commands, memory = run([see(end - 0.01, -1.5), see(end + 0.01, -1.5)], memory=memory)
    assert states == ["RECOCK", "HOLD"]
    assert_allclose(commands[1], HELD_LEFT)
    assert run([see(end + 0.5, -1.5, yaw_rate=1.2)], memory=memory)[0] == ["SWING"]


def test_next_turn_to_the_other_side_finds_the_tail_on_its_inside():
    memory = memory_in("SETTLE")
    states, commands, memory = run([see(3.0, 1.4, yaw_rate=2.0, plan=RIGHT)], memory=memory)
    assert states == ["HOLD"]
    assert_allclose(commands[0], [math.pi / 2, 0.0, 17.0, 5.0, 0.0])
    states, commands, _ = run([see(3.2, 1.4, yaw_rate=-1.2, plan=RIGHT)], memory=memory)
    assert states == ["SWING"]
    assert commands[0][1] == -8.0


def test_change_of_plan_turns_the_recock_round_without_a_jump():
    memory = run([see(0.0, math.pi / 2)])[2]
    states, commands, memory = run([see(0.4, math.pi / 2 - 0.6)], memory=memory)
    states, commands, memory = run(
        [see(0.41, 0.95, plan=RIGHT), see(0.51, 1.0, plan=RIGHT)], memory=memory
    )
    assert states == ["RECOCK", "RECOCK"]
    assert_allclose(commands[:, 0], [0.95, 0.95 + 0.1 * SETTINGS.recock_speed])
    assert commands[1][1] == SETTINGS.recock_speed


@pytest.mark.parametrize(("roll", "side"), [(-1.4, -1.0), (1.4, 1.0), (0.0, -1.0)])
def test_without_any_plan_the_tail_is_held_on_the_side_where_it_is(roll, side):
    settings = published(ready_angle=2.0)
    _, commands, _ = run([see(0.0, roll, plan=NONE)], settings)
    assert commands[0][0] == side * math.pi / 2


def test_tail_far_from_the_inside_is_led_there_at_the_start():
    states, commands, _ = run([see(0.0, 0.0)])
    assert states == ["RECOCK"]
    assert_allclose(commands[0], [0.0, -SETTINGS.recock_speed, 5.0, 2.0, 0.0])


@pytest.mark.parametrize("delay", [0.0, 0.03])
def test_right_turn_is_the_mirror_image_of_the_left_turn(delay):
    """A made-up run through every state; the mirror flips roll, yaw rate and plan."""
    settings = published(delay=delay)
    rng = np.random.default_rng(3)
    times = 0.01 * np.arange(600)
    rolls = np.interp(times, [0.0, 1.0, 1.4, 3.0, 6.0], [-1.5, -1.5, 1.5, 1.5, -1.5])
    yaw_rates = np.where((times > 0.9) & (times < 2.0), 2.0, 0.0) + 0.1 * rng.standard_normal(600)
    plans = np.where(times < 2.5, 1.0, np.where(times < 2.8, 0.0, 1.0))
    left = [
        see(t, roll, rate, plan)
        for t, roll, rate, plan in zip(times, rolls, yaw_rates, plans, strict=True)
    ]
    right = [see(o.time, -o.roll_angle, -o.yaw_rate, -o.planned_turn) for o in left]
    left_states, left_commands, _ = run(left, settings)
    right_states, right_commands, _ = run(right, settings)
    expected = {"HOLD", "SWING", "SETTLE", "RECOCK"}
    assert set(left_states) == expected | ({"DELAY"} if delay else set())
    assert left_states == right_states
    assert_array_equal(left_commands * [-1, -1, 1, 1, 1], right_commands)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("mode", "swung", ("'none'", "'held'", "'swing'")),
        ("swing_speed", 0.0, ("rad/s",)),
        ("hold_kd", 5.1, ("N m s/rad",)),
        ("travel", 3.2, ("hold_angle",)),
        ("trigger", "roll", ("'yaw_rate'",)),
    ],
)
def test_impossible_settings_are_named(key, value, named):
    assert_refused(lambda: published(**{key: value}), UserError, key, str(value), *named)


def other_trigger(
    trigger, acceleration=0.0, steering=math.nan, yaw_rate=0.0, plan=LEFT, valid=True
):
    """State after one look at a tail that waits inside, with another trigger than the yaw rate;
    signals count into the turn.
    """
    settings = published(
        trigger=trigger, trigger_lateral_acceleration=3.0, trigger_steering_angle=0.1
    )
    memory = run([see(0.0, -plan * math.pi / 2, plan=plan)], settings)[2]
    seen = Observation(
        0.5,
        plan * yaw_rate,
        -plan * math.pi / 2,
        0.0,
        plan,
        valid,
        imu=(0.0,) * 7 + (plan * acceleration, 0.0),
        steering_angle=plan * steering,
    )
    return SwingState(SwingLaw(settings).tick(memory, seen)[0].state).name


@pytest.mark.parametrize("plan", [LEFT, RIGHT])
@pytest.mark.parametrize(
    ("trigger", "signals", "swings"),
    [
        ("lateral_acceleration", {"acceleration": 3.1}, True),
        ("lateral_acceleration", {"acceleration": 2.9, "yaw_rate": 5.0}, False),
        ("lateral_acceleration", {"acceleration": -9.0}, False),
        ("lateral_acceleration", {"acceleration": 9.0, "valid": False}, False),
        ("steering", {"steering": 0.5, "valid": False}, True),
        ("steering", {"steering": -0.5}, False),
        ("steering", {"yaw_rate": 5.0}, False),  # the command is not known
    ],
)
def test_acceleration_or_steering_into_the_turn_start_the_swing_where_they_are_the_trigger(
    trigger, signals, swings, plan
):
    state = other_trigger(trigger, plan=plan, **signals)
    assert state == ("SWING" if swings else "HOLD")
