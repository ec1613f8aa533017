"""Does the car stand still and upright, and does its IMU live? Looked at for a moment right before it is armed.

A chip whose samples do not change by a single bit has frozen: its noise alone moves the last digits all the time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from aerodima.hardware.car.drive_safety import DriveSafety
from aerodima.hardware.devices.bno055 import Bno055Sample
from aerodima.hardware.drive.drive_checks import Check
from aerodima.workbench.config.signal_table import IMU

_LEAST_SAMPLES = 10
_ROLL, _PITCH = IMU.index("roll"), IMU.index("pitch")


def standstill_checks(samples: Sequence[Bno055Sample], reading: np.ndarray, safety: DriveSafety) -> list[Check]:
    """What the last moment says of the car.

    Args:
        samples: of the chip, all that came within the moment, in its own axes.
        reading: (9,) `aerodima.workbench.config.signal_table.IMU`, the newest, in body axes.
    """
    different = {(sample.quaternion, sample.gyro, sample.acceleration) for sample in samples}
    count = len(samples)
    lives = count >= _LEAST_SAMPLES and len(different) > 1
    found = f"{count} samples, {len(different)} different ones" + ("" if lives else "; it has frozen or is silent")
    checks = [Check("IMU", lives, found)]
    if not samples:
        return checks
    gyro = samples[-1].calibration[1]
    text = f"gyro {gyro} of 3; allowed is {safety.gyro_calibration}: let the car stand for some seconds"
    checks.append(Check("IMU calibration", gyro >= safety.gyro_calibration, text))
    turning = float(np.max(np.linalg.norm([sample.gyro for sample in samples], axis=1)))
    pushed = float(np.linalg.norm(np.mean([sample.acceleration for sample in samples], axis=0)))
    still = turning <= safety.still_rate and pushed <= safety.still_acceleration
    allowed = f"{safety.still_rate:g} and {safety.still_acceleration:g}"
    text = f"turns at {turning:.2f} rad/s, is pushed by {pushed:.2f} m/s2; allowed: {allowed}"
    checks.append(Check("car stands still", still, text))
    tilt = max(abs(float(reading[_ROLL])), abs(float(reading[_PITCH])))
    text = f"tilted by {math.degrees(tilt):.0f} degrees; allowed is {math.degrees(safety.upright):.0f}"
    return [*checks, Check("car stands upright", tilt <= safety.upright, text)]
