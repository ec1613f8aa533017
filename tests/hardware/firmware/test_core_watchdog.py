"""The watchdog of the firmware in simulated time: the code that ships, byte by byte."""

from dataclasses import replace

import pytest

from aerodima.hardware.car.safety_settings import load_teensy_timing
from aerodima.hardware.firmware.teensy_core import TeensyCore
from aerodima.hardware.firmware.teensy_firmware import FirmwareSettings
from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8 as PROFILE
from aerodima.hardware.protocol.ak70 import (
    NEUTRAL,
    MitCommand,
    MitReply,
    make_command,
    make_enter,
    make_exit,
    make_neutral,
    make_reply,
)
from aerodima.hardware.protocol.teensy import (
    Attitude,
    MotorOrder,
    MotorRequest,
    TeensyCommand,
    TeensyStatus,
    decode_reply,
)
from aerodima.hardware.protocol.teensy import make_command as make_string

TIMING = load_teensy_timing()
PUSH = MitCommand(1.0, 0.0, 17.0, 5.0, 0.0)
MS = 0.001
LEVEL = Attitude(0.0, 0.0, 8)


class Bench:
    """A core, the host that writes to it and the motors that answer, in steps of a millisecond."""

    health = (31.0, 0)

    def __init__(
        self, wiring="teensy_bridge", motor_ids=(1, 2), begin=0.0, sail_bits=12, **settings
    ):
        settings = FirmwareSettings(wiring, PROFILE, motor_ids, sail_bits, **settings)
        self.now = begin
        self.core = TeensyCore(settings, begin)
        self.core.feed(b"|", begin)
        self.sent = []
        self.replies = []
        self.deaf = False
        self._collect()

    def _collect(self):
        for frame in self.core.frames():
            self.sent.append((self.now, frame))
            if not self.deaf and frame.arbitration_id in (1, 2):
                answer = make_reply(
                    MitReply(frame.arbitration_id, 0.5, -1.0, 2.0, *self.health), PROFILE
                )
                self.core.receive(answer)
        reply = self.core.reply()
        if reply:
            self.replies.append((self.now, reply))

    def wait(self, seconds):
        for _ in range(round(seconds / MS)):
            self.now += MS
            self.core.step(self.now)
            self._collect()

    def write(
        self, request, command=NEUTRAL, throttle=1500, servo=1500, ids=(1, 2), attitude=LEVEL
    ):
        first, second = (MotorOrder(motor_id, request, command) for motor_id in ids)
        self.core.feed(
            make_string(TeensyCommand((first, second), servo, throttle, attitude)), self.now
        )
        self._collect()

    def drive(self, cycles=20):
        """From the start to a car that drives."""
        self.write(MotorRequest.EXIT)
        self.wait(0.01)
        self.write(MotorRequest.ENTER)
        self.wait(0.01)
        for _ in range(cycles):
            self.write(MotorRequest.COMMAND, PUSH, throttle=1520, servo=1700)
            self.wait(0.01)
        return self

    def exits(self, motor_id, since=0.0):
        return [
            when
            for when, frame in self.sent
            if frame == make_exit(motor_id) and when >= since - 1e-9
        ]

    def last_reply(self):
        return decode_reply(self.replies[-1][1])


def test_it_starts_neutral_and_switches_the_motors_off():
    bench = Bench()
    state = bench.core.state
    assert (state.servo, state.throttle, state.status) == (1500, 1500, TeensyStatus.WATCHDOG_ACTED)
    frames = [frame for _, frame in bench.sent]
    assert frames[:2] == [make_neutral(1, PROFILE), make_neutral(2, PROFILE)]
    assert len(bench.exits(1)) == len(bench.exits(2)) == TIMING.exit_burst


