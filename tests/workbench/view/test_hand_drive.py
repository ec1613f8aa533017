"""A car that is driven by hand: what the driver asks for is done, logged and measured, in simulated
time.
"""

import math

import numpy as np
import pytest

from aerodima.workbench.car.turn_signals import turn_signals
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view import hand_drive
from aerodima.workbench.view.captions import run_caption
from aerodima.workbench.view.hand_drive import (
    CONTROL_PERIOD,
    DISPLAY_PERIOD,
    TAIL_SPEED,
    ManualInput,
    drive_by_hand,
)


class Clock:
    """Time that passes when somebody sleeps, and by `busy` s whenever it is read."""

    def __init__(self, busy):
        self.now = 0.0
        self.busy = busy
        self.slept = 0.0

    def monotonic(self):
        self.now += self.busy
        return self.now

    def sleep(self, time):
        self.now += time
        self.slept += time


class Script:
    """Controls that follow a function of the number of looks; one look is `CONTROL_PERIOD` of the
    run.
    """

    def __init__(self, plan):
        self.plan = plan
        self.looks = -1
        self.shown = []

    def poll(self):
        self.looks += 1
        return self.plan(self.looks)

    def show(self, *now):
        self.shown.append(now)


def left_turn(look):
    """2 m/s; from 1.2 s on to the left, the tail's roll by hand to 0.5 rad; straight again from 2 s
    on.
    """
    time = look * CONTROL_PERIOD
    steering = 0.2 if 1.2 <= time < 2.0 else 0.0
    return ManualInput(steering, 2.0, 1.0, 0.5 if time >= 1.2 else math.nan)


def driven(folder, plan, clock, **options):
    script = Script(plan)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hand_drive, "wall", clock)
        return script, drive_by_hand(
            load_scenario("turn_swing"), script, log=folder / "run.parquet", **options
        )


@pytest.fixture(scope="module")
def left_drive(tmp_path_factory):
    script, (log,) = driven(tmp_path_factory.mktemp("left"), left_turn, Clock(0.0), length=2.6)
    return script, read_run_log(log)


@pytest.fixture
def left(left_drive):
    return left_drive[1]


@pytest.mark.slow
def test_driver_is_shown_time_speed_and_heading_of_the_run(
    left_drive,
):
    (script, log) = left_drive
    columns = ("velocity_x_truth_m_per_s", "velocity_y_truth_m_per_s", "yaw_truth_rad")
    time, speeds, headings, _ = np.array(script.shown).T
    assert np.diff(time) == pytest.approx(DISPLAY_PERIOD)
    along, across, yaw = (np.interp(time, log.time, log.signal(name)) for name in columns)
    assert speeds == pytest.approx(np.hypot(along, across), abs=0.03)
    assert headings == pytest.approx(yaw, abs=0.01)


def test_speed_steering_and_tail_do_what_was_asked_for(left):
    assert left.signal("velocity_x_truth_m_per_s")[left.time > 1.1][0] == pytest.approx(
        2.0, abs=0.1
    )
    assert left.signal("yaw_truth_rad")[-1] > 0.3, "to the left"
    tail = left.signal("tail_roll_angle_rad")
    time = left.time
    before = tail[time < 1.2]
    after = tail[-1]
    assert before[-1] == pytest.approx(-math.pi / 2, abs=0.1), "the law holds it inside"
    assert after == pytest.approx(0.5, abs=0.1)
    fastest = np.max(np.abs(np.diff(left.signal("tail_roll_command_position_rad"))))
    assert fastest == pytest.approx(TAIL_SPEED / 100.0, rel=0.01)


def test_log_says_who_drove_and_its_metrics_are_those_of_the_steering_given(left):
    assert "driven by hand (simulation)" in run_caption(left).text
    window = turn_signals(left).window
    assert window == pytest.approx((1.2, 2.0), abs=0.03)
    assert metrics_of(left).direction == "left"


@pytest.mark.slow
def test_reset_begins_a_second_log_from_standstill_and_end_ends(tmp_path):
    def plan(look):
        return ManualInput(0.0, 2.0, attempt=int(look >= 30), over=look >= 60)

    _, logs = driven(tmp_path, plan, Clock(0.0))
    assert [log.name for log in logs] == ["run.parquet", "run_2.parquet"]
    first, second = (read_run_log(log) for log in logs)
    assert first.time[-1] == pytest.approx(0.58, abs=0.05)
    assert second.time[0] == 0.0
    assert abs(second.signal("velocity_x_truth_m_per_s")[0]) < 0.1


def test_a_pause_costs_no_simulated_time(tmp_path):
    def plan(look):
        return ManualInput(0.0, 1.0, pace=0.0 if 5 <= look < 50 else 1.0, over=look >= 60)

    _, (log,) = driven(tmp_path, plan, Clock(0.0))
    assert read_run_log(log).time[-1] == pytest.approx(
        (60 - 45) * CONTROL_PERIOD, abs=2 * CONTROL_PERIOD
    )


def test_half_speed_takes_twice_as_long(tmp_path):
    clock = Clock(0.0)
    driven(tmp_path, lambda look: ManualInput(pace=0.5), clock, length=0.6)
    assert clock.slept == pytest.approx(1.2, rel=0.04)


@pytest.mark.slow
def test_a_slow_computer_slows_the_run_down_says_so_once_and_skips_nothing(tmp_path):
    said = []
    script, (log,) = driven(
        tmp_path, lambda look: ManualInput(), Clock(0.02), length=2.5, say=said.append
    )
    assert len(said) == 1
    assert "this computer keeps up at 0.4" in said[0] or "this computer keeps up at 0.5" in said[0]
    _, _, _, pace = script.shown[-1]
    assert 0.4 < pace < 0.6
    assert np.max(np.diff(read_run_log(log).time)) < 0.003, "every row is there"
