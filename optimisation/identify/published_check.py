"""Everything that can be recomputed from the published tables, in one report (`aerodima fit published`).

The rig constants that the thesis does not give are fitted jointly to its 200 published holding currents. Given C_D,
C_L and psi3 of a test, the current that holds the tail still follows from the motor's torque constant k_t N, the jet's
edge h0, and per tail its centre of mass and the gap in its mount. Errors are relative to the current; beyond 2 % they
count by the Huber loss, because some published tests are broken (no wind, wrong wind speed).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from aerodima.optimisation.identify.coefficient_averages import aggregate, recompute_averages
from aerodima.optimisation.identify.fit_parameters import Parameter, Parameters
from aerodima.optimisation.identify.fit_pipeline import FitResult, fit
from aerodima.optimisation.identify.hold_mean import StaticBalance
from aerodima.optimisation.identify.least_squares import Loss, Problem, huber
from aerodima.optimisation.identify.least_squares_solvers import solve_formula, solve_rollout
from aerodima.optimisation.identify.log_rig import with_values
from aerodima.optimisation.identify.published_tables import (
    Flag,
    flag_added_mass,
    flag_robot_tail,
    flag_static,
    robot_tail_rows,
    static_rows,
)
from aerodima.optimisation.identify.residual_noise import Noise, independent_noise
from aerodima.workbench.config.rig_scenario import RigScenario, rig_scenario_from_dict
from aerodima.workbench.errors import FitError


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


def fit_line(
    x: np.ndarray,
    y: np.ndarray,
    slope: tuple[str, str],
    offset: tuple[str, str],
    *,
    name: str,
    channel: str,
    facts: Mapping[str, Any] | None = None,
    loss: Loss = "squares",
) -> FitResult:
    """The line y = slope x + offset through points.

    Args:
        x, y: points (n).
        slope, offset: name and unit of the two parameters.
        channel: what y is, for the residual.
        loss: `huber` holds points back that lie far off.

    Raises:
        FitError: fewer than three points, or one that is not finite.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(x) < 3:
        raise FitError(f"{name}: {len(x)} points are too few for a line with an interval; at least 3 are needed")
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(y))):
        raise FitError(f"{name}: a point is not finite")
    spread = float(np.std(x)) or 1.0
    height = float(np.std(y)) or float(np.max(np.abs(y))) or 1.0
    parameters = Parameters.of(
        [
            Parameter(slope[0], slope[1], 0.0, scale=height / spread),
            Parameter(offset[0], offset[1], 0.0, scale=height),
        ]
    )
    design = np.column_stack([x, np.ones_like(x)]) / height
    problem = Problem(parameters, lambda p: design @ p - y / height, lambda p: design, name=name)
    return fit(
        problem,
        solve_formula,
        lambda solution: independent_noise(solution.residual, len(parameters.free)),
        channels={channel: (slice(None), height)},
        facts=facts,
        loss=loss,
    )


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


OUTLIER = 0.03
"""Relative error of a predicted current above which a row is listed."""
_TOLERANCE = 0.02
_LEAST_CURRENT = 0.5
"""The fit takes errors of smaller currents relative to this, A: the tests without wind held almost nothing."""
_TAILS = (1, 2, 3)


@dataclass(frozen=True)
class RigConstants:
    """Result of the joint fit.

    Attributes:
        fit: values with intervals.
        rows: per published test its current, the predicted one and the relative error.
        outliers: the rows whose error is above 3 %.
        by_cell: median and largest absolute error per tail, axis and angle.
        median_error: median absolute relative error over all rows of all tails.
    """

    fit: FitResult
    rows: pd.DataFrame
    outliers: pd.DataFrame
    by_cell: pd.DataFrame
    median_error: float


def constants_parameters() -> Parameters:
    """The unknown constants; seed and physical bounds are value and prior in `models/parameters/rig`."""
    found = [_unknown("maxon", "torque_constant"), _unknown("tunnel", "jet_edge_depth")]
    for tail in _TAILS:
        found += [_unknown(f"tail_{tail}", "com_distance"), _unknown(f"tail_{tail}", "gap")]
    return Parameters.of(found)


