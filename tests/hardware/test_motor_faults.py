"""Fault table of motor and bus: which fault, how long to the first exit frame, and that nothing is
re-armed.

Times are of a 100 Hz loop; detection within one cycle means that the exit frames leave in the
`step` that reads the offending frame, at most 10 ms after it was on the bus.
"""

import dataclasses
import math
from collections import deque

import pytest

from aerodima.hardware.devices.device_states import MotorFault, MotorState
from aerodima.hardware.protocol.ak70 import MitCommand, decode_reply, make_exit, make_reply
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.core.errors import HardwareError
from tests.hardware.fake_motors import PERIOD, PROFILE, Bench, hold, settings
from tests.refusals import assert_refused

RUN = hold(0.0)


@pytest.fixture
def bench():
    return Bench().to_running(RUN)


def mute(cycles=10**9):
    """Replies that are lost, for so many of them."""
    left = cycles

    def respond(frame):
        nonlocal left
        left -= 1
        return [] if left >= 0 else [frame]

    return respond


def changed(change):
    return lambda frame: [change(frame)]


def answering(change):
    return lambda roll: setattr(roll, "respond", lambda frame: [change(frame)])


def first_bytes(count):
    return answering(lambda frame: CanFrame(frame.arbitration_id, frame.data[:count]))


def double(roll):
    roll.respond = lambda frame: [frame, frame]


def overheat(roll):
    roll.temperature = 81.0


def report(code):
    return lambda roll: setattr(roll, "fault", code)


update_firmware = answering(lambda frame: CanFrame(0x2902, frame.data, extended=True))
CYCLE, MISSED = PERIOD, 5 * PERIOD

FAULTS = {
    "silent": (lambda roll: setattr(roll, "respond", mute()), MotorFault.NO_REPLY, MISSED, "5"),
    "short reply": (first_bytes(5), MotorFault.NO_REPLY, MISSED, "5"),
    "long reply": (first_bytes(7), MotorFault.NO_REPLY, MISSED, "5"),
    "foreign name": (
        answering(lambda frame: CanFrame(0, bytes([9]) + frame.data[1:])),
        MotorFault.NO_REPLY, MISSED, "5",
    ),
    "foreign id": (
        answering(lambda frame: CanFrame(0x123, frame.data)), MotorFault.NO_REPLY, MISSED, "5"
    ),
    "V3 firmware": (update_firmware, MotorFault.WRONG_FIRMWARE, CYCLE, "V3"),
    "hot": (overheat, MotorFault.OVER_TEMPERATURE, CYCLE, "81.0"),
    "reports a fault": (report(2), MotorFault.MOTOR_REPORTED, CYCLE, "over-current"),
    "reports an unknown fault": (report(200), MotorFault.MOTOR_REPORTED, CYCLE, "200"),
    "jumps": (
        lambda roll: setattr(roll, "reading_offset", 0.7),
        MotorFault.POSITION_JUMP, CYCLE, "0.2 rad",
    ),
    "jumps back": (
        lambda roll: setattr(roll, "reading_offset", -0.7),
        MotorFault.POSITION_JUMP, CYCLE, "0.2 rad",
    ),
    "double": (double, MotorFault.DOUBLE_ID, 3 * CYCLE, "2"),
}  # fmt: skip


@pytest.mark.parametrize(("inject", "fault", "within", "named"), FAULTS.values(), ids=FAULTS)
def test_fault_of_a_motor_switches_both_off_in_time_and_for_good(
    bench, inject, fault, within, named
):
    start = bench.now
    inject(bench.fakes[1])
    bench.cycle(RUN, count=100)
    pitch, roll = bench.motors
    assert (roll.state, roll.fault) == (MotorState.FAULTED, fault)
    assert "tail roll" in roll.fault_text
    assert named in roll.fault_text
    assert (pitch.state, pitch.fault) == (MotorState.FAULTED, MotorFault.OTHER_MOTOR)
    assert roll.fault_text == bench.group.fault_text
    for motor_id in (1, 2):
        # one cycle more: the injection acts on the reply to the next frame, which the step after
        # that reads
        assert bench.port.exits(motor_id, start)[0] - start <= within + PERIOD + 1e-9
        assert len(bench.port.exits(motor_id, start)) > 10
    stopped = bench.port.exits(2, start)[0]
    late = [frame for when, frame in bench.port.sent if when > stopped + 1e-9]
    assert set(late) == {make_exit(1), make_exit(2)}
    assert not bench.fakes[0].entered
    assert not bench.fakes[1].entered


