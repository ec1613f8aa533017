"""The ways in which a car is wired, each as a `WiredCar` that is not opened yet.

`direct_can`: the motors on a CAN adapter of the computer, the Teensy for servo, throttle and sail only. The Teensy does
not command the motors here, so a process of its own watches this one (`aerodima.hardware.watchdog`). Nothing else does:
when both die together the motors hold their last command. In `watched_can` the Teensy is on the same bus and switches
them off when the heartbeat on it stops. `teensy_bridge`, that of the thesis: the Teensy owns the CAN bus, the computer
sends it strings; the watchdog is the firmware of the Teensy, which switches the motors off when the strings stop.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from aerodima.hardware.car.car_devices import Devices, closing_on_error, lock_car, open_common
from aerodima.hardware.car.car_ports import CarPorts, MountedMotor
from aerodima.hardware.car.mounting import Mounting, load_mounting
from aerodima.hardware.car.safety_settings import load_drive_safety, load_watchdog_timing
from aerodima.hardware.car.watchdogs import BusWatch, Watchdog, Watchdogs
from aerodima.hardware.car.wired_car import WiredCar
from aerodima.hardware.devices.device_states import FramePort
from aerodima.hardware.devices.motor_group import check_distinct_ids, exit_frames
from aerodima.hardware.devices.motor_settings import MotorSettings, load_motor_safety, motor_settings
from aerodima.hardware.protocol.heartbeat import ANSWER_ID
from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.hardware.transport.can_bus import CanBus
from aerodima.hardware.transport.device_lock import DeviceLock, Say, tell_on_stderr
from aerodima.workbench.config.scenario import Scenario

StartWatchdog = Callable[[CanSettings, DeviceLock], Watchdog]


def tail_motors(scenario: Scenario, ports: CarPorts, mounting: Mounting) -> tuple[MotorSettings, ...]:
    """Settings of the pitch and the roll motor; none for a scenario without a tail.

    Raises:
        HardwareError: two motors with one id, or a zero at which a joint's range does not fit the firmware profile.
    """
    if scenario.tail.mode == "none":
        return ()
    safety = load_motor_safety()
    gains = (scenario.controller.hold_kp, scenario.controller.hold_kd)

    def settings(name: str, part: MountedMotor, limit: float, direction: int) -> MotorSettings:
        return motor_settings(
            name,
            part.motor_id,
            ports.profile,
            scenario.tail_motor,
            (-limit, limit),
            gains,
            direction=part.direction or direction,
            zero=part.zero,
            safety=safety,
        )

    motors = (
        settings("tail pitch", ports.tail_pitch, scenario.tail.pitch_limit, mounting.tail_pitch_direction),
        settings("tail roll", ports.tail_roll, scenario.tail.roll_limit, mounting.tail_roll_direction),
    )
    check_distinct_ids(motors)
    return motors


def direct_can(
    scenario: Scenario,
    ports: CarPorts,
    authorise: Callable[[], None],
    start_watchdog: StartWatchdog,
    traffic_log: Path | None = None,
    say: Say = tell_on_stderr,
    name: Literal["direct_can", "watched_can"] = "direct_can",
) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet.

    Args:
        authorise: raises `HardwareError` while no watchdog test of this wiring is recorded.
        start_watchdog: called once the adapter is open, with its lock for the watchdog to inherit.
        traffic_log: a new `.blf` file for every frame on the bus.
        say: is told when the watchdog of an earlier drive is waited for.
        name: `watched_can` with the Teensy as a second watchdog.

    Raises:
        HardwareError: the ports name no CAN adapter, or the motors' settings do not fit.
    """
    can, limits, mounting = ports.adapter(name), load_drive_safety(), load_mounting()
    motors = tail_motors(scenario, ports, mounting)

    def open_devices() -> Devices:
        locks = lock_car(ports, say, can)
        with closing_on_error(*locks) as closers:
            bus = CanBus.open(can, traffic_log, listen={0, ANSWER_ID, *ports.motor_ids})
            closers += [bus.close, lambda: _switch_off(bus, ports)]  # the other way round after a failed start
            watch = BusWatch(bus, load_watchdog_timing())
            port: FramePort = watch if name == "watched_can" else bus
            devices = open_common(ports, motors, limits, closers, lambda _: port)
            devices.traffic_error = lambda: bus.log_error
            process = start_watchdog(can, locks[0])
            devices.watchdog = Watchdogs(process, watch) if name == "watched_can" else process
            closers.append(devices.watchdog.close)
            return devices

    return WiredCar(name, bool(motors), mounting, open_devices, authorise, ports.car)


def _switch_off(bus: CanBus, ports: CarPorts) -> None:
    """Exit frames to motors that an earlier program may have left on."""
    for frame in exit_frames(ports.motor_ids):
        bus.send(frame, urgent=True)


def teensy_bridge(
    scenario: Scenario,
    ports: CarPorts,
    authorise: Callable[[], None],
    say: Say = tell_on_stderr,
) -> WiredCar:
    """The car of a scenario on this wiring; opens nothing yet. Arguments and errors as for `direct_can`."""
    limits, mounting = load_drive_safety(), load_mounting()
    motors = tail_motors(scenario, ports, mounting)

    def open_devices() -> Devices:
        with closing_on_error(*lock_car(ports, say)) as closers:
            return open_common(ports, motors, limits, closers, lambda teensy: teensy)

    return WiredCar("teensy_bridge", bool(motors), mounting, open_devices, authorise, ports.car)
