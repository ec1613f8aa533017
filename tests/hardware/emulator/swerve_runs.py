"""Swerves of test cars, simulated and on the emulated car, also with a fault in mid-swerve: the
tables of docs/swerves.md.

`python -m tests.hardware.emulator.swerve_runs FILE --plant PLANT` adds a line per run to FILE, a
CSV table; PLANT is `simulated` or a wiring. `--car`, `--fault`, `--runs` and `--share` of the best
steering say which; with `--at-full-lock` the driver turns the wheels to the stop, and the car has
law and rollover control. Without `--plant` it prints the tables of FILE. A run that a busy computer
disturbed is repeated.
"""

import argparse
import csv
import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydrake.systems.framework import LeafSystem

from aerodima.hardware.car.wiring import WIRINGS
from aerodima.hardware.driving.drive_session import drive
from aerodima.hardware.driving.stop_posture import HELD, OFF, Posture
from aerodima.hardware.driving.watchdog_test import run_watchdog_test
from aerodima.optimisation.swerve.steering import constant_steering, steering_settings
from aerodima.optimisation.swerve.suite import FEEDBACK, NAMED_CANDIDATES
from aerodima.workbench import TailController, TurnDriver, make_driver, simulate
from aerodima.workbench.car.swerve import SOON, outline_from_above
from aerodima.workbench.car.turn_course import ground_velocity
from aerodima.workbench.car.turn_signals import STEERED
from aerodima.workbench.control.driver_law import LimitedDriver, ScheduledDriver
from aerodima.workbench.control.law_of_scenario import law_of_scenario
from aerodima.workbench.control.manoeuvre import DriverInput, make_schedule
from aerodima.workbench.control.tail_law import NO_COMMAND
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import outcome_from
from aerodima.workbench.scenario.ensemble import load_ensemble
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import WHEELS
from tests.code_measure import ROOT
from tests.hardware.emulator.emulator_process import EmulatorProcess, undisturbed

CARS = ("car025", "car018", "car019", "car027")
"""Test cars of `physical.yaml`; the first is the one that docs/swerves.md shows."""
SHARE = 0.8
"""Usual share of the angles of its best steering that a car is driven with."""
START = 4.0
"""Start of the steering, s after that of the drive: a second after the car has its speed."""
STANDING_START = (
    "manoeuvre.rolling_start=false",
    "manoeuvre.speed_ramp=3",  # the throttle rises more slowly than the guard of the car lets it
    f"manoeuvre.turn_start={START}",
    "manoeuvre.duration=7",
    "simulation.step=0.004",  # a computer that runs car and drive has time for both
    "simulation.log_rate=250",
)
FAULT_TIME = START + 0.2
WATCHED = 2.9
"""Time after the start of the steering in which a car has to stay upright, s."""
SWUNG = 0.5
"""Roll of the tail at which the swing counts as begun, rad off its roll at the start."""


@dataclass(frozen=True)
class Fault:
    """A fault in mid-swerve.

    Attributes:
        name: for the table.
        entry: of the emulator's script, without its time, by wiring; None for one in the computer.
        breaks: called in every tick of the drive's diagram from the fault on.
        acts: how long the drive or the firmware takes to act, of hardware/emulator/fault_table.csv,
            s; for the simulated car.
        posture: of the tail after that.
        roll_limp: the roll motor is off from then on.
        holds: until then motors and servo keep their last commands, and the throttle its own.
        is_blind: until then the law sees the last sample of the IMU.
        is_stop: the operator stops the car.
    """

    name: str
    entry: dict[str, str] | None
    acts: float
    posture: Posture
    breaks: Callable[[], None] = lambda: None
    roll_limp: bool = False
    holds: bool = False
    is_blind: bool = False
    is_stop: bool = False

    def script(self, wiring: str) -> dict[str, Any]:
        """Content of the emulator's script, whose clock runs from the first throttle on."""
        entry = self.entry
        if entry and entry.get("fault") == "unplugged" and wiring == "watched_can":
            entry = {**entry, "part": "can"}
        operator: list[dict[str, Any]] = [{"time": 0.0, "mode": "auto_when_asked"}]
        if self.is_stop:
            operator.append({"time": FAULT_TIME, "stop": True})
        faults = [] if entry is None else [{"time": FAULT_TIME, **entry}]
        return {"clock": "driving", "faults": faults, "operator": operator}


