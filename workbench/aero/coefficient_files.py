"""Coefficient sets on disk: YAML or CSV files with source, range, measured and seed nodes (`models/coefficients/`)."""

import math
import warnings
from abc import ABC, abstractmethod
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, PrivateAttr, Strict, model_validator

from aerodima.workbench.aero.coefficient_functions import (
    LEAST_DRAG,
    PolynomialSurface,
    RegularTable,
    SpeedLine,
    SpeedTable,
    fit_surface,
    require_increasing,
)
from aerodima.workbench.aero.laws import NormalForceLaw, SectionLaw, TwoSidedLaw
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.config.checked_files import (
    StrictModel,
    checked,
    find_file,
    read_yaml,
    require_mapping,
    shipped_names,
)
from aerodima.workbench.errors import ModelError

SCHEMA = "aerodima/coefficients/1"
_FOLDER = "coefficients"


def _refuse_gain(value: float, least: float) -> float:
    if value < least:
        raise ValueError(f"{value}; allowed: >= {least:g}, a negative coefficient would add energy")
    return value


def _increasing(ends: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= ends[0] < ends[1]:
        raise ValueError(f"{list(ends)}; allowed: [lowest, highest], from 0 and increasing")
    return ends


def _equally_long(rows: Any) -> Any:
    if not (
        rows and isinstance(rows, list) and all(isinstance(r, list) and r and len(r) == len(rows[0]) for r in rows)
    ):
        raise ValueError(f"{rows!r}; allowed: a list of rows of numbers, all of one length")
    return rows


Number = Annotated[float, Strict()]
Drag = Annotated[Number, AfterValidator(partial(_refuse_gain, least=0.0))]
Span = Annotated[tuple[Number, Number], AfterValidator(_increasing)]
Rows = Annotated[tuple[tuple[Number, ...], ...], BeforeValidator(_equally_long)]


class SpeedRange(StrictModel):
    """Measured relative speeds, m/s."""

    speed_m_per_s: Span


class PolarRange(SpeedRange):
    """Measured relative speeds, and angles |gamma| in rad."""

    angle_rad: Span


class SpeedNode(StrictModel):
    """A node over the speed; what else a file says of it is kept."""

    model_config = ConfigDict(extra="allow")

    speed_m_per_s: Number
    cn: Drag


class PolarNode(StrictModel):
    """A node over speed and |gamma|, measured or only guessed as a start of a fit; even in the angle."""

    model_config = ConfigDict(extra="allow")

    speed_m_per_s: Annotated[Number, Field(ge=0)]
    angle_rad: Annotated[Number, Field(ge=0)]
    cd: Annotated[Number, AfterValidator(partial(_refuse_gain, least=LEAST_DRAG))]
    cl: Number
    status: Literal["measured", "seed"]


class CoefficientSet(StrictModel, ABC):
    """A set of coefficients with its origin.

    Attributes:
        name, source: for people; the source names a table, data sheet or run.
        law_kind: `normal_force`, `two_sided` or `polar`.
        kind: `constant`, `speed_line`, `speed_table`, `table` or `surface`.
        range: what was measured.
        quasi_steady_limit: relative speed up to which the quasi-steady model was shown to hold, m/s.
    """

    model_config = ConfigDict(coerce_numbers_to_str=True)

    schema_: Literal["aerodima/coefficients/1"] = Field(alias="schema")
    name: str
    law_kind: str = Field(alias="law")
    kind: str
    source: str
    range: SpeedRange
    quasi_steady_limit: Number = Field(alias="quasi_steady_limit_m_per_s")
    _where: str = PrivateAttr(default="coefficients")

    @model_validator(mode="after")
    def _has_source(self) -> "CoefficientSet":
        if not self.source.strip():
            raise ValueError("source: is empty; allowed: the table, data sheet or run that the numbers come from")
        return self

    @property
    def speed_range(self) -> tuple[float, float]:
        """Measured relative speeds, m/s."""
        return self.range.speed_m_per_s

    @property
    def angle_range(self) -> tuple[float, float] | None:
        """Measured |gamma|, rad; None where the law has no angle."""
        return self.range.angle_rad if isinstance(self.range, PolarRange) else None

    @cached_property
    def nodes(self) -> pd.DataFrame:
        """One row per node (columns of the file, SI); empty for constants, lines and surfaces."""
        return pd.DataFrame([node.model_dump() for node in getattr(self, "node_list", ())])

    @abstractmethod
    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        """The section law of this set.

        Args:
            surface: for a table, use the polynomial surface of the highest degree that the measured nodes determine.
            seeds: for a table, use the seed nodes too; else the measured edge is held.
        """


class _NormalConstant(CoefficientSet):
    cn: Drag

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        return NormalForceLaw(self.cn)


class NormalLine(CoefficientSet):
    """C_N as a line over the relative speed."""

    cn_slope_s_per_m: Number
    cn_intercept: Number

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        """The normal-force law with that line."""
        return NormalForceLaw(self.line)

    @property
    def line(self) -> SpeedLine:
        """C_N over the relative speed."""
        return SpeedLine(self.cn_slope_s_per_m, self.cn_intercept, self.speed_range)

    @model_validator(mode="after")
    def _adds_no_energy(self) -> "NormalLine":
        # Not in `SpeedLine`: a fit may pass through negative lines on its way.
        for speed in self.speed_range:
            if (value := self.line(speed)) < 0.0:
                raise ValueError(
                    f"cn_slope_s_per_m and cn_intercept give {value:g} at {speed:g} m/s; allowed: >= 0, a negative "
                    "coefficient would add energy"
                )
        return self


class _NormalTable(CoefficientSet):
    node_list: tuple[SpeedNode, ...] = Field(alias="nodes", min_length=1)

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        return NormalForceLaw(SpeedTable(tuple(self.nodes.speed_m_per_s), tuple(self.nodes.cn), where=self._where))

    @model_validator(mode="after")
    def _increases(self) -> "_NormalTable":
        require_increasing("speed_m_per_s", [node.speed_m_per_s for node in self.node_list], "nodes")
        return self


class _TwoSided(CoefficientSet):
    cn_round_side: Drag
    cn_hollow_side: Drag

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        return TwoSidedLaw(self.cn_hollow_side, self.cn_round_side)


class _PolarConstant(CoefficientSet):
    range: PolarRange
    cd: Drag
    cl: Number

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        return PolarLaw(self.cd, self.cl)


class _PolarSurface(CoefficientSet):
    range: PolarRange
    cd: Rows
    cl: Rows
    speed_scale_m_per_s: Annotated[Number, Field(gt=0)]
    angle_scale_rad: Annotated[Number, Field(gt=0)]

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        speeds, angles = self.range.speed_m_per_s, self.range.angle_rad
        scales = self.speed_scale_m_per_s, self.angle_scale_rad
        drag, lift = (PolynomialSurface(rows, speeds, angles, *scales) for rows in (self.cd, self.cl))
        return PolarLaw(drag, lift)


class PolarTable(CoefficientSet):
    """Nodes of C_D and C_L, some measured and some only the start of a fit."""

    range: PolarRange
    node_list: tuple[PolarNode, ...] = Field(alias="nodes", min_length=1)

    @model_validator(mode="after")
    def _fills_its_grid(self) -> "PolarTable":
        """Nodes ascend by angle and then by speed, and there is one at every speed and angle."""
        keys = [(node.angle_rad, node.speed_m_per_s) for node in self.node_list]
        for i, (left, right) in enumerate(pairwise(keys)):
            if right <= left:
                raise ValueError(
                    f"nodes must increase by angle, then speed, but nodes[{i + 1}] (angle {right[0]}, "
                    f"speed {right[1]}) follows (angle {left[0]}, speed {left[1]})"
                )
        holes = sorted({(g, v) for g, _ in keys for _, v in keys} - set(keys))
        if holes:
            g, v = holes[0]
            raise ValueError(f"hole in the table: no node at {v} m/s, {g} rad; add it with status seed or measured")
        return self

    def law(self, *, surface: bool = False, seeds: bool = False) -> SectionLaw:
        """A bilinear table over speed and angle, or a surface; see `CoefficientSet.law`."""
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

        def nearest(v: float, g: float) -> float:
            return float(known[min((u for u in speeds if (u, g) in known), key=lambda u: abs(u - v)), g])

        return RegularTable(
            tuple(speeds),
            tuple(angles),
            tuple(tuple(nearest(v, g) for g in angles) for v in speeds),
            tuple(tuple((v, g) in flags for g in angles) for v in speeds),
            where=f"{self._where}: {coefficient}",
        )


_KINDS: dict[tuple[str, str], type[CoefficientSet]] = {
    ("normal_force", "constant"): _NormalConstant,
    ("normal_force", "speed_line"): NormalLine,
    ("normal_force", "speed_table"): _NormalTable,
    ("two_sided", "constant"): _TwoSided,
    ("polar", "constant"): _PolarConstant,
    ("polar", "table"): PolarTable,
    ("polar", "surface"): _PolarSurface,
}


def embedded_sets() -> list[str]:
    """Names of the sets in `models/coefficients/`."""
    return shipped_names(_FOLDER)


def load_coefficients(name_or_path: str | Path) -> CoefficientSet:
    """Reads a set: a name from `embedded_sets()`, or a path of a YAML or CSV file.

    A CSV file is a table for the polar law with the columns speed_m_per_s, angle_rad, cd, cl and source, and optionally
    status (`measured` or `seed`; measured when absent).

    Raises:
        ModelError: no such file or set, unknown or missing keys, wrong types, NaN, holes, doubled or unsorted nodes.
    """
    path = find_file(name_or_path, _FOLDER, "coefficients", ModelError)
    content = _csv_content(path) if path.suffix == ".csv" else read_yaml(path, ModelError)
    return coefficients_from_dict(content, str(path))


def _csv_content(path: Path) -> dict[str, Any]:
    """What a YAML file of the same table holds."""
    try:
        nodes = pd.read_csv(path)
    except FileNotFoundError:
        raise ModelError(f"{path}: no such file") from None
    except (OSError, ValueError, pd.errors.ParserError) as error:
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
    ends = {c: [float(measured[c].min()), float(measured[c].max())] for c in ("speed_m_per_s", "angle_rad")}
    return {
        "schema": SCHEMA,
        "name": path.stem,
        "law": "polar",
        "kind": "table",
        "source": "; ".join(sorted({str(s) for s in nodes.source})),
        "quasi_steady_limit_m_per_s": ends["speed_m_per_s"][1],
        "range": ends,
        "nodes": nodes.to_dict("records"),
    }


def coefficients_from_dict(content: Any, where: str) -> CoefficientSet:
    """A set from the content of a file; `where` names it in messages. Raises ModelError, see `load_coefficients`."""
    require_mapping(content, where, ModelError)
    law, kind = str(content.get("law")), str(content.get("kind"))
    if (law, kind) not in _KINDS and content.get("schema") == SCHEMA:
        allowed = ", ".join("/".join(pair) for pair in _KINDS)
        raise ModelError(f"{where}: law/kind is {law}/{kind} (allowed: {allowed})")
    model = _KINDS.get((law, kind), _TwoSided)  # of another schema no model is asked
    found = checked(model, content, where, ModelError, schema=SCHEMA)
    found._where = where
    largest = max([*(found.angle_range or ()), *found.nodes.get("angle_rad", ())], default=0.0)
    if largest > math.pi:
        warnings.warn(
            f"{where}: an angle is {largest} rad, beyond pi: is the column in degrees?", UserWarning, stacklevel=2
        )
    return found
