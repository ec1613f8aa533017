"""What a calibration leaves behind: the ensemble file, its tables, plots and one page that says what they mean."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from aerodima.optimisation.calibration.bracket_design import Runner
from aerodima.optimisation.calibration.calibration import Calibration, member_frame, member_name
from aerodima.optimisation.calibration.calibration_page import calibration_page
from aerodima.optimisation.calibration.calibration_plan import assumed_elsewhere, fitted_names
from aerodima.optimisation.calibration.calibration_runs import RunStore
from aerodima.optimisation.calibration.car_prior import systematic_sample
from aerodima.optimisation.calibration.identifiability import directions, sensitivities, shrinkage
from aerodima.optimisation.calibration.validation import Shipped, as_table, shipped_car, validate
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import ProgressLine, silent
from aerodima.workbench.config.ensemble import ENSEMBLE_SCHEMA, load_ensemble, weighted_quantiles
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.report.report_page import write_files

REPORT = "index.html"
PRIOR_SAMPLE = 4096
"""Draws from the prior that its quantiles rest on."""


def write_calibration(
    result: Calibration, out: str | Path, store: RunStore, engine: Engine, progress: ProgressLine = silent
) -> Path:
    """Writes `<plan>.yaml` (the ensemble), `members.parquet`, five tables as CSV and `index.html`; the page's path."""
    out, shipped = Path(out), shipped_car(result, Runner(store, engine, progress))
    (path,) = write_files(out, {f"{result.plan.name}.yaml": ensemble_text(result)})
    ensemble = load_ensemble(path)
    progress("validation: Tables 7.1 to 7.4 ...")
    validated, outcomes = validate(ensemble.members, result.plan, store, engine)
    sensitivity = sensitivities(result.draw, result.plan.seed)
    parameters = parameter_table(result, shipped)
    combinations = directions(result.draw, result.plan.seed)
    tables = {
        "members.parquet": member_frame(result),
        "validation.csv": as_table(validated),
        "outcomes.csv": as_table(outcomes),
        "sensitivities.csv": sensitivity,
        "parameters.csv": parameters,
        "directions.csv": pd.DataFrame([{"variance_ratio": d.ratio, "combination": d.words} for d in combinations]),
    }
    page = calibration_page(result, ensemble, validated, outcomes, sensitivity, parameters, combinations, shipped)
    write_files(out, {**tables, REPORT: page})
    return out / REPORT


def ensemble_text(result: Calibration) -> str:
    """The ensemble as the text of its file: equal calibrations give equal text."""
    weights = result.draw.weights
    content: dict[str, Any] = {
        "schema": ENSEMBLE_SCHEMA,
        "name": result.plan.name,
        "provenance": provenance(result),
        "best": member_name(result.best),
    }
    lines = [
        "# Cars with tails that the fitted figures of the plan leave possible, each with its weight; made by",
        f"# `aerodima calibrate --plan {result.plan.name} --seed {result.plan.seed}` (read by config/ensemble.py).",
        yaml.safe_dump(content, sort_keys=False, width=116, allow_unicode=True).rstrip(),
        "members:",
    ]
    cars = result.values
    for place in result.kept:
        values = ", ".join(f"{key}: {_number(value)}" for key, value in cars[place].items())
        weight = _number(float(weights[place]))
        lines.append(f"- {{name: {member_name(place)}, weight: {weight}, values: {{{values}}}}}")
    return "\n".join(lines) + "\n"


def provenance(result: Calibration) -> dict[str, Any]:
    """How the ensemble was made, as plain data."""
    draw, check = result.draw, result.check
    return {
        "method": "surrogates of a design, importance sampling within searched windows, weights by the cars' own runs",
        "plan": f"calibration/plans/{result.plan.name}.yaml",
        "seed": result.plan.seed,
        "runs": result.runs,
        "fitted": fitted_names(result.plan),
        "cars_drawn": draw.drawn,
        "tails_of_each_car": draw.sampling.tails,
        "effective_sample_size": round(draw.effective_size, 1),
        "fine_step": {
            "step_s": check.step,
            "members": len(check.places),
            "share_of_weight_in_tailless_bracket": round(check.share, 3),
        },
        "left_at_their_value": assumed_elsewhere(result.plan),
        "versions": software_versions(),
    }


def parameter_table(result: Calibration, shipped: Shipped) -> pd.DataFrame:
    """Per parameter: prior, quantiles of the ensemble, best value, how much was learnt, and the shipped car."""
    prior, places = result.draw.prior, result.kept
    values = prior.values(result.draw.coordinates[places])
    weights = result.draw.weights[places]
    reference = _prior_sample(result)
    learnt = shrinkage(prior, values, weights, reference)
    best = prior.values(result.draw.coordinates[[result.best]])[0]
    rows = []
    for column, key in enumerate(prior.keys):
        low, median, high = weighted_quantiles(values[:, column], weights)
        rows.append(
            {
                "parameter": key,
                "prior_low": prior.ranges[column, 0],
                "prior_high": prior.ranges[column, 1],
                "low": low,
                "median": median,
                "high": high,
                "best": best[column],
                "learnt": learnt[column],
                "shipped": shipped.values[column],
                "z_shipped": shipped.z[column],
            }
        )
    return pd.DataFrame(rows)


def _prior_sample(result: Calibration) -> np.ndarray:
    """Cars of the plausible prior, equally likely (k, n)."""
    points, density = result.draw.prior.draw(PRIOR_SAMPLE, result.plan.seed)
    weights = np.exp(density - np.max(density))
    chosen = systematic_sample(weights, len(points), result.plan.seed)
    return result.draw.prior.values(points[chosen])


def _number(value: Any) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    is_bare = "e" in text and "." not in text  # YAML reads 1e-05 as a text
    return text.replace("e", ".0e", 1) if is_bare and not math.isnan(float(value)) else text
