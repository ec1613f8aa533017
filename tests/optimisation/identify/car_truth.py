"""Logs of emulated drives whose truth is known: another car each, with latency, bias, and a plant
of finer steps.
"""

from dataclasses import dataclass, replace

import numpy as np

from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_sensors import STEPS
from aerodima.workbench.control.manoeuvre import make_schedule
from aerodima.workbench.scenario.scenario import load_scenario
from tests.certain_cars import HIGH_BODY

RANGES = {
    "tyre_friction": (0.35, 0.9),
    "tyre_slip_angle": (0.03, 0.24),
    "com_height": (0.15, 0.25),
    "delay": (0.0, 0.1),
    "gyro_bias_z": (-0.03, 0.03),
    "speed": (2.6, 3.2),
}
"""Of the truth; the height only where friction times height over half the track is below `STABLE`,
so that most cars stay on their wheels."""
STABLE, STEP = 1.0, 0.0005
"""Step of the true plant, s, a quarter of that of the fitted one: so there is an error of the
model."""


@dataclass(frozen=True)
class Truth:
    """A drive: values as `RANGES`, and the seed of its sensors."""

    values: dict[str, float]
    seed: int


def drawn(number):
    """Of a number; the same at every call."""
    rng = np.random.default_rng([31, number])
    values = {name: float(rng.uniform(*limits)) for name, limits in RANGES.items()}
    half_track = 0.5 * load_scenario("turn_none", HIGH_BODY).car.track
    values["com_height"] = min(values["com_height"], STABLE * half_track / values["tyre_friction"])
    values["delay"] = round(values["delay"] / STEP) * STEP
    return Truth(values, int(rng.integers(1 << 30)))


def emulated(truth):
    """A log as the car would write it: sensors and commands alone, and the scenario as it is taken
    to be.
    """
    settings = [
        *HIGH_BODY,
        f"manoeuvre.speed={truth.values['speed']}",
        "manoeuvre.duration=3.05",
        "imu.gyro_bias=0",
        f"seed={truth.seed}",
    ]
    planned = load_scenario("turn_none", settings)
    real = planned.varied(
        car={key: truth.values[key] for key in ("tyre_friction", "tyre_slip_angle", "com_height")},
        manoeuvre={"turn_start": planned.manoeuvre.turn_start + truth.values["delay"]},
        simulation={"step": STEP},
        controller={"rate": 1.0 / STEP},
        servo={"frame_rate": 1.0 / STEP},
    )
    run = simulate(real, record="outcome", stop_when_certain=False)
    table = run.table[[column for column in run.table if "_truth_" not in str(column)]].copy()
    schedule = make_schedule(planned)
    table["steering_command_rad"] = [schedule.at(time).steering_angle for time in table["time_s"]]
    gyro = "imu_gyro_z_rad_per_s"
    biased = (table[gyro] + truth.values["gyro_bias_z"]) / STEPS[3]
    # The rounding is undone, before it is rounded again.
    rounding = np.random.default_rng(truth.seed).uniform(-0.5, 0.5, len(table))
    table[gyro] = np.rint(biased + rounding) * STEPS[3]
    for source, sensor in (("imu", planned.imu), ("speed", planned.gps)):
        taken = np.floor((table["time_s"] - sensor.delay) * sensor.rate + 1e-6) / sensor.rate
        table[f"status_{source}_age_s"] = table["time_s"] - taken
    return replace(run, table=table, scenario=planned.resolved(), source="turn_none.parquet")
