"""Coefficient sets on disk: YAML or CSV files with source, range, measured and seed nodes (`models/coefficients/`)."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from aerodima.workbench.aero.coefficient_functions import (
    LEAST_DRAG,
    PolynomialSurface,
    RegularTable,
    SpeedLine,
    SpeedTable,
    fit_surface,
    require_finite,
    require_increasing,
)
from aerodima.workbench.aero.laws import NormalForceLaw, SectionLaw, TwoSidedLaw
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.errors import ModelError
from aerodima.workbench.resources import models_dir

SCHEMA = "aerodima/coefficients/1"
_COMMON = {"schema", "name", "law", "kind", "source", "range", "quasi_steady_limit_m_per_s"}
_KEYS: dict[tuple[str, str], set[str]] = {
    ("normal_force", "constant"): {"cn"},
    ("normal_force", "speed_line"): {"cn_slope_s_per_m", "cn_intercept"},
    ("normal_force", "speed_table"): {"nodes"},
    ("two_sided", "constant"): {"cn_round_side", "cn_hollow_side"},
    ("polar", "constant"): {"cd", "cl"},
    ("polar", "table"): {"nodes"},
    ("polar", "surface"): {"cd", "cl", "speed_scale_m_per_s", "angle_scale_rad"},
}
_SCALES = {"speed_scale_m_per_s", "angle_scale_rad"}
_NOT_NEGATIVE = {"cn", "cn_round_side", "cn_hollow_side", "cd"}


@dataclass(frozen=True)
class CoefficientSet:
    """A set of coefficients with its origin.

    Attributes:
        name, source: for people; the source names a table, data sheet or run.
        law_kind: `normal_force`, `two_sided` or `polar`.
        kind: `constant`, `speed_line`, `speed_table`, `table` or `surface`.
        speed_range: measured relative speeds, m/s.
        angle_range: measured |gamma|, rad; None where the law has no angle.
        quasi_steady_limit: relative speed up to which the quasi-steady model was shown to hold, m/s.
        nodes: one row per node (columns of the file, SI); empty for constants, lines and surfaces.
        content: the file as read.
        where: path of the file, for messages.
    """

    name: str
    source: str
    law_kind: str
    kind: str
    speed_range: tuple[float, float]
    angle_range: tuple[float, float] | None
    quasi_steady_limit: float
    nodes: pd.DataFrame
    content: Mapping[str, Any]
    where: str

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        """The section law of this set.

        Args:
            surface: for a table, use the polynomial surface of the highest degree that the measured nodes determine.
            seeds: for a table, use the seed nodes too; else the measured edge is held.
        """
        content = self.content
        if self.law_kind == "two_sided":
            return TwoSidedLaw(float(content["cn_hollow_side"]), float(content["cn_round_side"]))
        if self.law_kind == "normal_force":
            if self.kind == "constant":
                return NormalForceLaw(float(content["cn"]))
            if self.kind == "speed_line":
                return NormalForceLaw(SpeedLine(content["cn_slope_s_per_m"], content["cn_intercept"], self.speed_range))
            return NormalForceLaw(SpeedTable(tuple(self.nodes.speed_m_per_s), tuple(self.nodes.cn), where=self.where))
        if self.kind == "constant":
            return PolarLaw(float(content["cd"]), float(content["cl"]))
        if self.kind == "surface":
            return PolarLaw(self._surface("cd"), self._surface("cl"))
        if surface:
            return PolarLaw(self.fitted_surface("cd"), self.fitted_surface("cl"))
        return PolarLaw(self.table("cd", seeds=seeds), self.table("cl", seeds=seeds))

    def measured_nodes(self) -> pd.DataFrame:
        """The nodes that were measured, not only guessed as a start of a fit."""
        return self.nodes[self.nodes.status == "measured"]

    def fitted_surface(self, coefficient: str) -> PolynomialSurface:
        """Polynomial surface through the measured nodes of `cd` or `cl`; it holds its value beyond them."""
        nodes = self.measured_nodes()
        return fit_surface(nodes.speed_m_per_s.to_numpy(), nodes.angle_rad.to_numpy(), nodes[coefficient].to_numpy())

    def table(self, coefficient: str, *, seeds: bool = False) -> RegularTable:
        """Bilinear table of `cd` or `cl` over the grid of the measured nodes (or of all nodes with `seeds`).

        A node of that grid that was not measured takes the value of the nearest measured speed at its angle and is not
        covered.
        """
        measured = self.measured_nodes()
        kept = self.nodes if seeds else measured
        speeds, angles = sorted(set(kept.speed_m_per_s)), sorted(set(kept.angle_rad))
        known = {(v, g): c for v, g, c in zip(kept.speed_m_per_s, kept.angle_rad, kept[coefficient], strict=True)}
        flags = set(zip(measured.speed_m_per_s, measured.angle_rad, strict=True))
        values = []
        for v in speeds:
            row = []
            for g in angles:
                if (v, g) not in known and seeds:
                    raise ModelError(f"{self.where}: hole in the table: no node at {v} m/s, {g} rad")
                near = min((u for u in speeds if (u, g) in known), key=lambda u, v=v: abs(u - v))  # type: ignore[misc]
                row.append(float(known[near, g]))
            values.append(tuple(row))
        return RegularTable(
            tuple(speeds),
            tuple(angles),
            tuple(values),
            tuple(tuple((v, g) in flags for g in angles) for v in speeds),
            where=f"{self.where}: {coefficient}",
        )

    def _surface(self, coefficient: str) -> PolynomialSurface:
        content = self.content
        assert self.angle_range is not None
        rows = tuple(tuple(float(c) for c in row) for row in content[coefficient])
        return PolynomialSurface(
            rows,
            self.speed_range,
            self.angle_range,
            float(content["speed_scale_m_per_s"]),
            float(content["angle_scale_rad"]),
        )


def embedded_sets() -> list[str]:
    """Names of the sets in `models/coefficients/`."""
    return sorted(path.stem for path in (models_dir() / "coefficients").glob("*.yaml"))


def load_coefficients(name_or_path: str | Path) -> CoefficientSet:
    """Reads a set: a name from `embedded_sets()`, or a path of a YAML or CSV file.

    A CSV file is a table for the polar law with the columns speed_m_per_s, angle_rad, cd, cl and source, and optionally
    status (`measured` or `seed`; measured when absent).

    Raises:
        ModelError: no such file or set, unknown or missing keys, wrong types, NaN, holes, doubled or unsorted nodes.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml", ".csv"):
        embedded = models_dir() / "coefficients" / f"{name_or_path}.yaml"
        if not embedded.is_file():
            raise ModelError(f"coefficients: there is no set '{name_or_path}' (sets: {', '.join(embedded_sets())})")
        path = embedded
    if not path.is_file():
        raise ModelError(f"coefficients: there is no file {path}")
    if path.suffix == ".csv":
        return _from_csv(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ModelError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: cannot be read: {error}") from error
    return coefficients_from_dict(content, str(path))


def _from_csv(path: Path) -> CoefficientSet:
    try:
        nodes = pd.read_csv(path)
    except (ValueError, pd.errors.ParserError) as error:
        raise ModelError(f"{path}: not a CSV table: {error}") from error
    needed = ["speed_m_per_s", "angle_rad", "cd", "cl", "source"]
    missing = [column for column in needed if column not in nodes]
    if missing:
        raise ModelError(f"{path}: missing columns {', '.join(missing)} (a table has {', '.join(needed)})")
    for column in needed[:-1]:
        try:
            nodes[column] = nodes[column].astype(float)
        except (TypeError, ValueError) as error:
            raise ModelError(f"{path}: column {column}: {error}") from None
    if "status" not in nodes:
        nodes["status"] = "measured"
    measured = nodes[nodes.status == "measured"]
    if measured.empty:
        raise ModelError(f"{path}: no node has the status 'measured'")
    content = {
        "schema": SCHEMA,
        "name": path.stem,
        "law": "polar",
        "kind": "table",
        "source": "; ".join(sorted({str(s) for s in nodes.source})),
        "quasi_steady_limit_m_per_s": float(measured.speed_m_per_s.max()),
        "range": {
            "speed_m_per_s": [float(measured.speed_m_per_s.min()), float(measured.speed_m_per_s.max())],
            "angle_rad": [float(measured.angle_rad.min()), float(measured.angle_rad.max())],
        },
        "nodes": nodes.to_dict("records"),
    }
    return coefficients_from_dict(content, str(path))


def coefficients_from_dict(content: Any, where: str) -> CoefficientSet:
    """A set from the content of a file; `where` names it in messages. Raises ModelError, see `load_coefficients`."""
    if not isinstance(content, dict):
        raise ModelError(f"{where}: the file must hold keys and values")
    if content.get("schema") != SCHEMA:
        raise ModelError(f"{where}: schema is {content.get('schema')!r}, but this version reads {SCHEMA!r}")
    law, kind = str(content.get("law")), str(content.get("kind"))
    if (law, kind) not in _KEYS:
        allowed = ", ".join(f"{a}/{b}" for a, b in _KEYS)
        raise ModelError(f"{where}: law/kind is {law}/{kind} (allowed: {allowed})")
    _require_keys(content, _COMMON | _KEYS[law, kind], where)
    ranges = content["range"]
    _require_keys(ranges, {"speed_m_per_s"} | ({"angle_rad"} if law == "polar" else set()), f"{where}: range")
    speed_range = _range(ranges["speed_m_per_s"], f"{where}: range.speed_m_per_s")
    angle_range = _range(ranges["angle_rad"], f"{where}: range.angle_rad") if law == "polar" else None
    for key in sorted(_KEYS[law, kind] - {"nodes"}):
        if kind == "surface" and key in ("cd", "cl"):
            _require_rows(content[key], f"{where}: {key}")
        elif _require_number(content[key], f"{where}: {key}") <= 0.0 and key in _SCALES:
            raise ModelError(f"{where}: {key} is {content[key]!r}, but it must be above 0")
        elif key in _NOT_NEGATIVE and content[key] < 0.0:
            raise ModelError(f"{where}: {key} is {content[key]!r}, but a negative coefficient would add energy")
    if kind == "speed_line":
        _refuse_negative_line(content, speed_range, where)
    nodes = _nodes(content, law, where) if "nodes" in _KEYS[law, kind] else pd.DataFrame()
    _warn_of_degrees([*(angle_range or ()), *nodes.get("angle_rad", ())], where)
    limit = _require_number(content["quasi_steady_limit_m_per_s"], f"{where}: quasi_steady_limit_m_per_s")
    if not str(content["source"]).strip():
        raise ModelError(f"{where}: source is empty; name the table, data sheet or run that the numbers come from")
    return CoefficientSet(
        str(content["name"]), str(content["source"]), law, kind, speed_range, angle_range, limit, nodes, content, where
    )


def _require_keys(content: Any, wanted: set[str], where: str) -> None:
    if not isinstance(content, dict):
        raise ModelError(f"{where}: must hold the keys {', '.join(sorted(wanted))}")
    unknown, missing = set(content) - wanted, wanted - set(content)
    if unknown or missing:
        raise ModelError(
            f"{where}: unknown keys [{', '.join(sorted(map(str, unknown)))}], "
            f"missing keys [{', '.join(sorted(missing))}]"
        )


def _require_number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ModelError(f"{where} is {value!r}, but it must be a number")
    if not abs(value) <= sys.float_info.max:
        raise ModelError(f"{where} is {value!r}, but it must be finite")
    return float(value)


def _require_rows(value: Any, where: str) -> None:
    """The coefficients of a surface: rows of numbers, all of one length."""
    rows: list[Any] = value if isinstance(value, list) else []
    if not rows or not all(isinstance(row, list) and row and len(row) == len(rows[0]) for row in rows):
        raise ModelError(f"{where} is {value!r}, but it must be a list of rows of numbers, all of one length")
    for p, row in enumerate(rows):
        for q, part in enumerate(row):
            _require_number(part, f"{where}[{p}][{q}]")


def _refuse_negative_line(content: Mapping[str, Any], speed_range: tuple[float, float], where: str) -> None:
    """Checked here and not in `SpeedLine`, because a fit may pass through negative lines on its way."""
    line = SpeedLine(float(content["cn_slope_s_per_m"]), float(content["cn_intercept"]), speed_range)
    for speed in speed_range:
        if line(speed) < 0.0:
            raise ModelError(
                f"{where}: cn_slope_s_per_m and cn_intercept give {line(speed):g} at {speed:g} m/s, "
                "but a negative coefficient would add energy"
            )


def _refuse_negative(nodes: pd.DataFrame, column: str, least: float, where: str) -> None:
    for i, value in enumerate(nodes[column]):
        if value < least:
            raise ModelError(f"{where}: nodes[{i}].{column} is {value}, but a negative coefficient would add energy")


def _range(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ModelError(f"{where} is {value!r}, but it must be [lowest, highest]")
    low, high = (_require_number(part, where) for part in value)
    require_increasing("range", (low, high), where)
    return low, high


def _nodes(content: Mapping[str, Any], law: str, where: str) -> pd.DataFrame:
    """The nodes as a table, checked: no NaN, no doubles, in increasing order."""
    listed = content["nodes"]
    if not isinstance(listed, list) or not listed:
        raise ModelError(f"{where}: nodes is {listed!r}, but it must be a list of nodes with keys and values")
    for i, node in enumerate(listed):
        if not isinstance(node, dict):
            raise ModelError(f"{where}: nodes[{i}] is {node!r}, but it must hold keys and values")
    nodes = pd.DataFrame(listed)
    needed = ["speed_m_per_s", "angle_rad", "cd", "cl", "status"] if law == "polar" else ["speed_m_per_s", "cn"]
    missing = [column for column in needed if column not in nodes]
    if missing:
        raise ModelError(f"{where}: nodes lack {', '.join(missing)}")
    numbers = [column for column in needed if column != "status"]
    for column in numbers:
        try:
            nodes[column] = nodes[column].astype(float)
        except (TypeError, ValueError, OverflowError) as error:
            raise ModelError(f"{where}: nodes.{column}: {error}") from None
        require_finite(f"nodes.{column}", nodes[column].to_numpy(), where)
    _refuse_negative(nodes, "cd" if law == "polar" else "cn", LEAST_DRAG if law == "polar" else 0.0, where)
    if law != "polar":
        require_increasing("nodes.speed_m_per_s", nodes.speed_m_per_s.tolist(), where)
        return nodes
    for column in ("speed_m_per_s", "angle_rad"):
        if (nodes[column] < 0.0).any():
            raise ModelError(f"{where}: nodes.{column} must not be negative (the coefficients are even in the angle)")
    if set(map(str, nodes.status)) - {"measured", "seed"}:
        raise ModelError(
            f"{where}: nodes.status must be measured or seed, found {', '.join(sorted(set(map(str, nodes.status))))}"
        )
    _require_order(nodes, where)
    return nodes


def _require_order(nodes: pd.DataFrame, where: str) -> None:
    """Nodes ascend by angle and then by speed, and the grid of the measured nodes has no empty column."""
    keys = list(zip(nodes.angle_rad, nodes.speed_m_per_s, strict=True))
    for i, (left, right) in enumerate(pairwise(keys)):
        if right <= left:
            raise ModelError(
                f"{where}: nodes must increase by angle, then speed, but nodes[{i + 1}] (angle {right[0]}, "
                f"speed {right[1]}) follows (angle {left[0]}, speed {left[1]})"
            )
    grid = {(g, v) for g in set(nodes.angle_rad) for v in set(nodes.speed_m_per_s)}
    holes = sorted(grid - set(keys))
    if holes:
        g, v = holes[0]
        raise ModelError(
            f"{where}: hole in the table: no node at {v} m/s, {g} rad; add it with status seed or measured"
        )


def _warn_of_degrees(angles: list[float], where: str) -> None:
    largest = max(angles, default=0.0)
    if largest > math.pi:
        warnings.warn(
            f"{where}: an angle is {largest} rad, beyond pi: is the column in degrees?", UserWarning, stacklevel=3
        )
