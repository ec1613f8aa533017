"""What a run of any plant comes to: motion of its base and its centre of mass, the air on its tails, its outcome.

The eight metrics of the thesis and all else about a turn need a car: `metrics_of`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import PLANT_RUN, RunLog
from aerodima.workbench.logs.signals import check_signals, check_time
from aerodima.workbench.metrics.tail_impulses import FLIP_TILT
from aerodima.workbench.metrics.turn_metrics import Outcome, outcome_from

TAILS = "tails"
"""Key in `extra` of a `plant_run`: name and body of each tail force."""


def tails_of(run_log: RunLog) -> list[tuple[str, str]]:
    """Name and body of each tail force of a `plant_run`; the name begins its columns."""
    return [(str(tail["name"]), str(tail["body"])) for tail in run_log.extra.get(TAILS, [])]


def air_force(run_log: RunLog, name: str) -> FloatArray:
    """Magnitude of the force of the air on a tail, N, shape (n,)."""
    return np.asarray(np.linalg.norm(run_log.vector(name, "truth_n"), axis=1))


def plant_speed(run_log: RunLog) -> FloatArray:
    """Speed of the centre of mass, m/s, shape (n,)."""
    return np.asarray(np.linalg.norm(run_log.vector("com_velocity", "truth_m_per_s"), axis=1))


def plant_tilt(run_log: RunLog) -> FloatArray | None:
    """Angle of the base's z axis from the world's, degrees, shape (n,); None without a base."""
    return np.degrees(run_log.signal("tilt_truth_rad")) if "tilt_truth_rad" in run_log.table else None


def plant_air(run_log: RunLog) -> FloatArray | None:
    """Forces of the air on all tails, the sum of their magnitudes, N, shape (n,); None without a tail."""
    forces = [air_force(run_log, name) for name, _ in tails_of(run_log)]
    return np.asarray(np.sum(forces, axis=0)) if forces else None


def of_plants(run_logs: Sequence[RunLog]) -> bool:
    """Whether these are runs of plants that `observe` logged; LogError when some are and some are not."""
    plants = [run_log.kind == PLANT_RUN for run_log in run_logs]
    if any(plants) and not all(plants):
        car, plant = run_logs[plants.index(False)].name, run_logs[plants.index(True)].name
        raise LogError(f"{plant} is a run of another plant than the car, {car} is not; name logs of one kind")
    return any(plants)


def plant_outcome(run_log: RunLog) -> Outcome | None:
    """Whether the base stayed upright, as for a car without wheel loads; None without a base that starts upright."""
    if "tilt_truth_rad" not in run_log.table:
        return None
    tilt = run_log.signal("tilt_truth_rad")
    return outcome_from(run_log.time, tilt) if tilt[0] <= FLIP_TILT else None


def plant_metrics(run_log: RunLog) -> dict[str, float | str | None]:
    """One flat row for a table; units are at the end of the names.

    `outcome`: see `plant_outcome`, None where it is not defined. Tilt and heading are those of the base, speed, height
    and path those of the centre of mass. Per tail: largest force of the air, and the magnitude of its impulse (the
    integral of the force over the run).

    Raises:
        LogError: the log is of another kind than `plant_run`, times are not sorted, a value is NaN.
    """
    if run_log.kind != PLANT_RUN:
        raise LogError(f"{run_log.name}: is a log of kind {run_log.kind!r}; allowed: {PLANT_RUN!r}, from observe()")
    time, table = run_log.time, run_log.table
    check_time(time)
    used = [name for name in table.columns if name.startswith("com_") or name == "tilt_truth_rad"]
    check_signals(time, {name: run_log.signal(name) for name in used})
    com, velocity = run_log.vector("com", "truth_m"), run_log.vector("com_velocity", "truth_m_per_s")
    outcome = plant_outcome(run_log)
    row: dict[str, Any] = {
        "outcome": None if outcome is None else outcome.result,
        "duration_s": float(time[-1] - time[0]),
        "path_m": float(np.sum(np.linalg.norm(np.diff(com[:, :2], axis=0), axis=1))),
        "max_speed_m_per_s": float(np.max(np.linalg.norm(velocity, axis=1))),
        "max_height_m": float(np.max(com[:, 2])),
        "min_height_m": float(np.min(com[:, 2])),
    }
    if "tilt_truth_rad" in table:
        tilt, yaw = run_log.signal("tilt_truth_rad"), np.unwrap(run_log.signal("yaw_truth_rad"))
        row |= {"start_tilt_rad": tilt[0], "max_tilt_rad": np.max(tilt), "end_tilt_rad": tilt[-1]}
        row["heading_change_rad"] = yaw[-1] - yaw[0]
    for name, _ in tails_of(run_log):
        row[f"{name}_max_n"] = np.max(air_force(run_log, name))
        row[f"{name}_impulse_n_s"] = np.linalg.norm(trapezoid(run_log.vector(name, "truth_n"), time, axis=0))
        facts = run_log.extra.get(f"{name}_sections", {})
        row |= {f"{name}_{key}": value for key, value in facts.items()}
    return {key: value if value is None or isinstance(value, str) else float(value) for key, value in row.items()}
