"""A tail law of one's own drives the real car as it does the simulated one, and the log of the
drive names it.
"""

from __future__ import annotations

import numpy as np
import pytest

from aerodima.hardware.car.car_ports import ports_from_dict
from aerodima.hardware.driving.drive_session import DriveOptions, run_drive
from aerodima.workbench.logs.schema import read_run_log
from tests.hardware.car.fake_devices import PORTS, CarOnTheBench, ImuAtRest

QUICK = [
    "manoeuvre.straight_time=0.5",
    "manoeuvre.speed_ramp=0.3",
    "manoeuvre.wait_after_turn=0.1",
    "manoeuvre.log_end=1.2",
]


class Upright:
    """Asks for one angle, 0.3 rad, all the time."""

    rate = 100.0
    memory_size = 0

    def start(self):
        return np.zeros(0)

    def step(self, memory, observation):
        return memory, np.array([0.0, 0.0, 17.0, 5.0, 0.0]), np.array([0.3, 0.0, 17.0, 5.0, 0.0]), 1


@pytest.mark.realtime
@pytest.mark.parametrize("with_drake", [True, False])
def test_law_drives_the_car_and_is_named_in_the_log(tmp_path, with_drake):
    bench = CarOnTheBench(*QUICK)
    path = tmp_path / "run.parquet"
    bench.devices.imu = ImuAtRest()
    options = DriveOptions(path, with_drake=with_drake, law_name="Upright")
    result = run_drive(
        bench.car, bench.scenario, ports_from_dict(PORTS), options, lambda line: None, law=Upright()
    )
    assert result.orderly
    log = read_run_log(path)
    assert log.extra["tail_law"] == "Upright"
    assert log.table["tail_roll_command_position_rad"].iloc[-1] == 0.3
