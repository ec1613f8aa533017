"""Everything that can be recomputed from the published tables, in one report (`aerodima fit published`)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import pandas as pd

from aerodima.optimisation.fit.fit_pipeline import FitResult
from aerodima.optimisation.identify.line_fit import fit_line
from aerodima.optimisation.identify.published_tables import (
    Flag,
    flag_added_mass,
    flag_robot_tail,
    flag_static,
    robot_tail_rows,
    static_rows,
)
from aerodima.optimisation.identify.rig_constants import OUTLIER, RigConstants, fit_rig_constants
from aerodima.optimisation.identify.weighted_averages import aggregate, recompute_averages


@dataclass(frozen=True)
class PublishedCheck:
    """What the published tables say about themselves.

    Attributes:
        constants: rig constants fitted to the holding currents.
        robot_tail_line: C_N of the robot tail as a line over the relative speed.
        robot_tail_mean: mean of its 160 distinct coefficients.
        averages: every printed weighted average beside the recomputed one.
        cells: aggregated C_D and C_L per tail, axis, angle and wind speed.
        flags: what is wrong in the tables.
    """

    constants: RigConstants
    robot_tail_line: FitResult
    robot_tail_mean: float
    averages: pd.DataFrame
    cells: pd.DataFrame
    flags: tuple[Flag, ...]

    @property
    def flag_table(self) -> pd.DataFrame:
        """One row per flag."""
        return pd.DataFrame([asdict(flag) for flag in self.flags])

    def notes(self) -> list[str]:
        """The findings in sentences."""
        agree = int(self.averages.agrees.sum())
        line = self.robot_tail_line
        return [
            f"Holding currents: median absolute error {self.constants.median_error:.2%} over "
            f"{len(self.constants.rows)} tests of all tails; {len(self.constants.outliers)} are off by more than "
            f"{OUTLIER:.0%}.",
            f"Weighted averages: {agree} of {len(self.averages)} agree to the last printed digit.",
            f"Robot tail, {line.facts['points']} values: mean C_N {self.robot_tail_mean:.3f}, line "
            f"{line['slope'].value:.4f} v + {line['intercept'].value:.3f}.",
            f"{len(self.flags)} places of the tables are flagged.",
        ]


def robot_tail_line() -> FitResult:
    """C_N = slope v + intercept through the 160 distinct coefficients (Tables 6.3, 11.4-11.7; ERRATA E26)."""
    rows = robot_tail_rows()
    rows = rows.sort_values("relative_velocity_m_per_s")
    speed, values = rows.relative_velocity_m_per_s.to_numpy(float), rows.cd.to_numpy(float)
    line = fit_line(
        speed,
        values,
        ("slope", "s/m"),
        ("intercept", "1"),
        name="robot tail, Tables 6.3 and 11.4-11.7",
        channel="cn",
        facts={"points": len(rows)},
    )
    curve = {
        "x": speed.tolist(),
        "measured": values.tolist(),
        "line": (line["slope"].value * speed + line["intercept"].value).tolist(),
        "labels": ["relative speed, m/s", "C_N"],
    }
    return replace(line, curves={"C_N": curve})


def static_cells() -> pd.DataFrame:
    """C_D and C_L per cell: weighted (eqs. 4.29-4.31), mean, median, Huber and percentiles."""
    found = []
    keys = ["tail", "axis", "angle_of_attack_deg", "wind_speed_m_per_s"]
    rows = static_rows()
    for cell, group in rows[~rows.published_bold_outlier.eq(True)].groupby(keys):
        row = dict(zip(keys, cell, strict=True))
        for name in ("cd", "cl"):
            averages = aggregate(group[name].to_numpy(), group.resnorm.to_numpy()).columns()
            row |= {f"{name}_{key}": value for key, value in averages.items() if key != "samples"}
        found.append({**row, "samples": len(group)})
    return pd.DataFrame(found)


def check_published(seeds: int = 2) -> PublishedCheck:
    """Recomputes everything; `seeds` random starts for the rig constants."""
    averages, wrong = recompute_averages()
    flags = (*flag_static(), *flag_added_mass(), *wrong, *flag_robot_tail())
    rows = robot_tail_rows()
    return PublishedCheck(
        fit_rig_constants(seeds=seeds), robot_tail_line(), float(rows.cd.mean()), averages, static_cells(), flags
    )