def test_it_bridges_enter_command_and_exit():
    bench = Bench()
    bench.write(MotorRequest.EXIT)

    def bridged(request, *rest, **pulses):
        del bench.sent[:]
        bench.write(request, *rest, **pulses)
        bench.wait(MS)
        return [frame for _, frame in bench.sent]

    entered = [
        frame
        for motor_id in (1, 2)
        for frame in (
            make_neutral(motor_id, PROFILE), make_enter(motor_id), make_neutral(motor_id, PROFILE)
        )
    ]  # fmt: skip
    assert bridged(MotorRequest.ENTER) == entered
    pushed = [make_command(motor_id, PUSH, PROFILE) for motor_id in (1, 2)]
    assert bridged(MotorRequest.COMMAND, PUSH, throttle=1520, servo=1700) == pushed
    assert (bench.core.state.servo, bench.core.state.throttle) == (1700, 1520)
    reply = bench.last_reply()
    assert reply.motors[0].state.position == pytest.approx(0.5, abs=4e-4)
    assert reply.motors[1].state.torque == pytest.approx(2.0, abs=0.01)
    assert (reply.motors[0].state.temperature, reply.status) == (31, TeensyStatus.RUNNING)


def test_what_a_motor_does_not_say_is_unknown_and_not_zero():
    bench = Bench()
    bench.health = ()
    for _ in range(2):
        state = bench.last_reply().motors[0].state if bench.replies else None
        assert state is None or (state.temperature, state.fault) == (None, None)
        bench.write(MotorRequest.EXIT)
        bench.wait(0.005)
    assert state.position == pytest.approx(0.5, abs=1e-3)


def test_it_acts_when_the_strings_stop_and_not_before():
    """Until then a motor holds its last command by itself: the Teensy sends it nothing."""
    bench = Bench().drive()
    last = bench.now - 0.01  # time of the last string
    bench.wait(TIMING.watchdog_timeout - 0.01)
    assert bench.core.state.throttle == 1520
    assert bench.sent[-1] == (last, make_command(2, PUSH, PROFILE))
    bench.wait(0.002)
    assert (bench.core.state.servo, bench.core.state.throttle) == (1500, 1500)
    assert bench.core.state.status == TeensyStatus.WATCHDOG_ACTED
    for motor_id in (1, 2):
        exits = bench.exits(motor_id, since=last)
        assert len(exits) == TIMING.exit_burst
        assert exits[0] - last == pytest.approx(TIMING.watchdog_timeout, abs=2 * MS)


def test_roll_alone_is_switched_off_while_pitch_is_held_without_an_attitude():
    bench = Bench().drive()
    begin = bench.now
    orders = MotorOrder(1, MotorRequest.COMMAND, PUSH), MotorOrder(2, MotorRequest.EXIT, NEUTRAL)
    for _ in range(200):
        old = Attitude(0.0, 0.0, 5000)
        bench.core.feed(make_string(TeensyCommand(orders, 1500, 1500, old)), bench.now)
        bench.wait(0.01)
    sent = [frame for when, frame in bench.sent if when > begin]
    assert set(sent) == {make_command(1, PUSH, PROFILE), make_exit(2)}
    assert sent.count(make_exit(2)) == 200
    assert bench.last_reply().status is TeensyStatus.RUNNING


def test_it_goes_on_sending_exit_frames():
    bench = Bench().drive()
    acted = bench.now - 0.01 + TIMING.watchdog_timeout
    bench.wait(TIMING.watchdog_timeout + TIMING.exit_cycles * TIMING.exit_cycle)
    burst = TIMING.exit_burst + TIMING.exit_cycles
    assert burst - 1 <= len(bench.exits(2, since=acted)) <= burst
    begin = bench.now
    bench.wait(1.0)
    assert len(bench.exits(2, since=begin)) == pytest.approx(1.0 / TIMING.reminder, abs=1.5)


def test_strings_that_are_not_neutral_do_not_end_it():
    bench = Bench().drive()
    bench.wait(0.3)
    begin = bench.now
    for _ in range(50):
        bench.write(MotorRequest.COMMAND, PUSH, throttle=1520, servo=1700)
        bench.wait(0.01)
    assert bench.core.state.throttle == 1500
    commands = [
        frame
        for when, frame in bench.sent
        if when > begin and frame == make_command(1, PUSH, PROFILE)
    ]
    assert not commands
    assert bench.exits(1, since=begin)
    assert bench.last_reply().status is TeensyStatus.WATCHDOG_ACTED


@pytest.mark.parametrize(
    ("request_", "throttle"),
    [(MotorRequest.EXIT, 1501), (MotorRequest.ENTER, 1500), (MotorRequest.COMMAND, 1500)],
)
def test_only_exit_with_idle_throttle_is_neutral(request_, throttle):
    bench = Bench().drive()
    bench.wait(0.3)
    bench.write(request_, throttle=throttle)
    assert bench.core.state.status == TeensyStatus.WATCHDOG_ACTED


