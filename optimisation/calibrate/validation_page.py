"""The page of a calibration, the page of what to measure next, and the ensembles; sentences are
made of the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from matplotlib.figure import Figure as Drawing

from aerodima.optimisation.calibrate.calibration import (
    FineRuns,
    Posterior,
    emulate,
    run_fine,
    sample,
)
from aerodima.optimisation.calibrate.calibration_plan import (
    DISCREPANCY,
    ROLL_DISCREPANCY,
    CalibrationPlan,
    CarPrior,
    Turn,
    figures_of,
)
from aerodima.optimisation.calibrate.surrogate import Surrogate
from aerodima.optimisation.calibrate.validation import (
    BAND,
    LeftOut,
    Question,
    brier,
    combinations,
    information,
    measurements,
    perfect_model,
    predictions,
    rigid,
)
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.metrics.published_values import Platform
from aerodima.workbench.scenario.ensemble import ENSEMBLE_SCHEMA
from aerodima.workbench.view.figure_style import BLUE, GREY, VERMILION, new_figure, styled
from aerodima.workbench.view.report_page import (
    Content,
    Finding,
    Link,
    Page,
    Plot,
    Section,
    Table,
    write_files,
)

PAGE = "index.html"
MEASURE = "measure_next.html"
FIELD_TABLES = ("Table 7.3", "Table 7.4")
OF_A_CAR = ("controller.trigger_yaw_rate", "tail.roll_stop")
"""Settings of a run that belong to the car, not to its drive."""
FINAL = 3
"""How many times as long as for a table that is left out the sampler runs for the posterior of all
figures."""
SOON = 0.3
"""s after the steering command."""
NEAR_A_BOUND = 0.05
"""Share of a prior's range: a median nearer to its end says that the prior decides."""


@dataclass(frozen=True)
class Result:
    """Everything that the pages say.

    Attributes:
        emulator: what every turn shows, for any car.
        posterior: given every figure.
        left_out: every table, predicted from the others.
        rigid_density: logarithm of the density of the last table with the stiffest tyres, given the
            others.
        perfect: share inside the intervals when posterior cars play the thesis.
        fine: cars of the ensemble, run with the full car at the fine step.
    """

    emulator: Surrogate
    posterior: Posterior
    left_out: Sequence[LeftOut]
    rigid_density: float
    perfect: float
    fine: FineRuns


def require_extra() -> None:
    """Raises UserError when a library of the extra `calibration` is missing."""
    for library in ("emcee", "sklearn"):
        if find_spec(library) is None:
            raise UserError(
                f"{library} is not installed; pip install 'aerodima-workbench[calibration]'"
            )


def calibrate(plan: CalibrationPlan, runs: CachedRunner, out: Path, played: int) -> Path:
    """Carries out a plan and writes its pages; runs that are kept are not made again.

    Returns the path of the page.

    Args:
        plan: to be carried out.
        runs: through which everything is run; they keep what is finished.
        out: folder.
        played: how many posterior cars play the thesis.

    Raises:
        UserError: too few cars flip or survive in a turn of the plan.
    """
    emulator = emulate(plan, runs)
    seed = plan.seed
    say = runs.say
    figures = figures_of(plan)
    tables = tuple(turn.table for turn in plan.turns if turn.table)
    say("posterior of the cars ...")
    posterior = sample(emulator, figures, seed, steps=FINAL * plan.size.steps)
    say(f"effective sample size {posterior.size:.0f}")
    asked = [Question(emulator, figures, table, seed) for table in tables]
    asked.append(asked[-1]._replace(prior=rigid(emulator.prior)))
    runs.stage = "tables from the others"
    *left_out, stiff = predictions(asked, runs)
    if played:
        perfect = perfect_model(emulator, posterior, tables[-2:], played, seed, runs)
    else:
        perfect = np.nan
    fine = run_fine(plan, posterior, runs)
    return write_pages(Result(emulator, posterior, left_out, stiff.density, perfect, fine), out)


