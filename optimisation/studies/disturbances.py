"""What may be otherwise than planned in a turn, all at once, drawn by a seed."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.study import Sample, Uniform
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.errors import SweepError

AIR_SHARE, FRICTION_SHARE, TORQUE_SHARE, SPEED_SHARE = 0.3, 0.05, 0.2, 0.03
LIMIT_SHARE = 0.3
"""By which the largest torque of the tail motors may fall short."""
DELAY = 0.020
"""s, on top of the delay of the scenario's IMU."""
NOISE_FACTOR = 4.0
"""Noise and bias of the IMU grow by this: to about the upper ends of their priors."""
LATE = 0.050
"""Latest swing after its release, s: five ticks of the controller."""
MISSED_SHARE = 0.1
"""Of the draws that miss their release; the tail then waits on the inside through the whole turn."""
NEVER = 10.0
"""s; longer than any turn here, and the longest delay that a controller may have."""
MOST_DRAWS = 1000
"""Disturbed runs of a car in one study."""


@dataclass(frozen=True)
class Disturbance:
    """What differs from the plan.

    Attributes:
        air, friction, speed, torque: relative changes of the force on the sail, of the tyres' friction, of the
            commanded speed and of the torque that a command gives.
        torque_limit: relative change of the largest torque of the tail motors.
        imu_delay: on top of the scenario's, s.
        imu_noise: factor of the IMU's noise and bias.
        late: time from the release to the swing on top of the law's own, s; `NEVER` misses it.
        seed: of the sensors' noise; None: the scenario's.
    """

    air: float = 0.0
    friction: float = 0.0
    speed: float = 0.0
    torque: float = 0.0
    torque_limit: float = 0.0
    imu_delay: float = 0.0
    imu_noise: float = 1.0
    late: float = 0.0
    seed: int | None = None

    def settings(self, scenario: Scenario) -> tuple[str, ...]:
        """Overrides that make it, of the scenario that is disturbed.

        The force of the sail is changed through the density of the air, which acts on nothing else, so that every kind
        of coefficients can be disturbed; it equals a change of C_N.
        """
        air, car, imu = scenario.environment.air_density, scenario.car, scenario.imu
        found = [f"environment.air_density={air * (1 + self.air):.9g}"] if self.air else []
        found += [f"imu.delay={imu.delay + self.imu_delay:.9g}"] if self.imu_delay else []
        if self.imu_noise != 1.0:
            noises = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")
            found += [f"imu.{name}={self.imu_noise * getattr(imu, name):.9g}" for name in noises]
        found += [f"{FRICTION}={car.tyre_friction * (1 + self.friction):.9g}"] if self.friction else []
        found += [f"{SPEED}={scenario.manoeuvre.speed * (1 + self.speed):.9g}"] if self.speed else []
        found += [f"tail_motor.torque_error={self.torque:.9g}"] if self.torque else []
        if self.torque_limit:
            found += [f"tail_motor.torque_limit={scenario.tail_motor.torque_limit * (1 + self.torque_limit):.9g}"]
        if self.late:
            found += [f"controller.delay={min(NEVER, scenario.controller.delay + self.late):.9g}"]
        return (*found, *(() if self.seed is None else (f"seed={self.seed}",)))

    @property
    def missed(self) -> bool:
        """Whether the tail never swings."""
        return self.late >= NEVER


def draw_disturbances(number: int, seed: int, car: str) -> list[Disturbance]:
    """Everything at once, evenly from the ranges of this file (Sobol): the first ones of a car are those of any number.

    Args:
        number: of draws.
        seed: with the name of the car that of the draws.
        car: its name.

    Raises:
        SweepError: a number below 1 or above `MOST_DRAWS`.
    """
    if not 1 <= number <= MOST_DRAWS:
        raise SweepError(f"{number} disturbed runs of a car: allowed: 1 to {MOST_DRAWS}")
    ranges = {"air": AIR_SHARE, "friction": FRICTION_SHARE, "speed": SPEED_SHARE, "torque": TORQUE_SHARE}
    factors: dict[str, Uniform] = {name: Uniform(low=-share, high=share) for name, share in ranges.items()}
    factors |= {
        "torque_limit": Uniform(low=-LIMIT_SHARE, high=0.0),
        "imu_delay": Uniform(low=0.0, high=DELAY),
        "imu_noise": Uniform(low=1.0, high=NOISE_FACTOR),
        "release": Uniform(low=0.0, high=1.0),
    }
    sample = Sample(number=number, seed=zlib.crc32(f"{seed} {car}".encode()), factors={**factors}, new_seeds=True)
    found = []
    for row in sample.rows():
        release, noise = float(row.pop("release")), int(row.pop("seed"))
        late = LATE * (release - MISSED_SHARE) / (1.0 - MISSED_SHARE) if release >= MISSED_SHARE else NEVER
        drawn = {name: float(f"{float(value):.6g}") for name, value in row.items()}
        found.append(Disturbance(**drawn, late=float(f"{late:.6g}"), seed=noise))
    return found
