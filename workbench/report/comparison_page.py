"""Runs beside one another as one page: what was set differently, the metrics, the signals, the replays in step."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from aerodima.workbench.errors import LogError
from aerodima.workbench.figures.overlay_figures import RUN_STYLES, plot_overlay
from aerodima.workbench.logs.schema import TAIL_LAW, RunLog
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.replay.reckoned_motion import replayable
from aerodima.workbench.report.replay_page import replay_page
from aerodima.workbench.report.report_page import Finding, Page, Part, Plot, Section, Table, Templated
from aerodima.workbench.text_table import shown_value

MOST_RUNS = len(RUN_STYLES)
_CAR_SECTIONS = ("car", "tail", "friction", "tail_motor", "servo", "drive")
"""Sections of a scenario that say which car it is; a difference in one of them is named first."""


def metrics_rows(run_logs: Sequence[RunLog]) -> dict[str, list[Any]]:
    """Metric with its unit -> value per run (None where a run has none).

    Raises:
        LogError: a log ends before its turn does, or has no sensor columns.
    """
    rows = [metrics_of(run_log).as_row() for run_log in run_logs]
    return {name: [row[name] for row in rows] for name in rows[0] if not name.startswith("filtered_")}


def scenario_differences(run_logs: Sequence[RunLog]) -> dict[str, list[Any]]:
    """Key of the scenario -> value per run, for what was not the same in all; the car's own keys first.

    A tail law of one's own stands beside them as `tail_law`, by its name.
    """
    flat = [_flat(run_log.scenario) | {TAIL_LAW: run_log.extra.get(TAIL_LAW)} for run_log in run_logs]
    keys = {key for scenario in flat for key in scenario}
    differing = [key for key in keys if len({json.dumps(scenario.get(key)) for scenario in flat}) > 1]
    differing.sort(key=lambda key: (key.split(".")[0] not in _CAR_SECTIONS, key))
    return {key: [scenario.get(key) for scenario in flat] for key in differing}


def _flat(scenario: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in scenario.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


def different_cars(differences: Mapping[str, Sequence[Any]]) -> list[str]:
    """Those keys that make another car of it; how a car's tail is used (`tail.mode`) does not."""
    return [key for key in differences if key.split(".")[0] in _CAR_SECTIONS and key != "tail.mode"]


def comparison_page(run_logs: Sequence[RunLog], names: Sequence[str]) -> Page:
    """The page; it needs no other file.

    Args:
        run_logs: 2 to `MOST_RUNS` runs with a turn.
        names: of the runs, all different.

    Raises:
        LogError: wrong number of runs, or one of them has no turn or cannot be replayed.
    """
    if not 2 <= len(run_logs) <= MOST_RUNS:
        raise LogError(f"{len(run_logs)} run(s) to compare; allowed: 2 to {MOST_RUNS}")
    differences = scenario_differences(run_logs)
    metrics = [[name, *map(shown_value, values)] for name, values in metrics_rows(run_logs).items()]
    signals = Plot(
        plot_overlay(run_logs, names),
        "IMU signals after the car's zero-phase filter; roll and torque as logged.",
        "Yaw rate, lateral acceleration, speed, roll, tail angle and tail torque of the runs over time",
    )
    replays = [(name, replay_page(replayable(run_log))) for name, run_log in zip(names, run_logs, strict=True)]
    sections = (
        Section("What was set differently", _settings(differences, names)),
        Section(
            "Metrics",
            [
                "Raw metrics of each run; units are at the end of the names. The turn is positive.",
                Table(["metric", *names], metrics),
            ],
        ),
        Section("Signals", [signals]),
        Section("Replays in step", [Templated("replays.html", {"replays": replays})]),
    )
    return Page("Comparison of runs: " + ", ".join(names), "", sections)


def _settings(differences: Mapping[str, Sequence[Any]], names: Sequence[str]) -> list[Part]:
    if not differences:
        return ["Nothing: the scenarios are equal, the seed included."]
    rows = Table(["key", *names], [[key, *map(shown_value, values)] for key, values in differences.items()])
    other = different_cars(differences)
    if not other:
        return [rows]
    warning = f"These are different cars: {', '.join(other)}. What differs between the runs may come from that alone."
    return [Finding([warning]), rows]