def _raise() -> None:
    raise ZeroDivisionError("in mid-swerve")


NONE = Fault("none", None, math.inf, HELD)
FAULTS = (
    Fault("IMU silent", {"fault": "silent", "part": "imu"}, 0.1, HELD, is_blind=True),
    Fault("IMU frozen", {"fault": "frozen", "part": "imu"}, 0.1, HELD, is_blind=True),
    Fault(
        "replies of the roll motor lost",
        {"fault": "reply_lost", "part": "tail_roll"},
        0.06,
        HELD,
        roll_limp=True,
    ),
    Fault(
        "roll motor at 95 degrees Celsius",
        {"fault": "over_temperature", "part": "tail_roll"},
        0.02,
        HELD,
        roll_limp=True,
    ),
    Fault(
        "Teensy or adapter unplugged",
        {"fault": "unplugged", "part": "teensy"},
        0.15,
        OFF,
        holds=True,
    ),
    Fault("GPS silent", {"fault": "silent", "part": "gps"}, 0.98, HELD),
    Fault("radio silent", {"fault": "silent", "part": "radio"}, 0.24, HELD),
    Fault("emergency stop", None, 0.04, OFF, is_stop=True),
    Fault("controller raises", None, 0.01, HELD, _raise),
    Fault("controller takes 50 ms", None, 0.3, HELD, lambda: time.sleep(0.05), holds=True),
)


def car_settings(car: str, share: float | None) -> list[str]:
    """Settings of a test car on its own friction that swerves from a standing start with the law
    and a share of the angles of its best steering. A share of None is a driver at full lock, with
    law and rollover control.
    """
    member = next(one for one in load_ensemble("physical").members if one.name == car)
    settings = [*member.settings_on("swerve"), *STANDING_START]
    if share is None:
        stop = load_scenario("swerve", settings).servo.limit
        settings += NAMED_CANDIDATES["feedback-rollover-control"].settings
        return [*settings, *steering_settings(constant_steering(stop, 1)[:, 0])]
    return [*settings, *FEEDBACK.settings, *best_steering(car, share)]


def best_steering(car: str, share: float) -> list[str]:
    """Settings of a share of the angles of the best steering of a full car with the law, on its own
    friction at 6 m/s, for half a second.
    """
    table = pd.read_csv(ROOT / "models" / "swerve" / "swerves.csv")
    is_own = (table["car"] == car) & (table["plant"] == "full") & (table["floor"] == "x 1")
    is_own &= (table["candidate"] == FEEDBACK.name) & (table["aim"] == "aside-0.5")
    if not is_own.any():
        raise UserError(f"{car}: has no best steering in swerves.csv; must be a test car")
    (stored,) = table.loc[is_own, "settings"]
    best = load_scenario("swerve", json.loads(stored)).manoeuvre
    levels = [f"manoeuvre.level_{n}={share * getattr(best, f'level_{n}'):.6f}" for n in (1, 2, 3)]
    ends = [f"manoeuvre.level_{n}_end={getattr(best, f'level_{n}_end'):.2f}" for n in (1, 2)]
    return [*levels, *ends]


class FaultyDriver:
    """A schedule whose steering and throttle are 0 once the drive has acted on a fault."""

    def __init__(self, schedule: Any, fault: Fault) -> None:
        self._schedule = schedule
        self._fault = fault

    def at(self, time_s: float) -> DriverInput:
        """Inputs at a time, s."""
        if time_s >= FAULT_TIME + self._fault.acts:
            return DriverInput(0.0, 0.0, 0.0)
        if self._fault.holds and time_s > FAULT_TIME:
            return self._schedule.at(FAULT_TIME)
        return self._schedule.at(time_s)