@pytest.mark.parametrize("count", [1, 2, 4])
def test_replies_lost_now_and_then_are_no_fault(bench, count):
    for _ in range(3):
        bench.fakes[1].respond = mute(count)
        bench.cycle(RUN, count=count)
        assert bench.motors[1].missed >= count - 1
        bench.fakes[1].respond = mute(0)
        bench.cycle(RUN, count=3)
        assert bench.motors[1].missed == 0
    assert bench.motors[1].state is MotorState.RUNNING


def test_loop_that_catches_up_after_being_late_misses_no_reply(bench):
    bench.cycle(RUN, period=0.1)
    bench.fakes[1].respond = mute(8)  # the answers are still under way
    bench.cycle(RUN, count=8, period=2e-4)
    assert bench.motors[1].missed == 0
    assert bench.group.ready


def test_six_byte_replies_are_enough(bench):
    bench.fakes[1].long_reply = False
    bench.cycle(RUN, count=50)
    assert bench.motors[1].state is MotorState.RUNNING
    assert bench.motors[1].temperature is None


@pytest.mark.parametrize("angle", [math.pi / 2 + 0.2, -math.pi / 2 - 0.2])
def test_tail_beyond_its_range_is_switched_off(bench, angle):
    bench.fakes[1].blocked = True
    for i in range(
        1, 61
    ):  # sooner than a tail that is held away from its command counts as not following
        bench.fakes[1].position = angle * i / 60
        bench.cycle(RUN)
        if bench.motors[1].state is MotorState.FAULTED:
            break
    assert bench.motors[1].fault is MotorFault.OUT_OF_RANGE
    assert abs(bench.motors[1].position) == pytest.approx(math.pi / 2 + 0.15, abs=0.035)


def assert_not_following(bench):
    """Runs until the roll motor has a fault, for 2 s at most: it does not follow."""
    end = bench.now + 2.0
    while bench.motors[1].state is not MotorState.FAULTED and bench.now < end:
        bench.cycle(RUN)
    assert bench.motors[1].fault is MotorFault.NOT_FOLLOWING


def test_a_motor_that_switches_itself_off_is_noticed_once_torque_is_asked_of_it(bench):
    bench.cycle(RUN, count=200)
    off = bench.now
    bench.fakes[1].entered = False
    bench.fakes[1].position += 0.3  # gravity; the loop asks for 17 * 0.3 N m
    assert_not_following(bench)
    assert bench.now - off <= bench.motors[1].settings.safety.follow_time + 0.05
    assert bench.motors[0].fault is MotorFault.OTHER_MOTOR


def test_a_tail_that_is_held_away_from_its_command_is_switched_off(bench):
    bench.cycle(RUN, count=200)
    held = bench.now
    bench.fakes[1].blocked = True
    bench.fakes[1].speed = 0.0
    bench.fakes[1].position += 0.09
    for _ in range(6):
        bench.fakes[1].position += 0.09
        bench.cycle(RUN)
    assert_not_following(bench)
    assert bench.now - held <= bench.motors[1].settings.safety.tracking_time + 0.15


def test_a_motor_that_works_against_something_is_taken_back_to_its_rated_torque_and_switched_off(
    bench,
):
    """I2t: the budget of `overload` beyond the rated torque, then off."""
    motor = bench.motors[1]
    fake = bench.fakes[1]
    safety = motor.settings.safety
    hard = dataclasses.replace(RUN, kp=0.0, kd=0.0, torque=20.0)
    fake.blocked = True
    begin = bench.now
    torques = []
    while motor.state is not MotorState.FAULTED and bench.now < begin + 60.0:
        bench.cycle(RUN, hard)
        torques.append(fake.torque)
    assert motor.fault is MotorFault.OVERLOAD
    assert max(torques) == pytest.approx(20.0, abs=0.05)
    full = safety.overload / (20.0**2 - safety.rated_torque**2)
    assert 0.8 * full < bench.now - begin < 1.5 * full
    assert torques[-1] < 13.0, "taken back over the last fifth of the budget"
    assert motor.load.share < 1.0


@pytest.mark.parametrize("speed", [26.0, -26.0])
def test_tail_that_spins_is_switched_off(bench, speed):
    bench.fakes[1].speed = speed
    bench.cycle(RUN, count=2, period=1e-4)
    assert bench.motors[1].fault is MotorFault.OVER_SPEED


