"""Averages over several fits, and coefficient files made of many fits
(`aerodima.workbench.aero.coefficient_files`).

The weighted average is that of the thesis, eps_i = sum(res) / res_i, w_i = eps_i / sum(eps),
value = sum(w_i value_i) (thesis eqs. 4.29-4.31); robust averages stand beside it.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from aerodima.optimisation.identify.fit_result import FitResult
from aerodima.optimisation.identify.huber import LIMIT, spread
from aerodima.workbench.aero.coefficient_files import SCHEMA, coefficients_from_dict
from aerodima.workbench.aero.section_laws import CHEETAH_LIMIT, ROBOT_LIMIT
from aerodima.workbench.core.array_types import FloatArray, Pair
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import FitError
from aerodima.workbench.core.file_reading import Json

Grid = dict[Pair, list[FitResult]]
"""Tests of each node, by its speed (m/s) and angle (degrees)."""
_ANGLE_STEP = 1.0
"""Spacing of the nodes, degrees; a hold belongs to the nearest one."""


def weights(resnorms: FloatArray) -> FloatArray:
    """Compute the weights w_i of eqs. 4.29 and 4.30.

    Raises:
        FitError: a resnorm that is not above zero; its weight would be infinite.
    """
    bad = np.flatnonzero(~(np.isfinite(resnorms) & (resnorms > 0.0)))
    if bad.size:
        raise FitError(
            f"weighted average: resnorm {resnorms[bad[0]]} in row {bad[0]}, but it must be above 0"
        )
    eps = np.sum(resnorms) / resnorms
    return eps / np.sum(eps)


def averages(values: FloatArray, resnorms: FloatArray) -> dict[str, float]:
    """Compute all averages of one quantity over several fits.

    Args:
        values: values of the quantity, one per fit (n).
        resnorms: `resnorm` of each fit (n).

    Returns:
        `weighted` by resnorm (eqs. 4.29-4.31), `mean`, `median`, `huber` (see `huber_location`),
        percentiles `p10` and `p90`, number of `samples`.
    """
    if not (len(values) and np.all(np.isfinite(values))):
        raise FitError("weighted average: there are no values, or one is not finite")
    low, high = np.percentile(values, (10.0, 90.0))
    return {
        "weighted": float(weights(resnorms) @ values),
        "mean": float(np.mean(values)),
        "median": float(np.median(values)),
        "huber": huber_location(values),
        "p10": float(low),
        "p90": float(high),
        "samples": len(values),
    }


def averages_table(results: Sequence[FitResult], keys: Sequence[str] = ()) -> pd.DataFrame:
    """Tabulate all averages of every determined parameter over several fits, but for the start of a
    swing.

    Args:
        results: results of the fits.
        keys: facts that tell the groups apart, such as tail and wind speed.

    Returns:
        A row per group and parameter: the keys, parameter, unit, and its `averages`.
    """
    groups: dict[tuple[Any, ...], list[Pair]] = {}
    for result in sorted(results, key=lambda result: [result.facts[key] for key in keys]):
        facts = [result.facts[key] for key in keys]
        for e in result.free:
            if e.name.startswith("start_"):
                continue
            pairs = groups.setdefault((*facts, e.name, e.unit), [])
            if e.identifiable:
                pairs.append((e.value, result.resnorm))
    heads = [*keys, "parameter", "unit"]
    rows = []
    for place, pairs in groups.items():
        if pairs:
            rows.append(dict(zip(heads, place, strict=True)) | averages(*np.array(pairs).T))
    return pd.DataFrame(rows)


def huber_location(values: FloatArray) -> float:
    """Find the value with the least Huber loss; its scale is 1.4826 times the median deviation
    from the median.

    It is the zero of a sum that falls with the location, so it is found however close together the
    values lie.
    """
    scale = spread(values)
    if scale == 0.0:
        return float(np.median(values))
    from scipy.optimize import brentq

    def pull(x: float) -> float:
        return float(np.sum(np.clip((values - x) / scale, -LIMIT, LIMIT)))

    return float(brentq(pull, np.min(values), np.max(values), xtol=1e-9 * scale))


def node_angle(result: FitResult) -> float:
    """Return the angle of the node that a hold belongs to, degrees."""
    return _ANGLE_STEP * abs(round(float(result.facts["angle_deg"]) / _ANGLE_STEP))


def static_sets(results: Sequence[FitResult]) -> tuple[dict[str, Json], list[str]]:
    """Make the content of a coefficient file per tail and axis, from what static fits determined.

    A node is the resnorm-weighted average (eqs. 4.29-4.31) of its tests, with mean, median, Huber
    location and percentiles beside it. Sets that do not span two angles and two speeds make no
    table.

    Returns:
        Contents by name of the file, and a line for each file that is left out because its grid has
        holes.
    """
    grids: dict[tuple[str, str], Grid] = defaultdict(lambda: defaultdict(list))
    for result in results:
        if result["cd"].identifiable and result["cl"].identifiable:
            facts = result.facts
            node = (float(facts["wind_speed_m_per_s"]), node_angle(result))
            grids[facts["tail"], facts["axis"]][node].append(result)
    sets = {}
    left_out = []
    for (tail, axis), grid in grids.items():
        name = f"cheetah_tail_{tail}_{axis}"
        speeds = sorted({speed for speed, _ in grid})
        angles = sorted({angle for _, angle in grid})
        if len(speeds) < 2 or len(angles) < 2:
            continue
        places = [(speed, angle) for angle in angles for speed in speeds]
        holes = [place for place in places if place not in grid]
        if holes:
            speed, angle = holes[0]
            more = f" and {len(holes) - 1} more" if len(holes) > 1 else ""
            left_out.append(
                f"{name}.yaml is left out: its grid of speed and angle lacks {speed:g} m/s at "
                f"{angle:g} degrees{more}"
            )
            continue
        nodes = [_static_node(*place, grid[place]) for place in places]
        sets[name] = {
            "schema": SCHEMA,
            "law": "polar",
            "quasi_steady_limit_m_per_s": CHEETAH_LIMIT,
            "name": f"cheetah tail {tail}, {axis} axis",
            "source": f"aerodima fit static over {sum(map(len, grid.values()))} holds",
            "kind": "table",
            **_nodes_and_range(nodes, "speed_m_per_s", "angle_rad"),
        }
    return sets, left_out


def _nodes_and_range(nodes: list[Json], *axes: str) -> Json:
    """Make the entries of the nodes, which are in rising order, and of the range they span."""
    first = nodes[0]
    last = nodes[-1]
    return {"range": {axis: [first[axis], last[axis]] for axis in axes}, "nodes": nodes}


def _static_node(speed: float, angle: float, group: list[FitResult]) -> Json:
    node: Json = {
        "speed_m_per_s": speed,
        "angle_rad": round(math.radians(angle), 9),
        "status": "measured",
    }
    for name in ("cd", "cl"):
        node |= _average(name, [(result[name].value, result.resnorm) for result in group])
    return {**node, "samples": len(group), "source": "static fits"}


def _average(name: str, pairs: Sequence[Pair]) -> dict[str, float]:
    """Average values with resnorms; the weighted average stands under the name itself."""
    numbers = averages(*np.array(pairs).T)
    del numbers["samples"]
    rounded = {f"{name}_{key}": round(value, 5) for key, value in numbers.items()}
    return {name: rounded.pop(f"{name}_weighted"), **rounded}


def robot_tail_set(results: Sequence[FitResult]) -> Json | None:
    """Make a speed table of C_N from fits in bins; None with fewer than two bins."""
    bins: dict[float, list[Pair]] = defaultdict(list)
    for result in results:
        for estimate in result.free:
            name = estimate.name
            if name.startswith("cn_at_") and estimate.identifiable:
                speed = float(name.removeprefix("cn_at_"))
                bins[speed].append((estimate.value, result.resnorm))
    if len(bins) < 2:
        return None
    nodes = [
        {"speed_m_per_s": speed, **_average("cn", pairs), "samples": len(pairs)}
        for speed, pairs in sorted(bins.items())
    ]
    return {
        "schema": SCHEMA,
        "law": "normal_force",
        "quasi_steady_limit_m_per_s": ROBOT_LIMIT,
        "name": "robot tail, bins over the relative speed",
        "source": f"aerodima fit robot-tail over {len(results)} swings",
        "kind": "speed_table",
        **_nodes_and_range(nodes, "speed_m_per_s"),
    }


def write_sets(folder: Path, sets: dict[str, Json]) -> list[Path]:
    """Write coefficient files, each after reading its text back, so that none is left that the
    aerodynamics refuse.
    """
    paths = []
    for stem, content in sets.items():
        path = folder / f"{stem}.yaml"
        text = yaml.safe_dump(content, sort_keys=False, width=200)
        coefficients_from_dict(yaml.safe_load(text), str(path))
        paths.append(write_atomically(path, text, True, FitError))
    return paths