def write_pages(result: Result, out: Path) -> Path:
    """Writes both pages, their tables and an ensemble per system into a folder; the path of the
    first page.
    """
    prior = result.emulator.prior
    cars = result.posterior.cars
    figures = pd.concat([left.rows for left in result.left_out], ignore_index=True)
    systems = dict.fromkeys(turn.system for turn in prior.plan.turns)
    ensembles = {f"{system}.yaml": ensemble_text(result, system) for system in systems}
    parameters = parameter_table(prior, cars)
    measured = measure_table(prior, cars)
    posterior = pd.DataFrame(cars, columns=prior.names)
    contents: dict[str, Content] = {
        **ensembles,
        "figures.csv": figures,
        "parameters.csv": parameters,
        "measure_next.csv": measured,
        "posterior.parquet": posterior,
        PAGE: validation_page(result, figures, parameters),
        MEASURE: measure_page(measured),
    }
    write_files(out, contents)
    return out / PAGE


def validation_page(result: Result, figures: pd.DataFrame, parameters: pd.DataFrame) -> Page:
    """Makes the page of what the calibration predicts, and how far to trust it."""
    prior = result.emulator.prior
    cars = result.posterior.cars
    plan = prior.plan
    score, chances = brier(result.emulator, cars)
    outcomes = []
    for turn in plan.turns:
        planned = (turn.system, turn.tail, f"{turn.speed:g}", turn.ends)
        outcomes.append((*planned, f"{chances[turn.name]:.2f}", *_fine_cells(result, turn)))
    densities = []
    for left in result.left_out:
        values = (left.density, left.prior_density, left.constant_density)
        densities.append((left.table, *(f"{value:.1f}" for value in values)))
    known = []
    for ratio, weights in combinations(prior, cars, plan.seed):
        terms = [f"{weight:+.2f} {name}" for name, weight in weights.items()]
        known.append((f"{ratio:.3f}", ", ".join(terms)))
    drawn = Plot(
        _forest(figures),
        "Bars: 90 % intervals and medians, over the published figure (red line). Grey: those of "
        "the prior's survivors.",
        "Predicted over published figures",
        "figures",
    )
    reasons = [f"{name.replace('_', ' ')} ({why})" for name, why in plan.left_out.items()]
    missing = "; ".join(reasons) or "none"
    last = result.left_out[-1]
    before = (
        "With the stiffest tyres of the prior and without latency, bias and delay, "
        f"{last.table} has {result.rigid_density:.1f}; now it has {last.density:.1f}."
    )
    of_outcomes = (
        "system",
        "tail",
        "m/s",
        "published",
        "probability to survive",
        "survived at the fine step",
    )
    of_parameters = ("parameter", "prior", "5 %", "median", "95 %", "deviation over the prior's")
    rows = [_parameter_cells(row) for row in parameters.to_dict("records")]
    near_a_bound = np.flatnonzero(parameters.near_a_bound).tolist()
    heads = ("table", "from the others", "of the prior", "of constant values")
    return Page(
        "What the calibrated cars predict",
        "The simulated car of the thesis and its car on the field are two systems that share a "
        "body. Every figure is "
        "predicted by cars that have not seen its table.",
        [
            Section("Result", [Finding(_findings(result, figures, parameters, score)), drawn]),
            Section(
                "Published figures",
                [_figure_table(figures), f"No car of the prior reaches these: {missing}."],
            ),
            Section(
                "Logarithm of the density of each table",
                [Table(heads, densities), before],
            ),
            Section("Outcomes", [Table((*of_outcomes, "trigger [s]", "within 0.3 s"), outcomes)]),
            Section(
                "Parameters",
                [Table(of_parameters, rows, near_a_bound)],
            ),
            Section(
                "What the data determine best",
                [Table(("variance over the prior's", "combination"), known)],
            ),
            Section(
                "What to measure next",
                [Link(MEASURE, "Measurements in the order of their information")],
            ),
        ],
    )