@pytest.mark.parametrize("field", ["position", "velocity", "kp", "kd", "torque"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_commanded_nan_is_a_fault_at_once_and_never_on_the_bus(bench, field, value):
    start = bench.now
    bench.cycle(RUN, dataclasses.replace(RUN, **{field: value}))
    assert bench.motors[1].fault is MotorFault.BAD_COMMAND
    assert bench.port.exits(2, start)[0] - start <= PERIOD + 1e-9
    bench.cycle(RUN)
    assert bench.motors[0].fault is MotorFault.OTHER_MOTOR


def test_bus_fault_switches_off_both(bench):
    start = bench.now
    bench.port.fault = 1
    bench.port.fault_text = "the controller reports bus-off"
    bench.cycle(RUN, count=5)
    assert [motor.fault for motor in bench.motors] == [MotorFault.BUS] * 2
    assert bench.port.exits(1, start)[0] - start <= PERIOD + 1e-9
    assert "bus-off" in bench.group.fault_text


def test_bus_with_a_fault_is_not_entered():
    bench = Bench()
    bench.port.fault = 3
    bench.port.fault_text = "adapter gone"
    assert_refused(lambda: bench.group.set_enter(0.0), HardwareError, "adapter gone")
    assert bench.port.sent == []


@pytest.mark.parametrize("gap", [0.26, 5.0, 1e6, -0.001, -3600.0])
def test_loop_that_stood_still_or_a_clock_that_jumps(bench, gap):
    bench.now += gap
    bench.group.step(bench.now)
    assert bench.motors[0].fault is MotorFault.LOOP_STALLED
    assert len(bench.port.exits(1)) >= 4


def test_motor_that_does_not_answer_is_not_entered():
    bench = Bench()
    bench.fakes[1].respond = mute()
    bench.group.set_enter(0.0)
    bench.cycle(count=100)
    assert bench.motors[1].fault is MotorFault.NO_REPLY
    assert bench.motors[0].fault is MotorFault.OTHER_MOTOR
    first = bench.port.exits(2)[0]
    assert 0.5 <= first <= 0.5 + 2 * PERIOD
    assert all(command.kp == 0 for _, command in bench.commands(2))


def test_replies_are_unwrapped_where_the_reading_wraps():
    # joint range around a zero near the end of the reading: the profile's 12.5 rad lie 0.2 rad
    # beyond the joint's end
    bench = Bench(settings(zero=10.7), positions=[10.7]).to_running(RUN)
    bench.fakes[0].position = 12.5 - 0.15
    bench.fakes[0].speed = 0.0
    before = bench.motors[0].position
    for _ in range(4):
        bench.fakes[0].position += 0.1
        bench.cycle(RUN, period=1e-4)
    assert before == pytest.approx(0.0, abs=0.02)
    # 12.75 reads as -12.25; unwrapped it is beyond the range, not on the other side of it
    assert bench.motors[0].fault in (MotorFault.OUT_OF_RANGE, MotorFault.POSITION_JUMP)
    assert bench.motors[0].position > 1.6


def test_published_swing_passes_without_a_fault():
    """Hold at -90 degrees with (17, 5), 8 rad/s with (0, 3), after 130 degrees position +90 degrees
    with (5, 2).
    """
    bench = Bench(settings(), positions=[-1.5]).to_running(hold(-math.pi / 2))
    while bench.motors[0].position < -math.pi / 2 + math.radians(130):
        bench.cycle(MitCommand(0.0, 8.0, 0.0, 3.0, 0.0))
        assert bench.group.ready, bench.group.fault_text
    bench.cycle(hold(math.pi / 2, 5.0, 2.0), count=100)
    assert bench.group.ready, bench.group.fault_text
    assert bench.motors[0].position == pytest.approx(math.pi / 2, abs=0.05)


class HeldUp:
    """Replies that wait; of those that wait, `most` come at once."""

    def __init__(self):
        self._waiting = []
        self.most = 0

    def __call__(self, frame):
        answers = [*self._waiting, frame][: self.most]
        self._waiting = [*self._waiting, frame][self.most :]
        return answers


@pytest.mark.parametrize("late", [1, 6, 12, 20])
def test_replies_to_all_cycles_of_a_late_loop_that_come_at_once_are_not_taken_for_a_second_motor(
    bench, late
):
    bench.cycle(RUN, period=0.01 * late)
    bench.fakes[1].respond = HeldUp()
    bench.cycle(RUN, count=late, period=5e-4)
    bench.fakes[1].respond.most = late + 1
    bench.cycle(RUN, count=10)
    assert bench.group.ready, bench.group.fault_text


def test_answers_to_exit_frames_of_others_are_no_second_motor(bench):
    bench.fakes[1].respond = lambda frame: [make_exit(2), frame, frame]
    bench.cycle(RUN, count=40)
    assert bench.group.ready, bench.group.fault_text


def test_a_second_motor_is_found_although_replies_were_lost_before(bench):
    for _ in range(10):
        bench.fakes[1].respond = mute(4)
        bench.cycle(RUN, count=7)
    double(bench.fakes[1])
    bench.cycle(RUN, count=32)  # what was lost is owed for 0.25 s
    assert bench.motors[1].fault is MotorFault.DOUBLE_ID


def test_off_is_confirmed_by_replies_and_overdue_without_them(bench):
    roll = bench.motors[1]
    assert not roll.off_confirmed
    bench.group.set_exit(bench.now)
    assert not roll.off_confirmed
    bench.cycle()
    assert roll.off_confirmed
    bench.cycle(count=30)
    bench.to_running(RUN)
    bench.fakes[1].respond = mute()
    bench.group.set_exit(bench.now)
    bench.cycle(count=20)
    assert not roll.off_confirmed
    assert roll.off_overdue(bench.now)


def mirrored(fake):
    """A reply whose angle and speed have the wrong sign."""
    reply = decode_reply(fake.reply(), PROFILE)
    return make_reply(reply._replace(position=-reply.position, velocity=-reply.velocity), PROFILE)


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("where", [-1.4, 0.0, 1.4])
@pytest.mark.parametrize("wrong", ["feedback", "motor"])
def test_a_direction_that_is_reversed_is_found_with_little_torque(joint, where, wrong):
    bench = Bench(positions=[where, where])
    fake = bench.fakes[joint]
    if wrong == "feedback":
        fake.respond = lambda _: [mirrored(fake)]
    else:
        fake.sign = -1.0
    bench.group.set_enter(0.0)
    bench.cycle(count=100)
    assert bench.motors[joint].fault is MotorFault.WRONG_DIRECTION
    assert max(abs(torque) for torque in fake.torques) < 1.5
    assert not bench.fakes[joint].entered


def test_a_joint_that_cannot_move_or_does_not_rest_is_not_held():
    bench = Bench()
    bench.fakes[1].blocked = True
    bench.group.set_enter(0.0)
    bench.cycle(count=150)
    assert bench.motors[1].fault is MotorFault.WRONG_DIRECTION
    bench = Bench()
    bench.fakes[1].speed = 3.0
    bench.group.set_enter(0.0)
    bench.cycle(count=60)
    assert bench.motors[1].fault is MotorFault.WRONG_DIRECTION
    assert max(abs(torque) for torque in bench.fakes[1].torques) < 0.01  # a step of the frame


def aged(cycles):
    """Replies that come in time and are of so many cycles ago."""
    past = deque(maxlen=cycles + 1)

    def respond(frame):
        past.append(frame)
        return [past[0]]

    return respond


def swing(bench, seconds, begin=0.0):
    """The roll joint to and fro by 0.7 rad, 1.5 times a second; the pitch joint is held."""
    for cycle in range(round(seconds / PERIOD)):
        roll = 0.7 * math.sin(2.0 * math.pi * 1.5 * (begin + PERIOD * cycle))
        bench.cycle(hold(0.0), hold(roll))


def test_replies_of_50_ms_ago_are_found_in_motion_and_of_200_ms_ago_when_the_motion_begins(bench):
    swing(bench, 0.66)
    bench.fakes[1].respond = aged(5)
    swing(bench, 0.1, 0.66)
    assert bench.motors[1].fault is MotorFault.NOT_FOLLOWING
    still = Bench().to_running(RUN)
    still.fakes[1].respond = aged(20)
    still.cycle(RUN, count=100)
    assert still.group.fault_text == ""
    still.cycle(hold(0.0), hold(0.7), count=7)
    assert still.motors[1].fault is MotorFault.NOT_FOLLOWING


@pytest.mark.parametrize("constant", [0.7, 1.0, 1.3])
def test_replies_of_a_cycle_ago_and_a_torque_constant_that_is_wrong_stop_nothing(bench, constant):
    late = aged(1)

    def respond(frame):
        reply = decode_reply(frame, PROFILE)
        return late(make_reply(reply._replace(torque=constant * reply.torque), PROFILE))

    bench.fakes[1].respond = respond
    swing(bench, 2.0)
    assert bench.group.fault_text == ""


@pytest.mark.parametrize(
    ("inject", "fault"),
    [
        (report(1), MotorFault.MOTOR_REPORTED),
        (overheat, MotorFault.OVER_TEMPERATURE),
        (update_firmware, MotorFault.WRONG_FIRMWARE),
        (double, MotorFault.DOUBLE_ID),
        (lambda roll: setattr(roll, "position", 2.0), MotorFault.OUT_OF_RANGE),
    ],
)
def test_motor_with_a_fault_is_not_entered(inject, fault):
    bench = Bench()
    inject(bench.fakes[1])
    bench.group.set_enter(0.0)
    bench.cycle(count=20)
    assert bench.motors[1].fault is fault
    assert not bench.fakes[1].entered
    assert all(command.kp == 0 for _, command in bench.commands(2)), "before any gain"