def _unknown(section: str, key: str) -> Parameter:
    entry = RigScenario.parameters(section)[key]
    assert entry.prior is not None
    low, high = entry.prior
    name = key if section in ("maxon", "tunnel") else f"{section}_{key}"
    return Parameter(name, entry.unit, float(entry.value), float(low), float(high))


def balances() -> dict[int, StaticBalance]:
    """The held rig with each of the three tails, with the parameters of `models/`."""
    return {
        tail: StaticBalance.of(rig_scenario_from_dict({"experiment": {"kind": "static", "tail": tail}}))
        for tail in _TAILS
    }


def with_constants(balance: StaticBalance, tail: int, values: dict[str, float]) -> StaticBalance:
    """A held rig with a trial of the constants."""
    changes = {
        "maxon": {"torque_constant": values["torque_constant"]},
        "tunnel": {"jet_edge_depth": values["jet_edge_depth"]},
        f"tail_{tail}": {key: values[f"tail_{tail}_{key}"] for key in ("com_distance", "gap")},
    }
    return StaticBalance.of(with_values(balance.scenario, changes))


def predicted_currents(rigs: dict[int, StaticBalance], rows: pd.DataFrame) -> np.ndarray:
    """The current of each row (n), A, from its published coefficients."""
    currents = []
    row: Any
    for row in rows.itertuples():
        angle = math.radians(row.angle_of_attack_deg)
        current = rigs[row.tail].holding_current(angle, row.wind_speed_m_per_s, row.cd, row.cl, row.psi3_rad)
        currents.append(current)
    return np.array(currents)


def fit_rig_constants(rows: pd.DataFrame | None = None, seeds: int = 2) -> RigConstants:
    """Fits the constants to the published currents.

    Args:
        rows: of `static_fits.csv`; the distinct ones by default.
        seeds: random starts beside the parameters of `models/`.
    """
    rows = static_rows() if rows is None else rows
    parameters = constants_parameters()
    rigs = balances()
    published = rows.current_a.to_numpy(float)
    size = np.maximum(np.abs(published), _LEAST_CURRENT)

    def errors(x: np.ndarray) -> np.ndarray:
        values = parameters.values(x)
        trial = {tail: with_constants(rig, tail, values) for tail, rig in rigs.items()}
        return (predicted_currents(trial, rows) - published) / size

    result = fit(
        Problem(parameters, lambda x: huber(errors(x) / _TOLERANCE, 1.0), name="rig constants"),
        solve_rollout,
        lambda solution: _cell_noise(solution.residual, rows, len(parameters.free)),
        starts=parameters.starts(random=seeds),
        channels={"current": (slice(None), _TOLERANCE)},
        facts={"rows": len(rows)},
    )
    predicted = published + size * errors(np.array([e.value for e in result.free]))
    relative = predicted / published - 1.0
    table = rows[["source_table", "tail", "axis", "angle_of_attack_deg", "wind_speed_m_per_s", "test_no"]].copy()
    table["published_a"], table["predicted_a"] = published, predicted
    table["relative_error"] = relative
    ordered = table.sort_values("published_a")
    curve = {
        "x": ordered.published_a.tolist(),
        "measured": ordered.predicted_a.tolist(),
        "equal": ordered.published_a.tolist(),
        "labels": ["published current, A", "current from the published coefficients, A"],
    }
    result = replace(result, curves={"holding current": curve})
    absolute = table.assign(absolute=np.abs(relative))
    cells = absolute.groupby(["tail", "axis", "angle_of_attack_deg"])["absolute"].agg(["median", "max", "size"])
    return RigConstants(
        result,
        table,
        table[np.abs(relative) > OUTLIER].reset_index(drop=True),
        cells.reset_index(),
        float(np.median(np.abs(relative))),
    )


def _cell_noise(residual: np.ndarray, rows: pd.DataFrame, unknowns: int) -> Noise:
    """The five tests of a cell share their error (the model's): they count as one sample."""
    cell = rows.groupby(["tail", "axis", "angle_of_attack_deg", "wind_speed_m_per_s"]).ngroup().to_numpy()
    cells = int(cell.max()) + 1
    freedom = max(cells - unknowns, 1)
    variance = float(np.mean(np.square(residual))) * cells / freedom
    return Noise(variance * (cell[:, None] == cell[None, :]), float(freedom), float(cells))
