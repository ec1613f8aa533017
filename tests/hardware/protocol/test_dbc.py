"""The DBC for other tools describes the same frames: cantools reads and writes what our code writes
and reads.
"""

import random

import cantools
import pytest

from aerodima.hardware.protocol.ak70 import AK70_10_V1_0_8 as PROFILE
from aerodima.hardware.protocol.ak70 import (
    FAULT_NAMES,
    decode_command,
    decode_reply,
    make_command,
    make_reply,
)
from aerodima.hardware.protocol.can_frame import CanFrame
from aerodima.workbench.core.resources import model_path

FRAMES = 2_000


@pytest.fixture(scope="module")
def database():
    return cantools.database.load_file(model_path("ak70_10.dbc"))


def test_commands_agree_over_random_frames(database):
    generator = random.Random(1)
    message = database.get_message_by_name("motor_1_command")
    for _ in range(FRAMES):
        data = generator.randbytes(7) + b"\x00"
        ours = decode_command(data, PROFILE)
        theirs = message.decode(data)
        assert tuple(theirs.values()) == pytest.approx(
            (ours.position, ours.velocity, ours.kp, ours.kd, ours.torque), abs=1e-12
        )
        # steps to values and back gives the same bytes on both sides
        assert make_command(1, ours, PROFILE).data == data == message.encode(theirs)


@pytest.mark.parametrize("length", [6, 8])
def test_replies_agree_over_random_frames(database, length):
    generator = random.Random(length)
    message = database.get_message_by_name("motor_reply")
    for _ in range(FRAMES):
        data = bytes([generator.randint(1, 63)]) + generator.randbytes(length - 1)
        ours = decode_reply(CanFrame(0, data), PROFILE)
        theirs = message.decode(data, decode_choices=False, allow_truncated=True)
        assert theirs["motor_id"] == ours.motor_id
        assert (theirs["position"], theirs["velocity"], theirs["torque"]) == pytest.approx(
            (ours.position, ours.velocity, ours.torque), abs=1e-12
        )
        assert (theirs.get("temperature"), theirs.get("fault")) == (ours.temperature, ours.fault)
        assert make_reply(ours, PROFILE).data == data


def test_faults_have_the_same_names(database):
    choices = database.get_message_by_name("motor_reply").get_signal_by_name("fault").choices
    assert {code: str(name) for code, name in choices.items()} == {0: "none", **FAULT_NAMES}
