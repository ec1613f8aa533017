"""One run of a sweep: what is to be simulated, and the flat row that it comes to."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.metrics.run_summary import RunSummary

WORKER_LOST = "its worker process was lost"
"""Begins the error of a run whose worker died under it again and again."""

DRIVING = 0.9
"""Share of the commanded speed that a car must have reached when its turn begins."""

CAUSES = ("aerodynamic", "weight", "inertial")


@dataclass(frozen=True)
class RunTask:
    """One run, small enough to send anywhere; files that it names must be there where it runs.

    Attributes:
        name: of the run within its study.
        scenario: name or path, as for `load_scenario`.
        settings: overrides, such as `car.tyre_friction=0.7`.
        signals: `all` also gives the impulses of the tail, at twice the price.
    """

    name: str
    scenario: str
    settings: tuple[str, ...] = ()
    signals: Literal["all", "outcome"] = "outcome"


def evaluate(task: RunTask) -> dict[str, Any]:
    """Runs a task; one row of outcome, metrics and provenance, without anything that differs from time to time.

    A run that cannot be made (impossible scenario, plant that does not load, solver that gives up, NaN) gives a row
    without outcome, with one line in `error`. Units are at the end of the names.
    """
    try:
        scenario = load_scenario(task.scenario, list(task.settings))
    except UserError as error:
        return failed_row(task, str(error))
    try:
        return _measured(task, scenario)
    except (UserError, ArithmeticError, RuntimeError, ValueError) as error:
        return failed_row(task, " ".join(str(error).split()) or type(error).__name__, scenario)


def tipped_before_turn(row: Mapping[Any, Any]) -> bool:
    """Whether a run flipped before its turn, so that it says nothing about the turn.

    A high car with its tail behind may tip over backwards while it gathers speed; it is slow, or lies, when the turn
    begins.
    """
    speed, commanded = row.get("speed_m_per_s"), row.get("commanded_speed_m_per_s")
    if row["outcome"] != "flipped" or speed is None or commanded is None:
        return False
    return float(speed) < DRIVING * float(commanded)


def failed_row(task: RunTask, error: str, scenario: Scenario | None = None) -> dict[str, Any]:
    """Row of a run that came to nothing; the columns of the metrics are missing in it."""
    return {"run": task.name, "outcome": None, "error": error, **_provenance(task, scenario)}


def _measured(task: RunTask, scenario: Scenario) -> dict[str, Any]:
    from aerodima.workbench.metrics.run_summary import summarise
    from aerodima.workbench.simulate.simulation import simulate
    from aerodima.workbench.stations.outcome_record import STOPPED

    run = simulate(scenario, record=task.signals, stop_when_flipped=True)
    summary = summarise(run, scenario.name)
    row = {"run": task.name, **_numbers(summary), "stopped_at_flip_s": run.extra.get(STOPPED)}
    if task.signals == "all":
        row |= _impulses(summary)
        if run.has_tail:
            from aerodima.workbench.metrics.tail_impulses import tail_yaw_impulses

            yaw = tail_yaw_impulses(run)
            row |= {f"{cause}_yaw_impulse_window_n_m_s": getattr(yaw, cause) for cause in CAUSES}
    return row | {"error": "", **_provenance(task, scenario)}


def _numbers(summary: RunSummary) -> dict[str, Any]:
    return {
        "tail_mode": summary.tail_mode,
        "commanded_speed_m_per_s": summary.commanded_speed,
        **summary.metrics.as_row(),
        "swing_trigger_time_s": summary.trigger_time,
        "swing_end_time_s": summary.swing_end_time,
        "imu_peak_yaw_rate_rad_per_s": summary.peak_gyro,
    }


def _impulses(summary: RunSummary) -> dict[str, Any]:
    """About the heading axis, positive = against rolling outwards."""
    found = {"window": summary.over_window, "until_peak_roll": summary.until_peak_roll}
    return {
        f"{cause}_impulse_{label}_n_m_s": None if impulses is None else getattr(impulses, cause)
        for label, impulses in found.items()
        for cause in CAUSES
    }


def _provenance(task: RunTask, scenario: Scenario | None) -> dict[str, Any]:
    resolved = None if scenario is None else json.dumps(scenario.resolved(), sort_keys=True)
    return {
        "scenario": task.scenario,
        "settings": " ".join(task.settings),
        "seed": None if scenario is None else scenario.seed,
        "scenario_sha256": None if resolved is None else hashlib.sha256(resolved.encode()).hexdigest(),
        **{f"version_{name}": version for name, version in sorted(software_versions().items())},
    }
