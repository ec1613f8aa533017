"""A drive for the latency benchmark of the console: arms, obeys MANUAL, stops, and begins anew by
itself.

What moves bytes is that of a real drive: wiring, guard and motors at 100 Hz. Only the next drive,
which somebody starts on a real car, comes by itself here, so that an emergency stop needs no new
process.

Run as `python -m tests.benchmarks.rearming_drive PORTS_FILE [SETTING...]`; ended by SIGTERM.
"""

import contextlib
import signal
import sys
import threading
import time
from pathlib import Path

from aerodima.hardware.car.car_ports import read_ports
from aerodima.hardware.car.safety_settings import load_drive_safety
from aerodima.hardware.car.wiring import PERIOD, CarCommand
from aerodima.hardware.car.wirings import wire_car
from aerodima.hardware.driving.car_guard import CarGuard, Stage
from aerodima.hardware.driving.plain_loop import ManualPilot, wait_until
from aerodima.hardware.protocol.radio import RadioMode
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.realtime import prefer_latency
from aerodima.workbench.scenario.scenario import load_scenario

_REST = 0.3
"""s that a stopped car stays stopped, in which the operator hears of it."""


def main() -> None:
    """Turns until SIGTERM."""
    scenario = load_scenario("auto_turn", sys.argv[2:])
    ports = read_ports(Path(sys.argv[1]))

    def start() -> CarGuard:
        car = wire_car(scenario, ports, "teensy_bridge", lambda: None)
        car.start()
        return CarGuard(car, load_drive_safety())

    guard = start()
    pilot = ManualPilot(scenario)
    stopped = 0.0
    ended = threading.Event()  # an exception of the handler may be raised where Python ignores it
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    try:
        prefer_latency()
        due = time.monotonic()
        while not ended.is_set():
            now = time.monotonic()
            guard.read(now)
            if guard.stage is Stage.READY:
                with contextlib.suppress(HardwareError):  # a device is not heard yet
                    guard.arm(now)
            elif guard.ready and guard.was_idle and guard.reading.operator.mode is RadioMode.MANUAL:
                pilot = ManualPilot(scenario)
                guard.drive(RadioMode.MANUAL, now)
            elif guard.finished:
                stopped = stopped or now
                if now - stopped > _REST:
                    stopped = 0.0
                    guard.wiring.stop("the next drive begins")
                    guard = start()
            driving = guard.stage is Stage.DRIVING
            guard.write(pilot.step(0.0, guard.reading).command if driving else CarCommand(), now)
            due = max(due + PERIOD, now - 0.05)
            wait_until(due)
    finally:
        guard.wiring.stop("the benchmark is over")


if __name__ == "__main__":
    main()
