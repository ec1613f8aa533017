"""Summary of a run for tables and plots over many runs, and the published figures beside it.

Everything comes from the run log. `RunSummary` is small and pickles, so a worker process can send
it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import trapezoid

from aerodima.workbench.car.tail_impulses import CAUSES, Impulses, tail_impulses
from aerodima.workbench.car.turn_signals import SENSOR_COLUMNS, turn_window
from aerodima.workbench.car.verdict import FLIP_TILT
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.swing_library import NO_SWING
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import checked_signals, in_parts
from aerodima.workbench.metrics.published_values import Platform, PublishedValues, published_values
from aerodima.workbench.metrics.turn_metrics import Outcome, RunMetrics, metrics_of, outcome_from
from aerodima.workbench.scenario.ensemble import BUILT

TAILS = "tails"
"""Key in `extra` of a `plant_run`: name and body of each tail force."""
STOP = ("stop_time_s", "stop_reason")
"""Keys in `extra` of a drive of the car that was stopped before its end: time of the stop, s after
the start, and its reason. A drive that reached its end has the reason alone."""
KM_PER_H = 3.6
"""Speed of 1 m/s in km/h."""
PUBLISHED_RUNS: dict[tuple[str, int], tuple[tuple[Platform, str], ...]] = {
    ("none", 12): (("simulated", "tailless"), ("physical", "tailless")),
    ("swing", 16): (("simulated", "tailed"),),
}
"""Published rows for each tail mode and commanded speed in whole km/h. The thesis stepped the
speed in whole km/h (ERRATA E37); its tailed car swung the tail. The physical tailed row (6.10 m/s)
is faster than any run of the demo."""
MODE_WORDS = {
    "none": "no tail",
    "held": "tail held",
    "swing": "tail swings",
    "designed": "designed tail swings",
    "optimised": "optimised swing",
}
"""Name of each tail mode on pages, in the order of tables."""


def tails_of(run_log: RunLog) -> list[tuple[str, str]]:
    """Returns name and body of each tail force of a `plant_run`; the name begins its columns."""
    return [(str(tail["name"]), str(tail["body"])) for tail in run_log.extra.get(TAILS, [])]


def air_force(run_log: RunLog, name: str) -> FloatArray:
    """Returns the magnitude of the force of the air on a tail, N, shape (n,)."""
    return np.linalg.norm(run_log.vector(name, "truth_n"), axis=1)


def plant_speed(run_log: RunLog) -> FloatArray:
    """Returns the speed of the centre of mass, m/s, shape (n,)."""
    return np.linalg.norm(run_log.vector("com_velocity", "truth_m_per_s"), axis=1)


def plant_tilt(run_log: RunLog) -> FloatArray | None:
    """Returns the angle of the base's z axis from the world's, degrees, shape (n,); None without a
    base.
    """
    if "tilt_truth_rad" in run_log.table:
        return np.degrees(run_log.signal("tilt_truth_rad"))
    return None


def plant_air(run_log: RunLog) -> FloatArray | None:
    """Returns the sum of the magnitudes of the air's forces on all tails, N, (n,); None without a
    tail.
    """
    forces = [air_force(run_log, name) for name, _ in tails_of(run_log)]
    if forces:
        return np.asarray(np.sum(forces, axis=0))
    return None


def of_plants(run_logs: Sequence[RunLog]) -> bool:
    """Returns whether `observe` logged these runs; LogError if it logged some but not all."""
    plants = [run_log.kind == PLANT_RUN for run_log in run_logs]
    if any(plants) and not all(plants):
        car = run_logs[plants.index(False)].name
        plant = run_logs[plants.index(True)].name
        raise LogError(
            f"{plant} is a run of another plant than the car, {car} is not; name logs of one kind"
        )
    return any(plants)


def plant_outcome(run_log: RunLog) -> Outcome | None:
    """Returns whether the base stayed upright, as for a car without wheel loads; None without a
    base that starts upright.
    """
    if "tilt_truth_rad" not in run_log.table:
        return None
    tilt = run_log.signal("tilt_truth_rad")
    if tilt[0] <= FLIP_TILT:
        return outcome_from(run_log.time, tilt)
    return None


def plant_metrics(run_log: RunLog) -> dict[str, float | str | None]:
    """Returns one flat row for a table; units are at the end of the names.

    `outcome`: see `plant_outcome`, None where it is not defined. Tilt and heading are those of the
    base, speed, height and path those of the centre of mass. The heading changes from the first row
    to the last; `heading_change_rad` of a car is that of its turn (`RunMetrics`). Per tail: largest
    force of the air, and the magnitude of its impulse (the integral of the force over the run).

    Raises:
        LogError: the log is of another kind than `plant_run`, times are not sorted, a value is NaN.
    """
    if run_log.kind != PLANT_RUN:
        raise LogError(
            f"{run_log.name}: is a log of kind {run_log.kind!r}; allowed: {PLANT_RUN!r}, from "
            "observe()"
        )
    time = run_log.time
    table = run_log.table
    used = [name for name in table.columns if name.startswith("com_") or name == "tilt_truth_rad"]
    checked_signals(run_log, used)
    com = run_log.vector("com", "truth_m")
    outcome = plant_outcome(run_log)
    row: Json = {
        "outcome": None if outcome is None else outcome.result,
        "duration_s": time[-1] - time[0],
        "path_m": np.sum(np.linalg.norm(np.diff(com[:, :2], axis=0), axis=1)),
        "max_speed_m_per_s": np.max(plant_speed(run_log)),
        "max_height_m": np.max(com[:, 2]),
        "min_height_m": np.min(com[:, 2]),
    }
    if "tilt_truth_rad" in table:
        tilt = run_log.signal("tilt_truth_rad")
        yaw = np.unwrap(run_log.signal("yaw_truth_rad"))
        row |= {
            "start_tilt_rad": tilt[0],
            "max_tilt_rad": np.max(tilt),
            "end_tilt_rad": tilt[-1],
            "run_heading_change_rad": yaw[-1] - yaw[0],
        }
    for name, _ in tails_of(run_log):
        row[f"{name}_max_n"] = np.max(air_force(run_log, name))
        row[f"{name}_impulse_n_s"] = np.linalg.norm(
            trapezoid(run_log.vector(name, "truth_n"), time, axis=0)
        )
        facts = run_log.extra.get(f"{name}_sections", {})
        row |= {f"{name}_{key}": value for key, value in facts.items()}
    return {
        key: value if value is None or isinstance(value, str) else float(value)
        for key, value in row.items()
    }


def metrics_of_runs(run_logs: Sequence[RunLog]) -> list[Json]:
    """Returns a flat row of metrics per run, of the car (`RunMetrics.as_row`) or of other plants
    (`plant_metrics`).

    The row of a drive that was stopped begins with `STOP`. That of a `car_log` begins with
    `not_logged`, the columns of sensors that it lacks; their metrics are NaN. Where such a log
    ended before its turn did, or one of several logs cannot be measured, it has `not_measured`, the
    reason, in place of metrics.

    Raises:
        LogError: runs of a car and of another plant together; or, for a single log, as for
            `metrics_of` and `plant_metrics`.
    """
    if of_plants(run_logs):
        return [plant_metrics(run_log) for run_log in run_logs]
    alone = len(run_logs) == 1
    return [_car_metrics(run_log, alone) for run_log in run_logs]


def _car_metrics(run_log: RunLog, alone: bool) -> Json:
    """Returns the row of a run of the car, as `metrics_of_runs` has it."""
    row: Json = {}
    if STOP[0] in run_log.extra:
        row = {key: run_log.extra.get(key) for key in STOP}
    absent = [name for name in SENSOR_COLUMNS if name not in run_log.table]
    if absent and run_log.kind == "car_log":
        row["not_logged"] = ", ".join(absent)
        table = run_log.table.assign(**dict.fromkeys(absent, math.nan))
        run_log = replace(run_log, table=table)
    try:
        return row | metrics_of(run_log).as_row()
    except LogError as error:
        if alone and not row:
            raise
        return row | {"not_measured": str(error)}


@dataclass(frozen=True)
class RunSummary:
    """One run in numbers.

    Attributes:
        name: name of the log, without its ending.
        tail_mode: tail mode, see `tail_mode_of`.
        commanded_speed: commanded speed, m/s.
        metrics: outcome and metrics of the run.
        window: start and end of the turn, s.
        impulses: impulses of the tail about the heading axis, over the window; None without a tail
            or without its ground truth.
        trigger_time: time at which the controller began to swing, s; None if it never did.
        swing_end_time: time at which the swing was over, s; None if it did not end within the run.
        peak_gyro: largest yaw rate into the turn that the IMU reported in the window, rad/s.
    """

    name: str
    tail_mode: str
    commanded_speed: float
    metrics: RunMetrics
    window: Pair
    impulses: Impulses | None
    trigger_time: float | None
    swing_end_time: float | None
    peak_gyro: float

    @property
    def survived(self) -> bool:
        """Returns whether the car stayed on its wheels."""
        return self.metrics.outcome.result == "survived"

    def as_row(self) -> Json:
        """Returns one flat row for a table, without impulses; units are at the end of the names."""
        return {
            "tail_mode": self.tail_mode,
            "commanded_speed_m_per_s": self.commanded_speed,
            **self.metrics.as_row(),
            "swing_trigger_time_s": self.trigger_time,
            "swing_end_time_s": self.swing_end_time,
            "imu_peak_yaw_rate_rad_per_s": self.peak_gyro,
        }

    def impulses_row(self) -> dict[str, float | None]:
        """Returns the impulses of the tail about the heading axis, positive = against rolling
        outwards; None without a tail.
        """
        impulses = self.impulses
        return {
            f"{cause}_impulse_window_n_m_s": None if impulses is None else getattr(impulses, cause)
            for cause in CAUSES
        }


def tail_mode_of(scenario: Facts) -> str:
    """Returns what the tail does in a resolved scenario: `none`, `held`, `swing`, or a swing that
    is not the published one.

    Those are `optimised`, played from a file, and `designed`, the published motion of another tail
    than the built one.
    """
    tail = scenario["tail"]
    if tail["mode"] != "swing":
        return str(tail["mode"])
    if scenario.get("controller", {}).get("swing_file", NO_SWING) != NO_SWING:
        return "optimised"
    return "swing" if tail.get("name", BUILT) == BUILT else "designed"


def summarise(run_log: RunLog, name: str) -> RunSummary:
    """Measures a run of a turn; LogError as for `metrics_of`."""
    window = turn_window(run_log)
    swinging = run_log.time[run_log.signal("controller_state") == SwingState.SWING]
    side = -1.0 if run_log.scenario["manoeuvre"]["direction"] == "right" else 1.0
    trigger_time = None
    swing_end_time = None
    if swinging.size:
        trigger_time = float(swinging[0])
        if swinging[-1] < run_log.time[-1]:
            swing_end_time = float(swinging[-1])
    metrics = metrics_of(run_log)
    impulses = None
    if "tail_com_x_truth_m" in run_log.table.columns:
        impulses = tail_impulses(run_log)
    yaw_rate = side * run_log.signal("imu_gyro_z_rad_per_s")
    return RunSummary(
        name=name,
        tail_mode=tail_mode_of(run_log.scenario),
        commanded_speed=float(run_log.scenario["manoeuvre"]["speed"]),
        metrics=metrics,
        window=window,
        impulses=impulses,
        trigger_time=trigger_time,
        swing_end_time=swing_end_time,
        peak_gyro=float(np.max(yaw_rate[in_parts(run_log.time, [window])])),
    )


def published_for(summary: RunSummary) -> dict[Platform, PublishedValues]:
    """Returns the published rows with the tail mode and the speed of this run, by platform."""
    kilometres_per_hour = KM_PER_H * summary.commanded_speed
    whole = round(kilometres_per_hour)
    if not math.isclose(kilometres_per_hour, whole, abs_tol=0.02):
        return {}
    wanted = PUBLISHED_RUNS.get((summary.tail_mode, whole), ())
    rows = {(row.platform, row.configuration): row for row in published_values()}
    return {platform: rows[platform, configuration] for platform, configuration in wanted}