def _findings(
    result: Result, figures: pd.DataFrame, parameters: pd.DataFrame, score: float
) -> list[str]:
    plan = result.emulator.prior.plan
    prior = result.emulator.prior
    of_the_field = figures[figures.figure.str.startswith(FIELD_TABLES)]
    missing = sum(name.startswith(FIELD_TABLES) for name in plan.left_out)
    posterior = result.posterior
    off = np.quantile(posterior.cars[:, prior.column(DISCREPANCY)], BAND)
    off_roll = np.quantile(posterior.cars[:, prior.column(ROLL_DISCREPANCY)], BAND)
    played = []
    if not np.isnan(result.perfect):
        played.append(
            f"When posterior cars play the thesis, {result.perfect:.0%} of the figures lie in "
            "their intervals."
        )
    of_the_prior = of_the_field.prior_high - of_the_field.prior_low
    widths = (of_the_field.high - of_the_field.low) / of_the_prior
    held = ", ".join(parameters[parameters.near_a_bound].parameter)
    if held:
        near_a_bound = f"These medians lie near the end of their prior: {held}."
    else:
        near_a_bound = "No median lies near the end of its prior."
    return [
        f"Of {len(of_the_field) + missing} figures of the car on the field "
        f"{int(of_the_field.inside.sum())} lie in "
        f"their 90 % interval, each predicted without its own table; {missing} that no car "
        "reaches counts as a miss.",
        f"The discrepancy of the model is {off[1]:.0%} of a rate or an acceleration (90 %: "
        f"{off[0]:.0%} to "
        f"{off[2]:.0%}) and {off_roll[1]:.0%} of a roll integral ({off_roll[0]:.0%} to "
        f"{off_roll[2]:.0%}).",
        f"The Brier score of the {len(plan.turns)} outcomes, to which the cars are held, is "
        f"{score:.3f}.",
        *played,
        f"These intervals are {np.median(widths):.0%} as wide as those of the prior alone "
        "(median).",
        f"The effective sample size is {posterior.size:.0f}; the chains are "
        f"{posterior.length:.0f} "
        "autocorrelation times long.",
        near_a_bound,
    ]


def _figure_table(figures: pd.DataFrame) -> Table:
    names = ("figure", "published", "median", "90 % interval", "of the prior", "inside")
    marked = [index for index, inside in enumerate(figures.inside) if not inside]
    return Table(names, [_figure_cells(row) for row in figures.to_dict("records")], marked)


def measure_page(measured: pd.DataFrame) -> Page:
    """Makes the page of measurements of the real car, most informative first, with their
    procedures.
    """
    rows = [
        (row["quantity"], row["procedure"], f"{row['gain_nats']:.2f}")
        for row in measured.to_dict("records")
    ]
    quantity, _, gain = rows[0]
    lead = (
        f"Measure the {quantity} first: it is expected to tell {gain} nats beyond the "
        "published figures."
    )
    table = Table(("quantity", "procedure", "expected gain [nats]"), rows)
    return Page("What to measure next", lead, [Section("Measurements", [table])])


def measure_table(prior: CarPrior, cars: FloatArray) -> pd.DataFrame:
    """Computes the gain of every measurement in nats, largest first."""
    names = ["quantity", "procedure", "deviation", "gain_nats"]
    rows = []
    for m in measurements(prior):
        gain = information(m, cars, prior.plan.seed)
        rows.append((m.name, m.how, m.deviation, gain))
    table = pd.DataFrame(rows, columns=names)
    return table.sort_values("gain_nats", ascending=False, ignore_index=True)


def parameter_table(prior: CarPrior, cars: FloatArray) -> pd.DataFrame:
    """Computes per coordinate: prior, quantiles, deviation over that of the prior, and whether its
    median is near an end.
    """
    reference = prior.draw(2000, prior.plan.seed)
    rows = []
    for index, name in enumerate(prior.names):
        values = cars[:, index]
        low, median, high = np.quantile(values, BAND)
        first, last = prior.ranges[index]
        share = (median - first) / (last - first)
        near = name != "forward" and min(share, 1.0 - share) < NEAR_A_BOUND
        learnt = float(np.std(values) / np.std(reference[:, index]))
        rows.append((name, first, last, low, median, high, learnt, near))
    names = [
        "parameter",
        "prior_low",
        "prior_high",
        "low",
        "median",
        "high",
        "deviation_ratio",
        "near_a_bound",
    ]
    return pd.DataFrame(rows, columns=names)


