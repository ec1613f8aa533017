"""Coefficient sets on disk: YAML or CSV files with source, range, measured and seed nodes
(`models/coefficients/`).
"""

from abc import ABC, abstractmethod
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, ConfigDict, Field, PrivateAttr, Strict, model_validator

from aerodima.workbench.aero.polar_law import MIN_DRAG, PolarLaw, RegularTable, require_spanwise
from aerodima.workbench.aero.section_laws import (
    NormalForceLaw,
    SectionLaw,
    SpeedTable,
    TwoSidedLaw,
    speed_line,
)
from aerodima.workbench.core.array_types import Pair
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.yaml_files import (
    StrictModel,
    checked,
    find_file,
    read_yaml,
    require_mapping,
    shipped_names,
)

SCHEMA = "aerodima/coefficients/1"
_FOLDER = "coefficients"
Number = Annotated[float, Strict()]
Ends = Pair


def _refuse_gain(value: float, least: float) -> float:
    if value < least:
        raise ValueError(f"{value}; allowed: >= {least:g}, a negative coefficient would add energy")
    return value


def _increasing(ends: Ends) -> Ends:
    if not 0.0 <= ends[0] < ends[1]:
        raise ValueError(f"{list(ends)}; allowed: [lowest, highest], from 0 and increasing")
    return ends


Drag = Annotated[Number, AfterValidator(partial(_refuse_gain, least=0.0))]
Span = Annotated[tuple[Number, Number], AfterValidator(_increasing)]


class SpeedRange(StrictModel):
    """Measured relative speeds, m/s."""

    speed_m_per_s: Span


class PolarRange(SpeedRange):
    """Measured relative speeds, and angles |gamma| in rad."""

    angle_rad: Span


class SpeedNode(StrictModel):
    """A node over the speed; other keys of the file are kept."""

    model_config = ConfigDict(extra="allow")

    speed_m_per_s: Number
    cn: Drag


class PolarNode(StrictModel):
    """A node over speed and |gamma|, measured or only a guess to start a fit; even in the angle."""

    model_config = ConfigDict(extra="allow")

    speed_m_per_s: Annotated[Number, Field(ge=0)]
    angle_rad: Annotated[Number, Field(ge=0)]
    cd: Annotated[Number, AfterValidator(partial(_refuse_gain, least=MIN_DRAG))]
    cl: Number
    status: Literal["measured", "seed"]


class CoefficientSet(StrictModel, ABC):
    """A set of coefficients with its origin.

    Attributes:
        name, source: texts for people; the source names a table, data sheet or run.
        law_kind: kind of law, `normal_force`, `two_sided` or `polar`.
        kind: form of the coefficients, `constant`, `speed_line`, `speed_table` or `table`.
        range: measured range of speeds, and of angles where the law has them.
        quasi_steady_limit: relative speed up to which the quasi-steady model was shown to hold,
            m/s.
    """

    model_config = ConfigDict(coerce_numbers_to_str=True)

    schema_: str = Field(alias="schema")
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
            raise ValueError(
                "source: is empty; allowed: the table, data sheet or run that the numbers come from"
            )
        return self

    @property
    def speed_range(self) -> Ends:
        """Measured relative speeds, m/s."""
        return self.range.speed_m_per_s

    @property
    def angle_range(self) -> Ends | None:
        """Measured |gamma|, rad; None where the law has no angle."""
        return self.range.angle_rad if isinstance(self.range, PolarRange) else None

    @cached_property
    def nodes(self) -> pd.DataFrame:
        """Nodes, one per row (columns of the file, SI); empty for constants and lines."""
        return pd.DataFrame([node.model_dump() for node in getattr(self, "node_list", ())])

    @abstractmethod
    def law(self) -> SectionLaw:
        """Returns the section law of this set."""


class _NormalConstant(CoefficientSet):
    cn: Drag

    def law(self) -> SectionLaw:
        return NormalForceLaw(self.cn)


class _NormalLine(CoefficientSet):
    cn_slope_s_per_m: Number
    cn_intercept: Number

    def law(self) -> SectionLaw:
        return NormalForceLaw(
            speed_line(self.cn_slope_s_per_m, self.cn_intercept, self.speed_range)
        )

    @model_validator(mode="after")
    def _adds_no_energy(self) -> "_NormalLine":
        # Not in `speed_line`: a fit may pass through negative lines on its way.
        for speed in self.speed_range:
            value = self.cn_intercept + self.cn_slope_s_per_m * speed
            if value < 0.0:
                raise ValueError(
                    f"cn_slope_s_per_m and cn_intercept give {value:g} at {speed:g} m/s; allowed: "
                    ">= 0, a negative coefficient would add energy"
                )
        return self


class _NormalTable(CoefficientSet):
    node_list: tuple[SpeedNode, ...] = Field(alias="nodes", min_length=1)

    def law(self) -> SectionLaw:
        return NormalForceLaw(
            SpeedTable(tuple(self.nodes.speed_m_per_s), tuple(self.nodes.cn), where=self._where)
        )

    @model_validator(mode="after")
    def _increases(self) -> "_NormalTable":
        self.law()
        return self


class _TwoSided(CoefficientSet):
    cn_round_side: Drag
    cn_hollow_side: Drag

    def law(self) -> SectionLaw:
        return TwoSidedLaw(self.cn_hollow_side, self.cn_round_side)


class _PolarConstant(CoefficientSet):
    range: PolarRange
    cd: Drag
    cl: Number

    def law(self) -> SectionLaw:
        return PolarLaw(self.cd, self.cl)


