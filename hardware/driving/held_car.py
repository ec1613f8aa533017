"""A car whose tail is held by its motors, for first tests: armed without a guard, with the motors
off on every exit.

It has the first tests of new motors: the watchdog test, a move of one joint by five degrees, and
the zero.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from aerodima.hardware.car.car_ports import JOINTS, CarPorts, Joint, read_ports
from aerodima.hardware.car.mounting import load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.car.wiring import CarCommand, WiringName, wiring_name
from aerodima.hardware.car.wirings import wire_car
from aerodima.hardware.devices.device_states import FramePort
from aerodima.hardware.devices.motor_settings import load_motor_safety
from aerodima.hardware.devices.teensy_link import TeensyLink
from aerodima.hardware.driving.plain_loop import PERIOD, wait_until
from aerodima.hardware.driving.watchdog_test import (
    WatchdogTest,
    new_record,
    require_watchdog_test,
    write_record,
)
from aerodima.hardware.protocol.ak70 import decode_reply, make_enter, make_exit, make_neutral
from aerodima.hardware.protocol.can_frame import FrameError
from aerodima.hardware.protocol.teensy import TeensyStatus
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import can_address, lock_devices
from aerodima.hardware.transport.serial_link import SerialLink
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.realtime import DRIVE_PRIORITY, prefer_realtime, restore_ordinary
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from aerodima.workbench.scenario.signal_table import STATUS, TAIL_STATE

_HEARD = 0.5
"""s within which Teensy and watchdog must answer."""
QUESTION = "The link was cut. Are both motors off: does the tail move freely by hand?"
_HOLDING = 0.5
"""Time for which the motors hold before the cut, s."""
_ACT_TIME = 2.0
"""Time in which the Teensy must act after the cut, s."""
_LOOK = 0.002
"""Time between two looks at the Teensy, s."""
_CUTS = {
    "teensy_bridge": ("strings stopped", TeensyStatus.WATCHDOG_ACTED),
    "watched_can": ("heartbeat stopped", TeensyStatus.BEATS_STOPPED),
}
"""What is cut, and what the Teensy reports then."""
_WAYS = {"tail_pitch": ("forward", "back"), "tail_roll": ("to the right", "to the left")}
"""Positive, negative (design section 4)."""
_STEP = math.radians(5.0)
"""Angle by which a joint is moved in the test of its motor, rad."""
_MOST_WRONG = math.radians(2.0)
"""Largest error of that movement, rad."""
_KP = 60.0
"""N m/rad: five degrees ask for 5 N m at most, and the weight of a tail that lies on its side
(1.2 N m on the emulated car) costs one degree; with the soft gains that hold it, it would cost
four."""
_KD = 5.0
"""N m s/rad."""
_MOVE = 1.0
"""Time of the movement, s."""
_SETTLE = 0.5
"""Time after it until the joint is at rest, s."""
_LEAST_REPLIES = 20
"""Cycles over which the torque is averaged; fewest replies that give a position."""
_MOST_SPREAD = math.radians(1.0)
"""Largest movement of a joint that counts as held still, rad."""
_TORQUE_ERROR = 0.5
"""N m by which the reported torque may differ: a motor reads its current, not its torque."""
_TORQUE_SHARE = 0.4
"""Share of the torque by which the reported one may differ."""
_COOLER = 20.0
"""K below the limit of a drive, for a motor that has done nothing yet."""


def connect(
    ports: str | Path | CarPorts,
    scenario: str | Path | Scenario,
    wiring: str = "teensy_bridge",
    traffic: str | Path | None = None,
) -> WiredCar:
    """The car of a scenario with its watchdog, to be armed after a recorded watchdog test only;
    opens nothing yet.

    Args:
        ports: the ports file, or what is in it.
        scenario: itself, its name or its file; for the tail and the gains of its controller.
        wiring: of `aerodima.hardware.car.wiring.WIRINGS`.
        traffic: a new `.blf` file for every frame on the adapter; not with `teensy_bridge`.

    Raises:
        HardwareError: unknown wiring, a ports file that cannot be read, and as `wire_car`.
    """
    name = wiring_name(wiring)
    if isinstance(ports, CarPorts):
        there = ports
    else:
        there = read_ports(ports)
    if isinstance(scenario, Scenario):
        chosen = scenario
    else:
        chosen = load_scenario(scenario)

    def authorise() -> None:
        require_watchdog_test(name, there)

    return wire_car(chosen, there, name, authorise, None if traffic is None else Path(traffic))


@contextmanager
def held(car: WiredCar) -> Iterator[WiredCar]:
    """Starts and arms a car; the block begins when the tail is held where it is, and ends with the
    motors off.

    Args:
        car: of `connect`, not started yet.

    Raises:
        HardwareError: no watchdog test of its wiring, a port that cannot be opened, motors that do
            not answer.
    """
    safety = load_motor_safety()
    car.authorise()
    prefer_realtime(DRIVE_PRIORITY)
    try:
        car.start()
        run_cycles(car, CarCommand(), _HEARD)
        car.arm()
        end = time.monotonic() + load_drive_safety().arm_timeout
        armed = STATUS.index("armed")
        while (
            not (car.reading.status[armed] or any(motor.fault for motor in car.motors))
            and time.monotonic() < end
        ):
            run_cycles(car, CarCommand())
        run_cycles(car, CarCommand(), safety.gain_ramp)
        if not car.reading.status[armed]:
            raise HardwareError(
                f"not armed: {car.reading.fault_text or 'the motors do not answer'}"
            )
        yield car
    finally:
        car.stop("the tail is let go")
        restore_ordinary()


def run_cycles(
    car: WiredCar, command: CarCommand | Callable[[float], CarCommand], seconds: float = PERIOD
) -> None:
    """Cycles of 10 ms, one at least; `car.reading` is of the last one.

    Args:
        command: of every cycle, or as a function of the time since the first (s). All zeros hold a
            joint where it is.
    """
    begin = time.monotonic()
    for cycle in range(max(1, round(seconds / PERIOD))):
        now = time.monotonic()
        car.read(now)
        car.write(command if isinstance(command, CarCommand) else command(cycle * PERIOD), now)
        wait_until(begin + (cycle + 1) * PERIOD)


def run_watchdog_test(
    scenario: Scenario,
    ports: CarPorts,
    wiring: WiringName,
    confirm: Callable[[str], bool],
    seen_by: str = "operator",
    folder: Path | None = None,
) -> tuple[WatchdogTest, Path]:
    """Makes a watchdog test and records it: the motors hold, the link is cut, and somebody sees
    that they are off.

    In the bridge all strings stop; in `watched_can` the strings continue and the heartbeat stops.
    The Teensy reports that it has acted. No report shows what the motors do, so nothing is sent
    before `confirm` has answered.

    Args:
        confirm: puts `QUESTION` to somebody who sees the motors; True if they are off.
        seen_by: who that is.
        folder: of the record, see `record_path`.

    Raises:
        HardwareError: the motors cannot be held, the watchdog did not act in time, or the motors
            were not seen off. No record is written then.
    """
    if scenario.tail.mode == "none":
        raise HardwareError("tail.mode: none; a watchdog test needs the motors of a tail")
    cut, answer = _CUTS[wiring]
    # The page of an emulated car, its radio, is not there yet.
    unheard = ports.model_copy(update={"radio": None})
    with held(wire_car(scenario, unheard, wiring, lambda: None)) as car:
        run_cycles(car, CarCommand(), _HOLDING)
        last = time.monotonic()
        car.read(last)
        car.write(CarCommand(), last)
        if car.reading.fault_text:
            raise HardwareError(f"watchdog test: {car.reading.fault_text}")
        time_to_exit = _await_status(car, answer) - last
        if not confirm(QUESTION):
            raise HardwareError(
                f"watchdog test of {wiring}: the motors were not seen off; nothing is recorded"
            )
    record = new_record(wiring, ports, cut, time_to_exit, seen_by)
    return record, write_record(record, folder)


def _await_status(car: WiredCar, wanted: TeensyStatus) -> float:
    """Time at which the Teensy reports that it has acted, s."""
    assert car.devices is not None
    teensy = car.devices.teensy
    end = time.monotonic() + _ACT_TIME
    while teensy.status is not wanted:
        if time.monotonic() > end:
            raise HardwareError(
                f"watchdog test: the Teensy did not act within {_ACT_TIME:g} s; cut the power"
            )
        if car.name == "watched_can":
            teensy.commit()
        time.sleep(_LOOK)
        teensy.poll()
    return time.monotonic()


@dataclass(frozen=True)
class MotorTest:
    """Result of the test of one joint.

    Attributes:
        moved: rad.
        torque: that the motor reported at the end of the way, N m.
        wanted: that its gains ask for there, N m.
        temperature: degrees Celsius; None if the motor does not report it.
    """

    joint: Joint
    moved: float
    torque: float
    wanted: float
    temperature: float | None


def run_motor_test(
    car: WiredCar, joint: Joint, say: Callable[[str], None], confirm: Callable[[str], bool]
) -> MotorTest:
    """Moves one joint by five degrees and back while the other is held, on a car that is not
    started yet.

    Args:
        confirm: asks somebody beside the car, once the motors are off, whether it went the positive
            way of the joint (design section 4: pitch forward, roll to the right). What the motor
            itself reports cannot tell.

    Raises:
        HardwareError: the motors cannot be armed or have a fault, the joint moved by other than
            five degrees, give or take two, the reported torque is not that of its gains, or it is
            too warm.
    """
    index = JOINTS.index(joint)
    place = TAIL_STATE.index(("pitch_angle", "roll_angle")[index])
    with held(car):
        begin = float(car.reading.tail_state[place])
        high = car.motors[index].settings.high
        step = _STEP if begin + _STEP < high else -_STEP
        way = _WAYS[joint][step < 0.0]
        say(f"{joint}: now 5 degrees {way}")

        def command(since: float) -> CarCommand:
            row = np.array(
                [begin + step * float(np.clip(since / _MOVE, 0.0, 1.0)), 0.0, _KP, _KD, 0.0]
            )
            if index == 0:
                return CarCommand(tail_pitch=row)
            return CarCommand(tail_roll=row)

        run_cycles(car, command, _MOVE + _SETTLE)
        reported = []
        wanted = []
        for _ in range(_LEAST_REPLIES):
            run_cycles(car, command(_MOVE))
            angle, rate = car.reading.tail_state[[place, place + 3]]
            reported.append(float(car.reading.tail_torque[index]))
            wanted.append(float(_KP * (begin + step - angle) - _KD * rate))
        fault = car.reading.fault_text
        moved = float(car.reading.tail_state[place] - begin)
        temperature = car.motors[index].temperature
        run_cycles(car, lambda since: command(_MOVE - since), _MOVE + _SETTLE)
    test = MotorTest(joint, moved, float(np.mean(reported)), float(np.mean(wanted)), temperature)
    _refuse_wrong(test, step, fault, load_motor_safety().temperature_limit)
    if not confirm(f"Did the tail go {way}?"):
        raise HardwareError(
            f"motor test of {joint}: it went the other way; change the sign of "
            f"{joint}.direction (1, -1) in the ports file"
        )
    return test


def read_motor_angles(ports: CarPorts, wiring: WiringName) -> dict[Joint, float]:
    """Angles of the motors (rad, of the motor itself) while somebody holds the tail: no gains, no
    torque.

    Raises:
        HardwareError: a port that cannot be opened, a motor that does not answer, or one that is
            moved meanwhile.
    """
    if wiring == "teensy_bridge":
        can = None
        device = ports.teensy.path
    else:
        can = ports.adapter(wiring)
        device = can_address(can)
    with lock_devices([device], "the setting of the zero"):
        if can is None:
            with closing(SerialLink.open(ports.teensy)) as serial:
                teensy = TeensyLink(serial, ports.motor_ids, ports.profile)
                return _angles(ports, teensy, teensy.commit)
        with closing(CanBus.open(can, listen={0, *ports.motor_ids})) as bus:
            return _angles(ports, bus, lambda: None)


def write_zeros(path: Path, angles: dict[Joint, float]) -> None:
    """Writes the present angles of the motors into a ports file as their zeros; the tail must stand
    upright.

    Raises:
        HardwareError: the file cannot be read or written.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise HardwareError(f"{path}: cannot be read as JSON: {error}") from None
    for number, (joint, angle) in enumerate(angles.items(), start=1):
        part = data.setdefault(joint, {"motor_id": number})
        part["zero"] = round(angle, 5)
    write_atomically(path, json.dumps(data, indent=1) + "\n", True, HardwareError)


