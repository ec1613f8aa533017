"""Coefficient files from fits, in the format that the aerodynamics read (`workbench.aero.coefficient_files`)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from optimisation.identify.aggregate import aggregate
from optimisation.pipeline import FitResult
from workbench.aero.coefficient_files import load_coefficients
from workbench.aero.published_coefficients import CHEETAH_LIMIT, ROBOT_LIMIT, SCHEMA

_ANGLE_STEP = 1.0
"""Holds within half of this (degrees) of each other are one node."""


def static_sets(results: Sequence[FitResult]) -> dict[str, dict[str, Any]]:
    """Per tail and axis the content of a coefficient file, from what static fits determined.

    A node is the resnorm-weighted average (eqs. 4.29-4.31) of its tests, with 10th and 90th percentile. Sets that do
    not span two angles and two speeds make no table and are left out.
    """
    cells: dict[tuple[str, str], dict[tuple[float, float], list[FitResult]]] = defaultdict(lambda: defaultdict(list))
    for result in results:
        if result["cd"].identifiable and result["cl"].identifiable:
            facts = result.facts
            angle = _ANGLE_STEP * round(float(facts["angle_deg"]) / _ANGLE_STEP)
            cells[facts["tail"], facts["axis"]][float(facts["wind_speed_m_per_s"]), abs(angle)].append(result)
    found = {}
    for (tail, axis), nodes in cells.items():
        speeds, angles = sorted({speed for speed, _ in nodes}), sorted({angle for _, angle in nodes})
        if len(speeds) < 2 or len(angles) < 2:
            continue
        found[f"cheetah_tail_{tail}_{axis}"] = {
            "schema": SCHEMA,
            "law": "polar",
            "quasi_steady_limit_m_per_s": CHEETAH_LIMIT,
            "name": f"cheetah tail {tail}, {axis} axis",
            "source": f"aerodima fit static over {sum(len(group) for group in nodes.values())} holds",
            "kind": "table",
            "range": {
                "speed_m_per_s": [speeds[0], speeds[-1]],
                "angle_rad": [round(math.radians(angle), 9) for angle in (angles[0], angles[-1])],
            },
            "nodes": [
                _static_node(speed, angle, nodes[speed, angle])
                for speed, angle in sorted(nodes, key=lambda place: (place[1], place[0]))
            ],
        }
    return found


def _static_node(speed: float, angle: float, group: list[FitResult]) -> dict[str, Any]:
    node: dict[str, Any] = {"speed_m_per_s": speed, "angle_rad": round(math.radians(angle), 9), "status": "measured"}
    for name in ("cd", "cl"):
        node |= _average(name, [result[name].value for result in group], [result.cost for result in group])
    return {**node, "samples": len(group), "source": "static fits"}


def _average(name: str, values: list[float], costs: list[float]) -> dict[str, float]:
    both = aggregate(np.array(values), 2.0 * np.maximum(costs, 1e-12))
    numbers = {name: both.weighted, f"{name}_p10": both.low, f"{name}_p90": both.high}
    return {key: round(value, 5) for key, value in numbers.items()}


def robot_tail_set(results: Sequence[FitResult]) -> dict[str, Any] | None:
    """A speed table of C_N from fits in bins; None with fewer than two bins."""
    bins: dict[float, list[tuple[float, float]]] = defaultdict(list)
    for result in results:
        for estimate in result.free:
            if estimate.name.startswith("cn_at_") and estimate.identifiable:
                bins[float(estimate.name.removeprefix("cn_at_"))].append((estimate.value, result.cost))
    if len(bins) < 2:
        return None
    nodes = [
        {
            "speed_m_per_s": speed,
            **_average("cn", [value for value, _ in pairs], [cost for _, cost in pairs]),
            "samples": len(pairs),
        }
        for speed, pairs in sorted(bins.items())
    ]
    return {
        "schema": SCHEMA,
        "law": "normal_force",
        "quasi_steady_limit_m_per_s": ROBOT_LIMIT,
        "name": "robot tail, bins over the relative speed",
        "source": f"aerodima fit robot-tail over {len(results)} swings",
        "kind": "speed_table",
        "range": {"speed_m_per_s": [nodes[0]["speed_m_per_s"], nodes[-1]["speed_m_per_s"]]},
        "nodes": nodes,
    }


def write_sets(folder: Path, sets: dict[str, dict[str, Any]]) -> list[Path]:
    """Writes coefficient files and reads each back, so that none is left that the aerodynamics refuse."""
    paths = []
    for stem, content in sets.items():
        paths.append(folder / f"{stem}.yaml")
        paths[-1].write_text(yaml.safe_dump(content, sort_keys=False, width=200), encoding="utf-8")
        load_coefficients(paths[-1])
    return paths
