"""What the strings and frames between operator, computer and motors are, beside what thesis 5.4.5
prints.
"""

import math
import struct
from dataclasses import fields

from aerodima.hardware.protocol import ak70, radio, teensy
from aerodima.hardware.protocol.ak70 import MitCommand
from tests.built.registry import check


@check
def servo_pulses():
    return ", ".join(map(str, teensy.SERVO_PULSES))


@check
def throttle_pulses():
    return ", ".join(map(str, teensy.THROTTLE_PULSES))


def command_string():
    first, second = (
        teensy.MotorOrder(
            number, teensy.MotorRequest.COMMAND, MitCommand(number + 0.1, 0.2, 0.3, 0.4, 0.5)
        )
        for number in (1, 2)
    )
    command = teensy.TeensyCommand((first, second), servo=1600, throttle=1700)
    return teensy.make_command(command).decode()


@check
def order_of_a_motor_command():
    """The first CAN message of the string, its numbers replaced by what they are."""
    names = {
        "1": "ID",
        "2": "STATE",
        "1.1": "POS",
        "0.2": "VEL",
        "0.3": "KP",
        "0.4": "KD",
        "0.5": "TOR",
    }
    parts = command_string().split("|")[0].split(";")
    found = [names[f"{float(part):g}"] if place else "ID" for place, part in enumerate(parts)]
    return " ; ".join(found) + " |"


@check
def order_of_the_command_string():
    first, second, pulses = command_string().rstrip("|").split("|")
    assert first.split(";")[0].strip() == "1"
    assert second.split(";")[1].strip() == "2"
    named = {"1600": "SERVO CMD", "1700": "THROTTLE CMD"}
    printed = [part for part in pulses.split(";") if part][
        :2
    ]  # attitude and checksum are added behind them
    return "CAN MSG 1 ; CAN MSG 2 ; " + " ; ".join(named[part] for part in printed) + " |"


@check
def order_of_the_reply_string():
    body = b"1;10;21;31;2;20;22;32;90;0;30;0;0;30;0;0;0"
    reply = teensy.decode_reply(body + f";*{teensy.crc8(body):02X}|".encode())
    names = ("motor_id", "position", "velocity", "torque")
    parts = [getattr(motor.state, name) for motor in reply.motors for name in names]
    named = {
        1: "ID 1",
        2: "ID 2",
        10: "POS 1",
        20: "POS 2",
        21: "VEL 1",
        22: "VEL 2",
        31: "CUR 1",
        32: "CUR 2",
    }
    named[90] = "ENC POS"
    return " ; ".join(named[round(part)] for part in (*parts, reply.sail)) + " |"


@check
def radio_struct():
    assert radio.PACKED.size == struct.calcsize("<BBffff")
    return radio.PACKED.format.lstrip("<")


@check
def order_of_a_radio_message():
    command = radio.OperatorCommand(
        radio.RadioMode.MANUAL, throttle=0.1, steering=0.2, pitch_tail=0.3, roll_tail=0.4
    )
    names = {0.1: "THROTTLE CMD", 0.2: "STEERING CMD", 0.3: "PITCH TAIL CMD", 0.4: "ROLL TAIL CMD"}
    kind, mode, *values = struct.unpack("<BBffff", radio.make_command(command))
    assert (kind, mode) == (radio.RadioClass.COMMAND, radio.RadioMode.MANUAL)
    return " | ".join(["CLASS", "MODE", *(names[round(value, 6)] for value in values)])


@check
def radio_classes():
    return ", ".join(sorted(kind.name.lower().replace("_", " ") for kind in radio.RadioClass))


@check
def radio_modes():
    return ", ".join(sorted(mode.name.lower() for mode in radio.RadioMode))


@check
def states_of_a_motor_in_the_string():
    return ", ".join(sorted(request.name.lower() for request in teensy.MotorRequest))


@check
def stop_without_a_command_has_zeros():
    """Whether what an operator sends outside of a command is all zeros."""
    return not any(radio.make_heartbeat(7)[2:]) and not any(radio.make_emergency_stop()[1:])


@check
def full_turn_of_the_encoder():
    return math.radians(teensy.NUMBERS["sail"][1])


@check
def neutral_command_is_zero():
    return all(getattr(ak70.NEUTRAL, field.name) == 0.0 for field in fields(ak70.NEUTRAL))