class FaultyLaw:
    """A law until a fault, then what drive and firmware make of it; for one run."""

    def __init__(self, scenario: Any, fault: Fault) -> None:
        self._law = law_of_scenario(scenario)
        self._fault = fault
        self._gains = [0.0, scenario.controller.hold_kp, scenario.controller.hold_kd, 0.0]
        self.rate = self._law.rate
        self.memory_size = self._law.memory_size
        self.start = self._law.start

    def step(self, memory: Any, seen: Any) -> Any:
        """A tick of the law, or the commands that take its place."""
        fault = self._fault
        if seen.time < FAULT_TIME:
            self._pitch = seen.pitch_angle
            self._imu = seen.imu
            self._last = self._law.step(memory, seen)
            return self._last
        if seen.time < FAULT_TIME + fault.acts and fault.holds:
            return self._last
        if seen.time < FAULT_TIME + fault.acts:
            if fault.is_blind:
                seen = replace(seen, imu=self._imu)
            return self._law.step(memory, seen)
        limp = memory, NO_COMMAND, NO_COMMAND, 0
        if fault.posture is OFF:
            return limp
        pitch = np.array([self._pitch, *self._gains])
        return memory, pitch, NO_COMMAND if fault.roll_limp else np.array([0.0, *self._gains]), 0


class Broken(LeafSystem):
    """Something in the diagram that breaks at the time of the fault."""

    def __init__(self, breaks: Callable[[], None]) -> None:
        super().__init__()
        self._breaks = breaks
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, self._tick)

    def _tick(self, context: Any, state: Any) -> None:
        del state
        if context.get_time() >= FAULT_TIME:
            self._breaks()


def simulated(scenario: Any, fault: Fault) -> Any:
    """The log of a simulated swerve."""

    def build(builder: Any, station: Any) -> None:
        faulty: Any = ScheduledDriver(FaultyDriver(make_schedule(scenario), fault))
        limited = make_driver(scenario)
        if isinstance(limited, LimitedDriver):
            faulty = replace(limited, driver=faulty)
        driver = TurnDriver.add_to_builder(builder, faulty, station=station)
        law = FaultyLaw(scenario, fault)
        TailController.add_to_builder(builder, scenario, station=station, driver=driver, law=law)

    return simulate(scenario, build=build)


def emulated(scenario: Any, fault: Fault, wiring: Any, folder: Path) -> tuple[Any, str]:
    """The truth of a swerve of the emulated car from the throttle on, and why the drive ended."""

    def build(builder: Any, station: Any) -> None:
        driver = TurnDriver.add_to_builder(builder, make_driver(scenario), station=station)
        TailController.add_to_builder(builder, scenario, station=station, driver=driver)
        builder.AddSystem(Broken(fault.breaks))

    with EmulatorProcess(folder, scenario, wiring, fault.script(wiring)) as emulator:
        run_watchdog_test(scenario, emulator.ports, wiring, lambda _: True, "emulator")
        log = folder / "drive.parquet"
        says: list[str] = []
        result = drive(
            build, scenario, emulator.ports, log, wiring=wiring, arm=True, say=says.append
        )
        assert result.orderly or fault is not NONE, result.reason
        assert "fell behind" not in result.reason, result.reason
        time.sleep(WATCHED)
    return read_run_log(emulator.folder / "truth.parquet"), result.reason


def from_the_start(log: Any) -> Any:
    """The log of a run whose steering starts at `START`, as the scenario says, and what follows."""
    steers = np.abs(log.signal("steering_command_rad")) > STEERED
    shifted = log.time - log.time[np.argmax(steers)] + START
    table = log.table.assign(time_s=shifted)
    inside = (shifted > START - 1.0) & (shifted <= START + WATCHED)
    return replace(log, table=table[inside].reset_index(drop=True))


