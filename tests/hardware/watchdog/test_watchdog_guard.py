"""When the watchdog process acts, in simulated time."""

import pytest

from aerodima.hardware.car.safety_settings import load_watchdog_timing
from aerodima.hardware.watchdog.watchdog_process import Guard, Word

TIMING = load_watchdog_timing()


def beating(until):
    guard = Guard(TIMING)
    guard.take(Word.ARMED.value, 0.0)
    for cycle in range(round(until / 0.01) + 1):
        guard.take(Word.BEAT.value, 0.01 * cycle)
        guard.look(0.01 * cycle)
    return guard


def test_it_is_quiet_while_the_heart_beats():
    assert beating(5.0).cause == ""


def test_a_missing_heartbeat_makes_it_act_after_the_timeout_and_for_good():
    guard = beating(1.0)
    guard.look(1.0 + TIMING.heartbeat_timeout)
    assert guard.cause == ""
    guard.look(1.001 + TIMING.heartbeat_timeout)
    assert guard.cause.startswith("no heartbeat for 0.15")
    guard.take(Word.BEAT.value + Word.DISARMED.value, 2.0)
    guard.look(2.0)
    assert guard.cause


def test_no_heartbeat_is_needed_before_arming_and_after_disarming():
    guard = Guard(TIMING)
    guard.look(100.0)
    guard.take(Word.ARMED.value, 100.0)
    guard.take(Word.DISARMED.value, 100.1)
    guard.look(200.0)
    assert guard.cause == ""


@pytest.mark.parametrize("armed", [True, False])
def test_the_end_of_the_pipe_is_a_death(armed):
    guard = beating(0.1) if armed else Guard(TIMING)
    guard.end(0.2)
    assert (guard.cause, guard.cause_time) == ("the drive process died", 0.2)


def test_quitting_in_order_is_no_death_but_quitting_while_armed_is():
    guard = Guard(TIMING)
    guard.take(Word.QUIT.value, 0.0)
    guard.end(0.0)
    assert guard.cause == ""
    guard = beating(0.1)
    guard.take(Word.QUIT.value, 0.1)
    guard.end(0.1)
    assert guard.cause


def test_it_acts_when_asked_to_and_the_first_cause_counts():
    guard = beating(0.1)
    guard.take(b"?x" + Word.TRIP.value, 0.1)
    guard.end(0.5)
    assert (guard.cause, guard.cause_time) == ("asked to by the drive process", 0.1)