def joint_angles(ports: CarPorts, angles: dict[Joint, float]) -> dict[Joint, float]:
    """Angles of the joints (rad) by the zeros of the ports file."""
    mounting = load_mounting()
    signs = {"tail_pitch": mounting.tail_pitch_direction, "tail_roll": mounting.tail_roll_direction}
    parts = {"tail_pitch": ports.tail_pitch, "tail_roll": ports.tail_roll}
    return {
        j: (parts[j].direction or signs[j]) * (angle - parts[j].zero) for j, angle in angles.items()
    }


def _refuse_wrong(test: MotorTest, step: float, fault: str, warmest: float) -> None:
    name = f"motor test of {test.joint}"
    degrees = math.degrees(test.moved)
    if fault:
        raise HardwareError(f"{name}: {fault}")
    if abs(test.moved - step) > _MOST_WRONG:
        asked = math.degrees(step)
        most = math.degrees(_MOST_WRONG)
        raise HardwareError(
            f"{name}: moved by {degrees:+.1f} degrees; allowed is {asked:+g}, give or take {most:g}"
        )
    if abs(test.torque - test.wanted) > _TORQUE_ERROR + _TORQUE_SHARE * abs(test.wanted):
        raise HardwareError(
            f"{name}: reports {test.torque:+.2f} N m where its gains ask for {test.wanted:+.2f}; "
            "is the profile right?"
        )
    if test.temperature is not None and test.temperature > warmest - _COOLER:
        raise HardwareError(f"{name}: {test.temperature:g} degC; allowed is {warmest - _COOLER:g}")


