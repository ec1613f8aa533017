"""Derives the embedded coefficient sets from the published tables; `models/coefficients/` holds what it writes.

Weights follow thesis eqs. 4.29-4.31: w_i proportional to 1 / resnorm_i.
`python -m aerodima.workbench.aero.published_coefficients` writes the files again; a test keeps files and tables equal.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from aerodima.workbench.aero.laws import ROBOT_LIMIT
from aerodima.workbench.resources import models_dir, published_table

SCHEMA = "aerodima/coefficients/1"
CHEETAH_LIMIT = 10.0
"""Relative speed up to which the quasi-steady model was shown to hold for the cheetah tails, m/s (section 4.9)."""
CHEETAH_SOURCE = (
    "thesis Tables 4.11, 10.6-10.18, resnorm-weighted without bold outliers and copied rows (ERRATA E1, E4); "
    "area = length x major width for both axes (ERRATA E2); seeds from Tables 4.9, 4.10, 10.1-10.5"
)
_BAND = (10.0, 90.0)
_SPEEDS = (10.0, 20.0, 30.0)
_ANGLES_DEG = (0, 15, 30, 45, 60, 75)


def weighted(values: np.ndarray, resnorms: np.ndarray) -> float:
    """Resnorm-weighted average (thesis eqs. 4.29-4.31)."""
    weights = 1.0 / resnorms
    return float(np.sum(weights * values) / np.sum(weights))


def _rounded(value: float, digits: int = 4) -> float:
    return round(float(value), digits)


def robot_tail_rows() -> pd.DataFrame:
    """The 160 distinct coefficients of the robot tail: Table 11.3 repeats 11.6 and is left out (ERRATA E24)."""
    rows = published_table("robot_tail_drag")
    return rows[rows.source_table != "Table 11.3"]


def robot_tail_sets() -> dict[str, dict[str, Any]]:
    """The three published models of the robot tail, as file contents by file stem."""
    rows = robot_tail_rows()
    line = np.polyfit(rows.relative_velocity_m_per_s, rows.cd, 1)
    nodes = []
    for speed, group in rows.groupby("relative_velocity_m_per_s"):
        low, high = np.percentile(group.cd, _BAND)
        nodes.append(
            {
                "speed_m_per_s": float(str(speed)),
                "cn": _rounded(weighted(group.cd.to_numpy(), group.resnorm.to_numpy())),
                "cn_p10": _rounded(low),
                "cn_p90": _rounded(high),
                "samples": len(group),
            }
        )
    speeds = [nodes[0]["speed_m_per_s"], nodes[-1]["speed_m_per_s"]]
    common = {"schema": SCHEMA, "law": "normal_force", "quasi_steady_limit_m_per_s": ROBOT_LIMIT}
    source = "thesis Tables 6.3, 11.4-11.7 (Table 11.3 left out, ERRATA E24)"
    return {
        "robot_tail_constant": {
            **common,
            "name": "robot tail, constant 2",
            "source": "thesis section 6.3.3, eq. 6.8 (checked in ERRATA E26)",
            "kind": "constant",
            "range": {"speed_m_per_s": speeds},
            "cn": 2.0,
        },
        "robot_tail_line": {
            **common,
            "name": "robot tail, line over the relative speed",
            "source": f"least squares over the 160 values of {source}; ERRATA E26",
            "kind": "speed_line",
            "range": {"speed_m_per_s": speeds},
            "cn_slope_s_per_m": _rounded(line[0], 6),
            "cn_intercept": _rounded(line[1], 6),
        },
        "robot_tail_weighted_average": {
            **common,
            "name": "robot tail, weighted average per relative speed",
            "source": f"resnorm-weighted (eqs. 4.29-4.31) over {source}; band: percentiles 10 and 90 of the fits",
            "kind": "speed_table",
            "range": {"speed_m_per_s": speeds},
            "nodes": nodes,
        },
    }


def cheetah_nodes(tail: int, axis: str) -> list[dict[str, Any]]:
    """The 18 nodes of one cheetah tail: measured ones from the static fits, the others seeds (ERRATA E1, E3, E4, F).

    Args:
        tail: 1, 2 or 3.
        axis: `major` or `minor`.
    """
    fits = published_table("static_fits")
    fits = fits[(fits["tail"] == tail) & (fits.axis == axis)]
    fits = fits[fits.derived_repeats_wind_speed_m_per_s.isna() & ~fits.published_bold_outlier.eq(True)]
    seeds = published_table("static_seeds")
    seeds = seeds[seeds["tail"] == tail]
    nodes = []
    for angle in _ANGLES_DEG:
        for speed in _SPEEDS:
            group = fits[(fits.angle_of_attack_deg == angle) & (fits.wind_speed_m_per_s == speed)]
            place = {"speed_m_per_s": speed, "angle_rad": round(math.radians(angle), 9)}
            if len(group):
                nodes.append(
                    {**place, "status": "measured", **_measured(group), "source": str(group.source_table.iloc[0])}
                )
            else:
                nodes.append({**place, "status": "seed", **_seed(seeds, angle, speed)})
    return nodes


def _measured(group: pd.DataFrame) -> dict[str, Any]:
    values: dict[str, Any] = {}
    resnorms = group.resnorm.to_numpy()
    for name in ("cd", "cl"):
        column = group[name].to_numpy()
        low, high = np.percentile(column, _BAND)
        values |= {
            name: _rounded(weighted(column, resnorms)),
            f"{name}_p10": _rounded(low),
            f"{name}_p90": _rounded(high),
        }
    return {**values, "samples": len(group)}


def _seed(seeds: pd.DataFrame, angle: float, speed: float) -> dict[str, Any]:
    rows = seeds[(seeds.angle_of_attack_deg == angle) & (seeds.wind_speed_m_per_s == speed)].set_index("variable")
    return {
        "cd": float(rows.x0["cd"]),
        "cl": float(rows.x0["cl"]),
        "samples": 0,
        "source": str(rows.source_table["cd"]),
    }


def cheetah_sets() -> dict[str, dict[str, Any]]:
    """The six cheetah sets, as file contents by file stem."""
    sets = {}
    for tail in (1, 2, 3):
        for axis in ("major", "minor"):
            nodes = cheetah_nodes(tail, axis)
            measured = [node for node in nodes if node["status"] == "measured"]
            sets[f"cheetah_tail_{tail}_{axis}"] = {
                "schema": SCHEMA,
                "law": "polar",
                "quasi_steady_limit_m_per_s": CHEETAH_LIMIT,
                "name": f"cheetah tail {tail}, {axis} axis",
                "source": CHEETAH_SOURCE,
                "kind": "table",
                "range": {
                    "speed_m_per_s": [
                        min(n["speed_m_per_s"] for n in measured),
                        max(n["speed_m_per_s"] for n in measured),
                    ],
                    "angle_rad": [min(n["angle_rad"] for n in measured), max(n["angle_rad"] for n in measured)],
                },
                "nodes": nodes,
            }
    return sets


def shape_sets() -> dict[str, dict[str, Any]]:
    """Flat plate and half cylinder of Table 2.1: its rows carry no shape names, so they are matched by value."""
    return {
        "flat_plate": {
            "schema": SCHEMA,
            "law": "normal_force",
            "quasi_steady_limit_m_per_s": ROBOT_LIMIT,
            "name": "flat plate",
            "source": "thesis Table 2.1, 2D row 7: 1.98 is the value that the drag literature gives for a plate across"
            " the flow; the table's shape names are images (assumed match)",
            "kind": "constant",
            "range": {"speed_m_per_s": [0.0, ROBOT_LIMIT]},
            "cn": 1.98,
        },
        "half_cylinder": {
            "schema": SCHEMA,
            "law": "two_sided",
            "quasi_steady_limit_m_per_s": ROBOT_LIMIT,
            "name": "half cylinder, by side",
            "source": "thesis Table 2.1, 2D rows 2 and 9: 1.20 and 2.30 are the values that the drag literature"
            " gives for a half tube with its round and its hollow side to the flow; the table's shape names are images"
            " (assumed match)",
            "kind": "constant",
            "range": {"speed_m_per_s": [0.0, ROBOT_LIMIT]},
            "cn_round_side": 1.20,
            "cn_hollow_side": 2.30,
        },
    }


class _Dumper(yaml.SafeDumper):
    """YAML with one node per line."""


def _represent_list(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.Node:
    return dumper.represent_sequence(
        "tag:yaml.org,2002:seq", data, flow_style=not any(isinstance(x, dict) for x in data)
    )


def _represent_node(dumper: yaml.SafeDumper, data: dict[str, Any]) -> yaml.Node:
    return dumper.represent_mapping("tag:yaml.org,2002:map", data.items(), flow_style="samples" in data)


_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(dict, _represent_node)


def write_sets(folder: Path) -> list[Path]:
    """Writes all embedded sets; returns the paths."""
    paths = []
    folder.mkdir(parents=True, exist_ok=True)
    for stem, content in {**robot_tail_sets(), **cheetah_sets(), **shape_sets()}.items():
        path = folder / f"{stem}.yaml"
        path.write_text(yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=10_000))
        paths.append(path)
    return paths


if __name__ == "__main__":
    for written in write_sets(models_dir() / "coefficients"):
        print(written)