class PolarTable(CoefficientSet):
    """Nodes of C_D and C_L, some measured and some only the start of a fit."""

    range: PolarRange
    node_list: tuple[PolarNode, ...] = Field(alias="nodes", min_length=1)

    @model_validator(mode="after")
    def _fills_its_grid(self) -> "PolarTable":
        """Checks that nodes ascend by angle, then by speed, with one at every speed and angle."""
        keys = [(node.angle_rad, node.speed_m_per_s) for node in self.node_list]
        for i, (left, right) in enumerate(pairwise(keys)):
            if right <= left:
                raise ValueError(
                    f"nodes must increase by angle, then speed, but nodes[{i + 1}] (angle "
                    f"{right[0]}, speed {right[1]}) follows (angle {left[0]}, speed {left[1]})"
                )
        holes = sorted({(g, v) for g, _ in keys for _, v in keys} - set(keys))
        if holes:
            g, v = holes[0]
            raise ValueError(
                f"hole in the table: no node at {v} m/s, {g} rad; add it with status seed or "
                "measured"
            )
        return self

    def law(self) -> SectionLaw:
        """Returns the polar law with bilinear tables over speed and angle."""
        return PolarLaw(self.table("cd"), self.table("cl"))

    def table(self, coefficient: str) -> RegularTable:
        """Returns the bilinear table of `cd` or `cl` over the grid of the measured nodes; the seeds
        of fits take no part.

        A node of that grid that was not measured takes the value of the nearest measured speed at
        its angle and is not covered.
        """
        nodes = self.nodes[self.nodes.status == "measured"]
        known = nodes.pivot(index="speed_m_per_s", columns="angle_rad", values=coefficient)
        speeds = known.index.to_numpy()
        angles = known.columns.to_numpy()

        def nearest(v: float, g: float) -> float:
            measured = known[g].dropna()
            return float(measured.iloc[np.argmin(np.abs(measured.index.to_numpy() - v))])

        values = tuple(tuple(nearest(v, g) for g in angles) for v in speeds)
        measured = tuple(map(tuple, known.notna().to_numpy().tolist()))
        where = f"{self._where}: {coefficient}"
        return RegularTable(tuple(speeds.tolist()), tuple(angles.tolist()), values, measured, where)


_KINDS: dict[tuple[str, str], type[CoefficientSet]] = {
    ("normal_force", "constant"): _NormalConstant,
    ("normal_force", "speed_line"): _NormalLine,
    ("normal_force", "speed_table"): _NormalTable,
    ("two_sided", "constant"): _TwoSided,
    ("polar", "constant"): _PolarConstant,
    ("polar", "table"): PolarTable,
}


def embedded_sets() -> list[str]:
    """Returns the names of the sets in `models/coefficients/`."""
    return shipped_names(_FOLDER)


def load_coefficients(name_or_path: str | Path) -> CoefficientSet:
    """Reads a set: a name from `embedded_sets()`, or a path of a YAML or CSV file.

    A CSV file is a table for the polar law with the columns speed_m_per_s, angle_rad, cd, cl and
    source, and optionally status (`measured` or `seed`; measured when absent).

    Raises:
        ModelError: no such file or set, unknown or missing keys, wrong types, NaN, holes, doubled
            or unsorted nodes, angles beyond pi/2.
    """
    path = find_file(name_or_path, _FOLDER, "coefficients", ModelError)
    if path.suffix == ".csv":
        content = _csv_content(path)
    else:
        content = read_yaml(path, ModelError)
    return coefficients_from_dict(content, str(path))


def _csv_content(path: Path) -> Json:
    """Reads a CSV table as the content of a YAML file of the same table."""
    columns: Json = dict.fromkeys(("speed_m_per_s", "angle_rad", "cd", "cl"), float)
    columns["source"] = str
    try:
        nodes = pd.read_csv(path).astype(columns)
    except FileNotFoundError:
        raise ModelError(f"{path}: no such file") from None
    except (KeyError, OSError, ValueError) as error:
        raise ModelError(f"{path}: {error}; a table has the columns {', '.join(columns)}") from None
    nodes = nodes.assign(status=nodes.get("status", "measured"))
    measured = nodes[nodes.status == "measured"]
    if measured.empty:
        raise ModelError(f"{path}: no node has the status 'measured'")
    ends = measured[["speed_m_per_s", "angle_rad"]].agg(["min", "max"]).to_dict("list")
    return {
        "schema": SCHEMA,
        "name": path.stem,
        "law": "polar",
        "kind": "table",
        "source": "; ".join(sorted(set(nodes.source))),
        "quasi_steady_limit_m_per_s": ends["speed_m_per_s"][1],
        "range": ends,
        "nodes": nodes.to_dict("records"),
    }


def coefficients_from_dict(content: Any, where: str) -> CoefficientSet:
    """Makes a set from the content of a file; `where` names it in messages.

    Raises ModelError, see `load_coefficients`.
    """
    require_mapping(content, where, ModelError)
    law = str(content.get("law"))
    kind = str(content.get("kind"))
    if (law, kind) not in _KINDS and content.get("schema") == SCHEMA:
        allowed = ", ".join(map("/".join, _KINDS))
        raise ModelError(f"{where}: law/kind is {law}/{kind} (allowed: {allowed})")
    model = _KINDS.get((law, kind), _TwoSided)  # another schema is refused before any model
    result = checked(model, content, where, ModelError, schema=SCHEMA)
    result._where = where
    largest = max([*(result.angle_range or ()), *result.nodes.get("angle_rad", ())], default=0.0)
    require_spanwise(largest, where)
    return result