def test_a_neutral_string_ends_it():
    bench = Bench().drive()
    bench.wait(0.3)
    bench.write(MotorRequest.EXIT)
    assert bench.core.state.status == TeensyStatus.RUNNING
    bench.drive()
    assert bench.core.state.throttle == 1520


def test_damaged_strings_do_not_feed_it():
    bench = Bench().drive()
    for _ in range(40):
        bench.core.feed(b"1;2;0;0;0;0;0|;2;2;0;0;0;0;0|;1500;1520;*00|", bench.now)
        bench.wait(0.01)
    assert bench.core.state.status == TeensyStatus.WATCHDOG_ACTED
    assert bench.core.state.rejected >= 40


@pytest.mark.parametrize("ids", [(1, 3), (2, 1)])
def test_other_motors_need_a_new_session(ids):
    bench = Bench().drive()
    rejected = bench.core.state.rejected
    bench.write(MotorRequest.COMMAND, PUSH, ids=ids)
    assert bench.core.state.rejected == rejected + 1
    bench.write(MotorRequest.EXIT, ids=ids)
    assert {1, 2} <= {
        frame.arbitration_id
        for when, frame in bench.sent
        if frame == make_exit(frame.arbitration_id)
    }
    bench.write(MotorRequest.COMMAND, PUSH, ids=ids)
    bench.wait(0.005)
    assert {frame.arbitration_id for _, frame in bench.sent[-2:]} == set(ids)


def test_a_command_beyond_the_motor_is_refused_whole():
    bench = Bench().drive()
    rejected = bench.core.state.rejected
    bench.write(MotorRequest.COMMAND, replace(PUSH, position=13.0))
    assert bench.core.state.rejected == rejected + 1
    bench.wait(0.2)
    assert bench.core.state.status == TeensyStatus.WATCHDOG_ACTED


def test_the_clock_may_wrap():
    bench = Bench(begin=2**32 / 1000.0 - 0.1).drive(cycles=40)
    assert bench.core.state.status == TeensyStatus.RUNNING
    bench.wait(0.2)
    assert bench.core.state.status == TeensyStatus.WATCHDOG_ACTED


def test_silent_motors_do_not_make_the_reply_late_and_do_not_count_as_answers():
    bench = Bench().drive()
    before = bench.last_reply().motors[0].replies
    bench.deaf = True
    bench.write(MotorRequest.COMMAND, PUSH)
    written = bench.now
    bench.wait(0.01)
    when, _ = bench.replies[-1]
    assert when - written <= TIMING.reply_wait + MS
    assert bench.last_reply().motors[0].replies == before


def test_it_tells_a_computer_that_only_listens():
    bench = Bench().drive()
    bench.wait(TIMING.watchdog_timeout + 0.005)
    assert bench.last_reply().status is TeensyStatus.WATCHDOG_ACTED
    count = len(bench.replies)
    bench.wait(TIMING.exit_cycles * TIMING.exit_cycle + 1.0)
    assert len(bench.replies) - count >= 0.8 / TIMING.reminder


@pytest.mark.parametrize(
    ("bits", "word", "degrees"), [(12, 1024, 90.0), (12, 4095, 359.912), (10, 512, 180.0)]
)
def test_words_of_the_sail_encoder_become_degrees(bits, word, degrees):
    bench = Bench(sail_bits=bits)
    bench.core.set_sail_word(word)
    bench.write(MotorRequest.EXIT)
    bench.wait(0.005)
    assert bench.last_reply().sail == pytest.approx(degrees, abs=6e-4)


def test_no_command_leaves_after_everything_was_switched_off():
    bench = Bench().drive()
    bench._collect = lambda: None  # the bus takes nothing
    bench.write(MotorRequest.COMMAND, PUSH)
    bench.write(MotorRequest.COMMAND, PUSH, throttle=1520, attitude=None)
    assert bench.core.state.status == TeensyStatus.ATTITUDE
    frames = bench.core.frames()
    assert make_exit(1) in frames
    assert make_command(1, PUSH, PROFILE) not in frames