def ensemble_text(result: Result, system: Platform) -> str:
    """Returns the cars of the fine runs in one system as the text of an ensemble file, equally
    likely.
    """
    prior = result.emulator.prior
    plan = prior.plan
    cars = result.fine.cars
    keys = {*plan.body, *plan.each}
    first = next(turn for turn in plan.turns if turn.system == system)
    scaled = prior.scaled(cars)
    standard = (scaled - scaled.mean(axis=0)) / (scaled.std(axis=0) + 1e-9)
    distances = np.sum(standard**2, axis=1)
    middle = int(np.argmin(distances))
    content: dict[str, Any] = {
        "schema": ENSEMBLE_SCHEMA,
        "name": system,
        "provenance": {
            "method": f"posterior cars of the {system} system, given Tables 7.1 to 7.4 and the "
            "published outcomes",
            "plan": plan.name,
            "seed": plan.seed,
            "effective_sample_size": round(result.posterior.size, 1),
            "fine_step_s": plan.size.fine_step,
            "versions": software_versions(),
        },
        "best": f"car{middle:03d}",
    }
    lines = [
        "# Cars that the published figures leave possible, made by `aerodima calibrate --plan "
        f"{plan.name}`.",
        yaml.safe_dump(content, sort_keys=False, width=116).rstrip(),
        "members:",
    ]
    weight = 1 / len(cars)
    for index, car in enumerate(cars):
        settings = dict(setting.split("=") for setting in prior.settings(car, first))
        values = ", ".join(
            f"{key}: {value}" for key, value in settings.items() if key in OF_A_CAR or key in keys
        )
        lines.append(f"- {{name: car{index:03d}, weight: {weight:.6g}, values: {{{values}}}}}")
    return "\n".join(lines) + "\n"


def _fine_cells(result: Result, turn: Turn) -> tuple[str, str, str]:
    """Returns how many of the fine runs survived, when the swing of the median begins, and the
    share of early swings.
    """
    rows = [row for row in result.fine.rows[turn.name] if "error" not in row]
    survived = f"{sum(row['survived'] for row in rows)} of {len(rows)}"
    if turn.tail != "swing":
        return survived, "-", "-"
    started = np.array([np.inf if row["trigger"] is None else row["trigger"] for row in rows])
    middle = np.median(started)
    begins = f"{middle:.2f}" if np.isfinite(middle) else "never"
    early = np.mean(started <= SOON)
    return survived, begins, f"{early:.0%}"


def _figure_cells(row: Mapping[Any, Any]) -> tuple[str, ...]:
    return (
        row["figure"].replace("_", " "),
        f"{row['published']:.3g}",
        f"{row['median']:.3g}",
        f"{row['low']:.3g} to {row['high']:.3g}",
        f"{row['prior_low']:.3g} to {row['prior_high']:.3g}",
        "yes" if row["inside"] else "no",
    )


def _parameter_cells(row: Mapping[Any, Any]) -> tuple[str, ...]:
    return (
        row["parameter"],
        f"{row['prior_low']:.3g} to {row['prior_high']:.3g}",
        *(f"{row[name]:.3g}" for name in ("low", "median", "high", "deviation_ratio")),
    )


def _forest(figures: pd.DataFrame) -> Drawing:
    with styled():
        drawing, axes = new_figure(9.0, 5.2)
        axis = axes[0, 0]
        places = np.arange(len(figures))[::-1]
        scale = figures.published.to_numpy()
        axis.hlines(
            places, figures.prior_low / scale, figures.prior_high / scale, color=GREY, linewidth=1
        )
        axis.hlines(places, figures.low / scale, figures.high / scale, color=BLUE, linewidth=5)
        axis.plot(figures["median"] / scale, places, "|", color="white", markersize=8)
        axis.axvline(1.0, color=VERMILION)
        axis.set_yticks(places, [name.replace("_", " ") for name in figures.figure], fontsize=8)
        axis.set_xlim(0.0, 3.0)
        axis.set_xlabel("predicted over published")
    return drawing
