"""What may be otherwise than planned: named changes of a scenario that a controller should stand."""

from __future__ import annotations

from dataclasses import dataclass

from aerodima.workbench.config.scenario import Scenario

AIR_SHARE, FRICTION_SHARE, TORQUE_SHARE = 0.3, 0.05, 0.2
DELAY = 0.020
"""s, on top of the delay of the scenario's IMU."""
NOISE_FACTOR = 4.0
"""Noise and bias of the IMU grow by this: to about the upper ends of their priors."""


@dataclass(frozen=True)
class Perturbation:
    """A change: a name for tables, and the settings that make it."""

    name: str
    settings: tuple[str, ...]


def perturbations(scenario: Scenario) -> list[Perturbation]:
    """The changes of a scenario, "as planned" first.

    The force of the sail is changed through the density of the air, which acts on nothing else, so that every kind of
    coefficients can be perturbed; it equals a change of C_N.
    """
    air, friction, imu = scenario.environment.air_density, scenario.car.tyre_friction, scenario.imu
    noises = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")
    noisy = tuple(f"imu.{name}={NOISE_FACTOR * getattr(imu, name):.9g}" for name in noises)
    late = f"imu.delay={imu.delay + DELAY:.9g}"
    weak, strong = (f"environment.air_density={air * (1 + sign * AIR_SHARE):.9g}" for sign in (-1, 1))
    return [
        Perturbation("as planned", ()),
        Perturbation("C_N -30 %", (weak,)),
        Perturbation("C_N +30 %", (strong,)),
        Perturbation("IMU 20 ms late", (late,)),
        Perturbation("IMU noise x4", noisy),
        Perturbation("C_N -30 %, late, noisy", (weak, late, *noisy)),
        Perturbation("C_N +30 %, late, noisy", (strong, late, *noisy)),
        Perturbation("friction -5 %", (f"car.tyre_friction={friction * (1 - FRICTION_SHARE):.9g}",)),
        Perturbation("friction +5 %", (f"car.tyre_friction={friction * (1 + FRICTION_SHARE):.9g}",)),
        Perturbation("torque -20 %", (f"tail_motor.torque_error={-TORQUE_SHARE}",)),
        Perturbation("torque +20 %", (f"tail_motor.torque_error={TORQUE_SHARE}",)),
    ]
