"""The published tables, and what is odd in them: found by rules; the ERRATA number says what a find is called."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from aerodima.workbench.resources import published_table


@dataclass(frozen=True)
class Flag:
    """Something in the published tables that a reader should know.

    Attributes:
        table: as in the thesis.
        rows: which rows, in words.
        finding: what is wrong, with numbers.
        erratum: number in ERRATA.md.
    """

    table: str
    rows: str
    finding: str
    erratum: str


def static_rows() -> pd.DataFrame:
    """The 200 distinct rows of the static fits: the copied ones are left out (ERRATA E1)."""
    rows = published_table("static_fits")
    return rows[~repeated_speed(rows)].reset_index(drop=True)


def repeated_speed(rows: pd.DataFrame) -> pd.Series:
    """Rows that equal those of a lower wind speed at the same tail, axis and angle in every number."""
    cell = ["tail", "axis", "angle_of_attack_deg", "test_no"]
    numbers = ["cd", "cl", "psi3_rad", "current_a", "resnorm"]
    ordered = rows.sort_values("wind_speed_m_per_s", kind="stable")
    return ordered.duplicated(cell + numbers, keep="first").reindex(rows.index)


def flag_static() -> list[Flag]:
    """Copied, identical, out-of-bounds and saturated rows of Tables 4.11 and 10.6-10.18."""
    rows = published_table("static_fits")
    return [*_copied(rows), *_identical(rows), *_scattered(rows), *_large(rows), *_bounds(rows)]


def _copied(rows: pd.DataFrame) -> Iterator[Flag]:
    for (table, speed), group in rows[repeated_speed(rows)].groupby(["source_table", "wind_speed_m_per_s"]):
        where = f"{speed:g} m/s, {len(group)} rows"
        yield Flag(str(table), where, "equal the rows of a lower wind speed in every number", "E1")


def _identical(rows: pd.DataFrame) -> Iterator[Flag]:
    for (table, speed), group in rows.groupby(["source_table", "wind_speed_m_per_s"]):
        same = all(group[name].nunique() == 1 for name in ("cd", "cl", "current_a"))
        if same and len(group) > 1 and group.resnorm.nunique() > 1:
            values = f"C_D {group.cd.iloc[0]:g}, C_L {group.cl.iloc[0]:g}, current {group.current_a.iloc[0]:g} A"
            yield Flag(str(table), f"{speed:g} m/s", f"all {len(group)} tests give {values}", "E7")


def _scattered(rows: pd.DataFrame) -> Iterator[Flag]:
    """Cells whose lowest C_D is below 85 % of the highest without being marked as outliers."""
    kept = rows[(rows.cd > 0.1) & (rows.current_a > 0.1) & ~repeated_speed(rows)]
    for (table, speed), group in kept.groupby(["source_table", "wind_speed_m_per_s"]):
        ratio = group.cd.min() / group.cd.max()
        if ratio < 0.85:
            values = ", ".join(f"{value:g}" for value in group.cd)
            finding = f"C_D of the tests {values} (lowest / highest {ratio:.2f})"
            yield Flag(str(table), f"{speed:g} m/s", finding, "E3")


def _large(rows: pd.DataFrame) -> Iterator[Flag]:
    row: Any
    for row in rows[(rows.resnorm > 1000.0) & ~rows.published_bold_outlier.eq(True)].itertuples():
        yield Flag(row.source_table, _test(row), f"resnorm {row.resnorm:g} is not marked", "E4")


def _bounds(rows: pd.DataFrame) -> Iterator[Flag]:
    row: Any
    for row in rows[~repeated_speed(rows)].itertuples():
        for label, value in (("C_L", row.cl), ("C_D", row.cd)):
            if value < 0.0:
                yield Flag(row.source_table, _test(row), f"{label} {value:g} lies below its printed bound 0", "E5")
        if abs(row.psi3_rad) in (0.12, 0.15):
            yield Flag(row.source_table, _test(row), f"psi3 stopped at {row.psi3_rad:g} rad", "E6")


def _test(row: Any) -> str:
    return f"{row.wind_speed_m_per_s:g} m/s, test {row.test_no}"


def flag_added_mass() -> list[Flag]:
    """Added-mass constants that stopped at a bound of Table 4.12."""
    bounds = published_table("added_mass_seeds").set_index("wind_speed_m_per_s")
    found = []
    row: Any
    for row in published_table("added_mass").itertuples():
        low, high = bounds.lb_kg[row.wind_speed_m_per_s], bounds.ub_kg[row.wind_speed_m_per_s]
        if not low < row.added_mass_kg < high:
            where = f"tail {row.tail} {row.axis} {row.wind_speed_m_per_s:g} m/s, swing {row.swing}"
            found.append(Flag(row.source_table, where, f"{row.added_mass_kg:g} kg is the bound of Table 4.12", "E23"))
    return found


def flag_robot_tail() -> list[Flag]:
    """Tables of the robot tail that repeat another, and headers that contradict the caption."""
    rows = published_table("robot_tail_drag")
    found = []
    for table in duplicated_robot_tables():
        other = published_twin(rows, table)
        found.append(Flag(table, "all", f"coefficients and resnorms equal those of {other}; it is left out", "E24"))
    for name, group in rows.groupby("source_table", sort=False):
        printed = (group.header_wind_speed_m_per_s.iloc[0], group.header_kp.iloc[0])
        caption = (group.wind_speed_m_per_s.iloc[0], group.kp.iloc[0])
        if printed != caption:
            says = "the header says {:g} m/s, Kp {:g}; the caption {:g} m/s, Kp {:g}"
            finding = says.format(*printed, *caption)
            found.append(Flag(str(name), "header", finding, "E25"))
    return found


def _robot_values(rows: pd.DataFrame, table: str) -> np.ndarray:
    group = rows[rows.source_table == table].sort_values(["swing", "relative_velocity_m_per_s"])
    return group[["relative_velocity_m_per_s", "cd", "resnorm"]].to_numpy(float)


def published_twin(rows: pd.DataFrame, table: str) -> str:
    """Another table with the same numbers, or an empty string."""
    mine, others = _robot_values(rows, table), (str(name) for name in rows.source_table.unique() if name != table)
    return next((other for other in others if np.array_equal(mine, _robot_values(rows, other))), "")


def duplicated_robot_tables() -> list[str]:
    """Of each pair of equal tables the one whose lowest relative velocity lies above the wind speed."""
    rows = published_table("robot_tail_drag")
    return [
        str(table)
        for table, group in rows.groupby("source_table", sort=False)
        if published_twin(rows, str(table)) and group.relative_velocity_m_per_s.min() > group.wind_speed_m_per_s.iloc[0]
    ]


def robot_tail_rows() -> pd.DataFrame:
    """The 160 distinct coefficients of the robot tail."""
    rows = published_table("robot_tail_drag")
    return rows[~rows.source_table.isin(duplicated_robot_tables())].reset_index(drop=True)
