"""Recomputation of the published tables (`aerodima fit published`); ERRATA.md lists what is odd in
them.

The rig constants that the thesis does not give are fitted jointly to its 200 published holding
currents. Given C_D, C_L and psi3 of a test, the current that holds the tail still follows from the
motor's torque constant k_t N, the jet's edge h0, and per tail its centre of mass and the gap in its
mount. Errors are relative to the current; beyond 2 % they count by the Huber loss, because some
published tests are broken (no wind, wrong wind speed).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from aerodima.optimisation.identify.coefficient_averages import averages
from aerodima.optimisation.identify.fit_pipeline import fit
from aerodima.optimisation.identify.fit_result import FitResult, make_curve
from aerodima.optimisation.identify.huber import huber
from aerodima.optimisation.identify.least_squares import Parameter, Parameters, Problem
from aerodima.optimisation.identify.noise import Noise, independent_noise
from aerodima.optimisation.identify.rig_constants import with_values
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.resources import published_rows, published_table
from aerodima.workbench.rig.pendulum import StaticBalance
from aerodima.workbench.scenario.rig_scenario import RigScenario, rig_scenario_from_dict

OUTLIER = 0.03
"""Relative error of a predicted current above which a row is listed."""
_TOLERANCE = 0.02
"""Relative error of a current above which the fit weighs it less."""
_MIN_CURRENT = 0.5
"""Current to which the errors of smaller currents are relative in the fit, A: the tests without
wind held almost nothing."""
_TAILS = (1, 2, 3)
"""Numbers of the tails with published holds."""
_COPIED_TABLE = "Table 11.6"
"""Table of the robot tail whose rows are repeated in a table of a lower wind speed, to which
they cannot belong."""
_CELL = ["tail", "axis", "angle_of_attack_deg", "wind_speed_m_per_s"]


def check_published() -> tuple[list[FitResult], dict[str, pd.DataFrame]]:
    """Recompute everything; return the fits of the rig constants and of the robot tail's line, and
    all tables by name.
    """
    constants = fit_rig_constants(static_rows())
    line = robot_tail_line()
    table = recompute_averages()
    currents = constants.rows
    summary = {
        "holding currents: median of |error|": float(currents.relative_error.abs().median()),
        f"holding currents off by more than {OUTLIER:.0%}": len(constants.outliers),
        "holding currents": len(currents),
        "weighted averages that agree": int(table.agrees.sum()),
        "weighted averages": len(table),
        "robot tail: mean C_N": float(robot_tail_rows().cd.mean()),
    }
    errors = currents.assign(absolute=np.abs(currents.relative_error))
    cells = errors.groupby(_CELL[:3])["absolute"]
    tables = {
        "summary": pd.DataFrame(summary.items(), columns=["quantity", "value"]),
        "currents_by_cell": cells.agg(["median", "max", "size"]).reset_index(),
        "current_outliers": constants.outliers,
        "weighted_averages": table,
        "static_cells": static_cells(),
    }
    return [constants.fit, line], tables


def static_rows() -> pd.DataFrame:
    """Read the 200 distinct rows of the static fits, without the copied ones (ERRATA E1)."""
    rows = published_table("static_fits")
    return rows[rows.derived_repeats_wind_speed_m_per_s.isna()].reset_index(drop=True)


def robot_tail_rows() -> pd.DataFrame:
    """Read the 160 distinct coefficients of the robot tail, without the copy (ERRATA E24)."""
    rows = published_table("robot_tail_drag")
    return rows[rows.derived_identical_to != _COPIED_TABLE].reset_index(drop=True)


def recompute_averages() -> pd.DataFrame:
    """Recompute every weighted average of Tables 4.7, 6.2, 11.1 and 11.2 beside the printed one.

    Returns:
        A row per average: table, quantity, published, its `averages`, and `agrees`: whether they
        differ by no more than half a unit of the last printed digit.
    """
    rows = []
    for name in ("bar_friction", "robot_tail_friction"):
        swings = published_table(name).query("record == 'swing'")
        final = next(row for row in published_rows(name) if row["record"].startswith("published_"))
        for column in ("coulomb_friction_n_m", "viscous_friction_n_m_s_per_rad"):
            rows.append(_average_row(swings, column, column, final[column]))
    texts = [row["published_weighted_average_kg"] for row in published_rows("added_mass")]
    cells = ["source_table", "tail", "axis", "wind_speed_m_per_s"]
    groups = published_table("added_mass").groupby(cells, sort=False)
    for (_, tail, axis, speed), group in groups:
        label = f"added_mass_kg tail {tail} {axis} {speed:g} m/s"
        rows.append(_average_row(group, "added_mass_kg", label, texts[group.index[0]]))
    return pd.DataFrame(rows)


def _average_row(fits: pd.DataFrame, column: str, quantity: str, text: str) -> Json:
    """Recompute one average; `text` is the printed one."""
    average = averages(fits[column].to_numpy(), fits.resnorm.to_numpy())
    published = float(text)
    half = 0.5 * 10.0 ** -len(text.partition(".")[2])
    return {
        "table": fits.source_table.iloc[0],
        "quantity": quantity,
        "published": published,
        **average,
        "agrees": abs(published - average["weighted"]) <= half * (1.0 + 1e-9),
    }


def robot_tail_line() -> FitResult:
    """Fit C_N = slope v + intercept through the 160 distinct coefficients (Tables 6.3, 11.4-11.7;
    ERRATA E26).
    """
    rows = robot_tail_rows().sort_values("relative_velocity_m_per_s")
    speed = rows.relative_velocity_m_per_s.to_numpy(float)
    values = rows.cd.to_numpy(float)
    height = float(np.std(values))
    unknowns = [
        Parameter("slope", "s/m", 0.0, scale=height / float(np.std(speed))),
        Parameter("intercept", "1", 0.0, scale=height),
    ]
    design = np.column_stack([speed, np.ones_like(speed)]) / height

    def residual(p: FloatArray) -> FloatArray:
        return design @ p - values / height

    name = "robot tail, Tables 6.3 and 11.4-11.7"
    line = fit(
        Problem(Parameters.of(unknowns), residual, lambda _: design, name=name),
        lambda solution: independent_noise(solution.residual, len(unknowns)),
        channels={"cn": (slice(None), height)},
        facts={"points": len(speed)},
    )
    model = line["slope"].value * speed + line["intercept"].value
    curve = make_curve(speed, values, model, "relative speed, m/s", "C_N")
    return replace(line, curves={"C_N": curve})


def static_cells() -> pd.DataFrame:
    """Average C_D and C_L per cell: weighted (eqs. 4.29-4.31), mean, median, Huber and
    percentiles.
    """
    cells = []
    rows = static_rows()
    for cell, group in rows[~rows.published_bold_outlier.eq(True)].groupby(_CELL):
        row = dict(zip(_CELL, cell, strict=True))
        for name in ("cd", "cl"):
            average = averages(group[name].to_numpy(), group.resnorm.to_numpy())
            samples = average.pop("samples")
            row |= {f"{name}_{key}": value for key, value in average.items()}
        cells.append({**row, "samples": samples})
    return pd.DataFrame(cells)


@dataclass(frozen=True)
class RigConstants:
    """Result of the joint fit.

    Attributes:
        fit: fitted constants with intervals.
        rows: table with the published current, the predicted one and the relative error of each
            test.
    """

    fit: FitResult
    rows: pd.DataFrame

    @property
    def outliers(self) -> pd.DataFrame:
        """Rows whose error is above 3 %."""
        return self.rows[self.rows.relative_error.abs() > OUTLIER].reset_index(drop=True)


def constants_parameters() -> Parameters:
    """List the unknown constants; initial values and physical bounds are values and priors of
    `models/parameters/rig`.
    """
    unknowns = [_unknown("maxon", "torque_constant"), _unknown("tunnel", "jet_edge_depth")]
    for tail in _TAILS:
        unknowns += [_unknown(f"tail_{tail}", key) for key in ("com_distance", "gap")]
    return Parameters.of(unknowns)


def _unknown(section: str, key: str) -> Parameter:
    entry = RigScenario.parameters(section)[key]
    assert entry.prior is not None
    low, high = entry.prior
    name = key if section in ("maxon", "tunnel") else f"{section}_{key}"
    return Parameter(name, entry.unit, float(entry.value), float(low), float(high))


def balances() -> dict[int, StaticBalance]:
    """Make the held rig with each of the three tails, with the parameters of `models/`."""
    return {
        tail: StaticBalance.from_scenario(
            rig_scenario_from_dict({"experiment": {"kind": "static", "tail": tail}})
        )
        for tail in _TAILS
    }


def with_constants(balance: StaticBalance, tail: int, values: dict[str, float]) -> StaticBalance:
    """Make a held rig with trial values of the constants."""
    changes = {
        "maxon": {"torque_constant": values["torque_constant"]},
        "tunnel": {"jet_edge_depth": values["jet_edge_depth"]},
        f"tail_{tail}": {key: values[f"tail_{tail}_{key}"] for key in ("com_distance", "gap")},
    }
    return StaticBalance.from_scenario(with_values(balance.scenario, changes))


def predicted_currents(rigs: dict[int, StaticBalance], rows: pd.DataFrame) -> FloatArray:
    """Predict the current of each row (n), A, from its published coefficients."""
    tests = rows[["tail", "angle_of_attack_deg", "wind_speed_m_per_s", "cd", "cl", "psi3_rad"]]
    currents = [
        rigs[tail].holding_current(math.radians(degrees), *wind_and_coefficients)
        for tail, degrees, *wind_and_coefficients in tests.itertuples(index=False)
    ]
    return np.array(currents)


def fit_rig_constants(rows: pd.DataFrame) -> RigConstants:
    """Fit the constants to the published currents of rows of `static_fits.csv`."""
    parameters = constants_parameters()
    rigs = balances()
    published = rows.current_a.to_numpy(float)
    size = np.maximum(np.abs(published), _MIN_CURRENT)

    def errors(x: FloatArray) -> FloatArray:
        values = parameters.values(x)
        trial = {tail: with_constants(rig, tail, values) for tail, rig in rigs.items()}
        return (predicted_currents(trial, rows) - published) / size

    def residual(x: FloatArray) -> FloatArray:
        return huber(errors(x) / _TOLERANCE, 1.0)

    result = fit(
        Problem(parameters, residual, name="rig constants"),
        lambda solution: _cell_noise(solution.residual, rows, len(parameters.free)),
        channels={"current": (slice(None), _TOLERANCE)},
        facts={"rows": len(rows)},
    )
    predicted = published + size * errors(np.array([e.value for e in result.free]))
    table = rows[["source_table", *_CELL, "test_no"]].assign(
        published_a=published, predicted_a=predicted
    )
    table["relative_error"] = predicted / published - 1.0
    ordered = table.sort_values("published_a")
    held = ordered.published_a.to_numpy()
    labels = "published current, A", "current from the published coefficients, A"
    curve = make_curve(held, ordered.predicted_a.to_numpy(), held, *labels)
    return RigConstants(replace(result, curves={"holding current": curve}), table)


def _cell_noise(residual: FloatArray, rows: pd.DataFrame, unknowns: int) -> Noise:
    """Estimate the noise; the five tests of a cell share their error and count as one."""
    cell = rows.groupby(_CELL).ngroup().to_numpy()
    cells = int(cell.max()) + 1
    freedom = max(cells - unknowns, 1)
    variance = float(np.mean(np.square(residual))) * cells / freedom
    return Noise(variance * np.equal.outer(cell, cell), float(freedom), float(cells))