def figures_of(log: Any) -> dict[str, float | bool]:
    """What a swerve comes to, from the ground truth."""
    log = from_the_start(log)
    after = log.time >= START
    time_since = log.time[after] - START
    heading = np.unwrap(log.signal("yaw_truth_rad"))[after]
    tail = log.signal("tail_roll_angle_rad")[after]
    swings = np.abs(tail - tail[0]) > SWUNG
    loads = np.stack([log.signal(f"wheel_force_{wheel}_z_truth_n") for wheel in WHEELS], axis=1)
    outcome = outcome_from(log.time[after], log.signal("tilt_truth_rad")[after], loads[after])
    before, soon = np.min(outline_from_above(log, (0.0, SOON))[1], axis=0)
    speed, _ = ground_velocity(log)
    return {
        "upright": outcome.result == "survived",
        "speed_m_per_s": float(speed[after][0]),
        "heading_deg": math.degrees(heading[-1] - heading[0]),
        "swing_s": float(time_since[np.argmax(swings)]) if np.any(swings) else math.nan,
        "roll_deg": math.degrees(np.max(np.abs(log.signal("roll_truth_rad")[after]))),
        "aside_m": float(soon - before),
    }


def run(car: str, plant: str, fault: Fault, seed: int, share: float | None) -> dict[str, Any]:
    """A line of the table."""
    scenario = load_scenario("swerve", car_settings(car, share)).varied(seed=seed)
    reason = ""
    if plant == "simulated":
        log = simulated(scenario, fault)
    else:
        with tempfile.TemporaryDirectory() as folder:
            log, reason = undisturbed(
                lambda place: emulated(scenario, fault, plant, place), Path(folder)
            )
    figures = figures_of(log)
    return {"car": car, "plant": plant, "fault": fault.name, "seed": seed, **figures} | {
        "reason": reason
    }


def tables(runs: pd.DataFrame) -> str:
    """Markdown: means of swerves without a fault by car and plant, and how many of those with one
    stay upright.
    """
    lines = [
        "| car | driven | speed | turned by | tail swings after | peak roll | aside |",
        "|---" * 7 + "|",
    ]
    is_whole = runs["fault"] == NONE.name
    for names, own in runs[is_whole].groupby(["car", "plant"], sort=False):
        mean = own.mean(numeric_only=True)
        cells = (
            *map(str, names),
            f"{mean['speed_m_per_s']:.2f} m/s",
            f"{mean['heading_deg']:.1f}°",
            f"{1000 * mean['swing_s']:.0f} ms",
            f"{mean['roll_deg']:.1f}°",
            f"{mean['aside_m']:.3f} m",
        )
        lines.append(f"| {' | '.join(cells)} |")
    plants = runs["plant"].unique()
    lines += ["", f"| fault | {' | '.join(plants)} |", "|---" * (1 + len(plants)) + "|"]
    for fault, own in runs[~is_whole].groupby("fault", sort=False):
        parts = [own.loc[own["plant"] == plant, "upright"] for plant in plants]
        cells = (str(fault), *(f"{part.sum()} of {len(part)}" for part in parts))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--plant", choices=("simulated", *WIRINGS))
    parser.add_argument("--car", nargs="+", default=CARS)
    parser.add_argument("--fault", nargs="*", help="names, all when none is given")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--share", type=float, default=SHARE, help="of the best steering")
    parser.add_argument(
        "--at-full-lock",
        dest="share",
        action="store_const",
        const=None,
        help="turn the wheels to the stop, with law and rollover control",
    )
    asked = parser.parse_args()
    if asked.plant is None:
        print(tables(pd.read_csv(asked.file)))
        return
    faults = (NONE,)
    if asked.fault is not None:
        faults = tuple(one for one in FAULTS if not asked.fault or one.name in asked.fault)
    for car in asked.car:
        for fault in faults:
            for seed in range(1, asked.runs + 1):
                line = run(car, asked.plant, fault, seed, asked.share)
                print(line, flush=True)
                is_new = not asked.file.exists()
                with asked.file.open("a", newline="", encoding="utf-8") as file:
                    writer = csv.DictWriter(file, line)
                    if is_new:
                        writer.writeheader()
                    writer.writerow(line)


if __name__ == "__main__":
    main()