def _angles(ports: CarPorts, port: FramePort, commit: Callable[[], None]) -> dict[Joint, float]:
    """Asks both motors with zero gains for a while, then switches them off."""
    ids = dict(zip(ports.motor_ids, JOINTS, strict=True))
    heard: dict[Joint, list[float]] = {joint: [] for joint in JOINTS}
    try:
        for cycle in range(80):
            for motor_id in ids:
                if cycle < 20:
                    frame = make_exit(motor_id)
                elif cycle == 20:
                    frame = make_enter(motor_id)
                else:
                    frame = make_neutral(motor_id, ports.profile)
                port.send(frame)
            commit()
            time.sleep(PERIOD)
            for _, frame in port.poll():
                with suppress(FrameError):
                    reply = decode_reply(frame, ports.profile)
                    if reply.motor_id in ids and cycle > 30:
                        heard[ids[reply.motor_id]].append(reply.position)
    finally:
        for _ in range(5):
            for motor_id in ids:
                port.send(make_exit(motor_id), urgent=True)
            commit()
            time.sleep(PERIOD)
        port.flush()
    return {joint: _steady(joint, values) for joint, values in heard.items()}


def _steady(joint: Joint, values: list[float]) -> float:
    if len(values) < _LEAST_REPLIES:
        raise HardwareError(
            f"{joint}: {len(values)} replies; is the motor powered, is its id right?"
        )
    if max(values) - min(values) > _MOST_SPREAD:
        spread = math.degrees(max(values) - min(values))
        raise HardwareError(
            f"{joint}: moved by {spread:.1f} degrees meanwhile; hold the tail still"
        )
    return float(np.median(values))
