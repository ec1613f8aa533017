"""Zeros of the motors: their angles while somebody holds the tail upright."""

import json
import math
import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import numpy as np

from aerodima.hardware.car.car_ports import JOINTS, CarPorts, Joint, ports_from_dict
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.wiring import PERIOD, WiringName
from aerodima.hardware.devices.device_states import FramePort
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.protocol.ak70 import decode_reply, make_enter, make_exit, make_neutral
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.file_reading import read_json

Angles = dict[Joint, float]
"""Angles by joint, of the joints or of their motors, rad."""
_CYCLES = 80
"""Number of cycles of 10 ms in a reading."""
_EXIT_CYCLES = 20
"""Number of cycles at the beginning that switch the motors off, before they are entered."""
_FIRST_READ = 30
"""Number of the cycle after which replies are read."""
_MIN_REPLIES = 20
"""Least number of replies that give a position."""
_MAX_SPREAD = math.radians(1.0)
"""Largest movement of a joint that counts as held still, rad."""


def read_motor_angles(ports: CarPorts, wiring: WiringName) -> Angles:
    """Reads the angles of the motors (rad, of the motor itself) while somebody holds the tail: no
    gains, no torque.

    Raises:
        HardwareError: a port that cannot be opened, a motor that does not answer, or one that is
            moved meanwhile.
    """
    purpose = "the setting of the zero"
    if wiring == "teensy_bridge":
        with (
            lock_devices([ports.teensy.path], purpose),
            closing(SerialLink.open(ports.teensy)) as serial,
        ):
            teensy = TeensyLink(serial, ports.motor_ids, ports.profile)
            return _read_angles(ports, teensy, teensy.commit)
    can = ports.adapter(wiring)
    with (
        lock_devices([can_address(can)], purpose),
        closing(CanBus.open(can, listen={0, *ports.motor_ids})) as bus,
    ):
        return _read_angles(ports, bus, lambda: None)


def write_zeros(path: Path, angles: Angles) -> None:
    """Writes the present angles of the motors into a ports file as their zeros; the tail must stand
    upright.

    Raises:
        HardwareError: the file cannot be read or written, or is no ports file any more.
    """
    data = read_json(path, HardwareError)
    ports_from_dict(data, str(path))
    for number, (joint, angle) in enumerate(angles.items(), start=1):
        data.setdefault(joint, {"motor_id": number})["zero"] = round(angle, 5)
    write_atomically(path, json.dumps(data, indent=1) + "\n", True, HardwareError)


def joint_angles(ports: CarPorts, angles: Angles) -> Angles:
    """Converts motor angles to joint angles (rad) by the zeros of the ports file."""
    mounting = load_mounting()
    converted: Angles = {}
    for joint, angle in angles.items():
        part = getattr(ports, joint)
        direction = part.direction or getattr(mounting, f"{joint}_direction")
        converted[joint] = direction * (angle - part.zero)
    return converted


def _read_angles(ports: CarPorts, port: FramePort, commit: Callable[[], None]) -> Angles:
    """Reads both motors with zero gains for a while, then switches them off."""
    ids = dict(zip(ports.motor_ids, JOINTS, strict=True))
    positions: dict[Joint, list[float]] = {joint: [] for joint in JOINTS}
    try:
        for cycle in range(_CYCLES):
            for motor_id in ids:
                neutral = make_neutral(motor_id, ports.profile)
                frames = [neutral]
                if cycle < _EXIT_CYCLES:
                    frames = [make_exit(motor_id)]
                elif cycle == _EXIT_CYCLES:  # a motor that enters goes on with its last command
                    frames = [neutral, make_enter(motor_id), neutral]
                for frame in frames:
                    port.send(frame)
            commit()
            time.sleep(PERIOD)
            for _, frame in port.poll():
                with suppress(FrameError):
                    reply = decode_reply(frame, ports.profile)
                    if reply.motor_id in ids and cycle > _FIRST_READ:
                        positions[ids[reply.motor_id]].append(reply.position)
    finally:
        for _ in range(5):
            for motor_id in ids:
                port.send(make_exit(motor_id), urgent=True)
            commit()
            time.sleep(PERIOD)
        port.flush()
    return {joint: _steady(joint, values) for joint, values in positions.items()}


def _steady(joint: Joint, values: list[float]) -> float:
    """Returns the median of angles (rad); raises `HardwareError` for too few or a moved motor."""
    if len(values) < _MIN_REPLIES:
        raise HardwareError(
            f"{joint}: {len(values)} replies; is the motor powered, is its id right?"
        )
    spread = max(values) - min(values)
    if spread > _MAX_SPREAD:
        raise HardwareError(
            f"{joint}: moved by {math.degrees(spread):.1f} degrees meanwhile; hold the tail still"
        )
    return float(np.median(values))
