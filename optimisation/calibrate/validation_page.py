"""The page of a calibration and the page of what to measure next; their sentences are made from the
result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Drawing

from aerodima.optimisation.calibrate.calibration import (
    FineRuns,
    Posterior,
    fit_surrogate,
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
from aerodima.optimisation.calibrate.posterior_ensemble import ensemble_text
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
from aerodima.workbench.batch.row_store import Row
from aerodima.workbench.core.array_types import FloatArray, Values
from aerodima.workbench.core.resources import model_path
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
FINAL = 3
"""Ratio of the steps of the sampler for the posterior of all figures to those for a table that is
left out."""
SOON = 0.3
"""Time after the steering command within which a swing is early, s."""
NEAR_A_BOUND = 0.1
"""Share of a prior's range that counts as near its end."""
MAX_AT_A_BOUND = 0.15
"""Share of the cars near one end above which the prior decides; an even spread has 0.1."""
LEAD = (
    "The simulated car of the thesis and its car on the field are two systems that share a body. "
    "Every figure is predicted by cars that have not seen its table."
)
INTERVALS = (
    "Bars: 90 % intervals and medians, over the published figure (red line). Grey: those of "
    "the prior's survivors."
)
FIGURE_COLUMNS = {
    "figure": "{figure}",
    "published": "{published:.3g}",
    "median": "{median:.3g}",
    "90 % interval": "{low:.3g} to {high:.3g}",
    "of the prior": "{prior_low:.3g} to {prior_high:.3g}",
    "inside": "{inside}",
}
"""Formats of a row of the published figures, by heading."""
PARAMETER_COLUMNS = {
    "parameter": "{parameter}",
    "prior": "{prior_low:.3g} to {prior_high:.3g}",
    "5 %": "{low:.3g}",
    "median": "{median:.3g}",
    "95 %": "{high:.3g}",
    "deviation over the prior's": "{deviation_ratio:.3g}",
    "cars near one end": "{share_at_a_bound:.0%}",
}
"""Formats of a row of the parameters, by heading."""
MEASURE_COLUMNS = {
    "quantity": "{quantity}",
    "procedure": "{procedure}",
    "expected gain [nats]": "{gain_nats:.2f}",
}
"""Formats of a row of the measurements, by heading."""
PART_COLUMNS = {
    "part": "{part}",
    "mass [kg]": "{mass_kg:g}",
    "range [kg]": "{min_mass_kg:g} to {max_mass_kg:g}",
    "x [m]": "{x_m:.3f}",
    "z [m]": "{z_m:.3f}",
    "source": "{source}",
}
"""Formats of a row of the parts, by heading."""
DENSITY_COLUMNS = {
    "table": "{table}",
    "from the others": "{density:.1f}",
    "of the prior": "{prior_density:.1f}",
    "of constant values": "{constant_density:.1f}",
}
"""Formats of a row of the densities, by heading."""
OUTCOME_COLUMNS = {
    "system": "{system}",
    "tail": "{tail}",
    "m/s": "{speed:g}",
    "published": "{ends}",
    "probability to survive": "{chance:.2f}",
    "survived at the fine step": "{survived}",
    "trigger [s]": "{trigger}",
    "within 0.3 s": "{early}",
}
"""Formats of a row of the outcomes, by heading."""


@dataclass(frozen=True)
class Result:
    """Everything that the pages say.

    Attributes:
        surrogate: figures and flips of every turn, for any car.
        posterior: cars of the posterior given every figure.
        left_out: prediction of every table from the others.
        rigid_density: logarithm of the density of the last table with the stiffest tyres, given the
            others.
        perfect: share of figures inside their intervals when posterior cars play the thesis; NaN
            when none does.
        fine: cars of the ensemble, run with the full car at the fine step.
    """

    surrogate: Surrogate
    posterior: Posterior
    left_out: Sequence[LeftOut]
    rigid_density: float
    perfect: float
    fine: FineRuns


def calibrate(plan: CalibrationPlan, runs: CachedRunner, out: Path, played: int) -> Path:
    """Carries out a plan and writes its pages; runs that are kept are not made again.

    Returns the path of the page.

    Args:
        plan: plan that is carried out.
        runs: runner of all work, which keeps finished runs.
        out: folder of the pages, their tables and the ensembles.
        played: number of posterior cars that play the thesis.

    Raises:
        UserError: too few cars flip or survive in a turn of the plan.
    """
    surrogate = fit_surrogate(plan, runs)
    seed = plan.seed
    figures = figures_of(plan)
    tables = tuple(turn.table for turn in plan.turns if turn.table)
    runs.say("posterior of the cars ...")
    posterior = sample(surrogate, figures, seed, steps=FINAL * plan.size.steps)
    runs.say(f"effective sample size {posterior.size:.0f}")
    asked = [Question(surrogate, figures, table, seed) for table in tables]
    asked.append(asked[-1]._replace(prior=rigid(surrogate.prior)))
    runs.stage = "tables from the others"
    *left_out, stiff = predictions(asked, runs)
    perfect = np.nan
    if played:
        perfect = perfect_model(surrogate, posterior, tables[-2:], played, seed, runs)
    fine = run_fine(plan, posterior, runs)
    return write_pages(Result(surrogate, posterior, left_out, stiff.density, perfect, fine), out)


def write_pages(result: Result, out: Path) -> Path:
    """Writes both pages, their tables and an ensemble per system into a folder; returns the path of
    the first page.
    """
    prior = result.surrogate.prior
    cars = result.posterior.cars
    figures = pd.DataFrame([row for left in result.left_out for row in left.rows])
    systems = dict.fromkeys(turn.system for turn in prior.plan.turns)
    contents: dict[str, Content] = {
        f"{system}.yaml": ensemble_text(prior, result.fine, system, result.posterior.size)
        for system in systems
    }
    parameters = parameter_table(prior, cars)
    measured = measure_table(prior, cars)
    score, chances = brier(result.surrogate, cars)
    outcomes = outcome_table(result, chances)
    contents |= {
        "figures.csv": figures,
        "outcomes.csv": outcomes,
        "parameters.csv": parameters,
        "measure_next.csv": measured,
        "posterior.parquet": pd.DataFrame(cars, columns=prior.names),
        PAGE: validation_page(result, figures, outcomes, parameters, score),
        MEASURE: measure_page(measured),
    }
    write_files(out, contents)
    return out / PAGE


def validation_page(
    result: Result,
    figures: pd.DataFrame,
    outcomes: pd.DataFrame,
    parameters: pd.DataFrame,
    score: float,
) -> Page:
    """Makes the page of what the calibration predicts, with the Brier score of the outcomes."""
    plan = result.surrogate.prior.plan
    reasons = [f"{name.replace('_', ' ')} ({why})" for name, why in plan.left_out.items()]
    missing = f"No car of the prior reaches these: {'; '.join(reasons) or 'none'}."
    intervals = Plot(_forest(figures), INTERVALS, "Predicted over published figures", "figures")
    misses = np.flatnonzero(~figures.inside).tolist()
    shown = figures.assign(
        figure=figures.figure.str.replace("_", " "),
        inside=figures.inside.map({True: "yes", False: "no"}),
    )
    near_a_bound = np.flatnonzero(parameters.near_a_bound).tolist()
    link = Link(MEASURE, "Measurements in the order of their information")
    contents: dict[str, list[Any]] = {
        "Result": [Finding(_findings(result, figures, parameters, score)), intervals],
        "Published figures": [_table(shown, FIGURE_COLUMNS, misses), missing],
        "Logarithm of the density of each table": _densities(result),
        "Outcomes": [_table(outcomes, OUTCOME_COLUMNS)],
        "Parameters": [_table(parameters, PARAMETER_COLUMNS, near_a_bound)],
        "Parts": _parts(parameters),
        "What the data determine best": [_combinations(result)],
        "What to measure next": [link],
    }
    sections = [Section(title, parts) for title, parts in contents.items()]
    return Page("What the calibrated cars predict", LEAD, sections)


def _table(frame: pd.DataFrame, columns: Mapping[str, str], marked: Sequence[int] = ()) -> Table:
    """Makes a table whose columns are headings and formats of a row of the frame."""
    records: Any = frame.to_dict("records")
    rows = [[words.format(**row) for words in columns.values()] for row in records]
    return Table(list(columns), rows, marked)


def _densities(result: Result) -> list[Any]:
    """Returns the table of the densities of left-out tables, and a sentence on rigid tyres."""
    densities = pd.DataFrame([vars(left) for left in result.left_out])
    last = result.left_out[-1]
    rigid_words = (
        "With the stiffest tyres of the prior and without latency, bias and delay, "
        f"{last.table} has {result.rigid_density:.1f}; now it has {last.density:.1f}."
    )
    return [_table(densities, DENSITY_COLUMNS), rigid_words]


def outcome_table(result: Result, chances: Values) -> pd.DataFrame:
    """Lists how each turn ended in print, the probability to survive it by the surrogate, and the
    fine runs.
    """
    rows = [
        turn.model_dump()
        | {"chance": chances[turn.name]}
        | _fine_runs(result.fine.rows[turn.name], turn)
        for turn in result.surrogate.prior.plan.turns
    ]
    return pd.DataFrame(rows)


def _fine_runs(rows: Sequence[Row], turn: Turn) -> dict[str, str]:
    """Returns how many of the fine runs survived, when the swing of the median begins, and the
    share of early swings.
    """
    made = [row for row in rows if "error" not in row]
    survived = sum(row["survived"] for row in made)
    words = {"survived": f"{survived} of {len(made)}", "trigger": "-", "early": "-"}
    if turn.tail == "swing":
        started = np.array([np.inf if row["trigger"] is None else row["trigger"] for row in made])
        middle = np.median(started)
        words["trigger"] = f"{middle:.2f}" if np.isfinite(middle) else "never"
        words["early"] = f"{np.mean(started <= SOON):.0%}"
    return words


def _parts(parameters: pd.DataFrame) -> list[Any]:
    """Compares the parts of the car with the calibrated cars, in a sentence and a table."""
    parts = pd.read_csv(model_path("calibration/parts.csv"))
    cars = parameters.set_index("parameter")
    masses, x, z = parts[["mass_kg", "x_m", "z_m"]].to_numpy(float).T
    mass = masses.sum()
    pairs = (
        ("car.mass", "mass", mass, "kg"),
        ("car.com_x", "x of the centre of mass", masses @ x / mass, "m"),
        ("car.com_height", "height of the centre of mass", masses @ z / mass, "m"),
    )
    words = []
    for key, name, value, unit in pairs:
        low, high = cars.loc[key, ["low", "high"]].to_numpy()
        words.append(
            f"{name} {value:.3g} {unit} by the parts, {low:.3g} to {high:.3g} {unit} by the cars "
            "(90 %)"
        )
    return [f"{'; '.join(words)}.", _table(parts, PART_COLUMNS)]


def _combinations(result: Result) -> Table:
    prior = result.surrogate.prior
    rows = [
        (f"{ratio:.3f}", ", ".join(f"{weight:+.2f} {name}" for name, weight in weights.items()))
        for ratio, weights in combinations(prior, result.posterior.cars, prior.plan.seed)
    ]
    return Table(("variance over the prior's", "combination"), rows)


def _findings(
    result: Result, figures: pd.DataFrame, parameters: pd.DataFrame, score: float
) -> list[str]:
    plan = result.surrogate.prior.plan
    posterior = result.posterior
    field = figures[figures.figure.str.startswith(FIELD_TABLES)]
    missing = sum(name.startswith(FIELD_TABLES) for name in plan.left_out)
    bands = parameters.set_index("parameter")[["low", "median", "high"]]
    low, median, high = bands.loc[DISCREPANCY]
    roll_low, roll, roll_high = bands.loc[ROLL_DISCREPANCY]
    widths = (field.high - field.low) / (field.prior_high - field.prior_low)
    near = ", ".join(parameters[parameters.near_a_bound].parameter)
    sentences = [
        f"Of {len(field) + missing} figures of the car on the field {field.inside.sum()} lie "
        f"in their 90 % interval, each predicted without its own table; {missing} that no car "
        "reaches counts as a miss.",
        f"The discrepancy of the model is {median:.0%} of a rate or an acceleration (90 %: "
        f"{low:.0%} to {high:.0%}) and {roll:.0%} of a roll integral ({roll_low:.0%} to "
        f"{roll_high:.0%}).",
        f"The Brier score of the {len(plan.turns)} outcomes, which the cars are fitted to, is "
        f"{score:.3f}.",
        f"These intervals are {np.median(widths):.0%} as wide as those of the prior alone "
        "(median).",
        f"The effective sample size is {posterior.size:.0f}; the chains are "
        f"{posterior.length:.0f} autocorrelation times long.",
        f"In no parameter do more than {MAX_AT_A_BOUND:.0%} of the cars lie near one end.",
    ]
    if near:
        sentences[-1] = f"The prior's end decides: {near}."
    if not np.isnan(result.perfect):
        sentences.insert(
            3,
            f"When posterior cars play the thesis, {result.perfect:.0%} of the figures lie in "
            "their intervals.",
        )
    return sentences


def measure_page(measured: pd.DataFrame) -> Page:
    """Makes the page of measurements of the real car, most informative first, with their
    procedures.
    """
    first = measured.iloc[0]
    lead = (
        f"Measure the {first.quantity} first: it is expected to tell {first.gain_nats:.2f} nats "
        "beyond the published figures."
    )
    table = _table(measured, MEASURE_COLUMNS)
    return Page("What to measure next", lead, [Section("Measurements", [table])])


def measure_table(prior: CarPrior, cars: FloatArray) -> pd.DataFrame:
    """Computes the gain of every measurement in nats, largest first."""
    seed = prior.plan.seed
    rows = [
        (one.name, one.how, one.deviation, information(one, cars, seed))
        for one in measurements(prior)
    ]
    table = pd.DataFrame(rows, columns=["quantity", "procedure", "deviation", "gain_nats"])
    return table.sort_values("gain_nats", ascending=False, ignore_index=True)


def parameter_table(prior: CarPrior, cars: FloatArray) -> pd.DataFrame:
    """Computes the prior of each coordinate, quantiles of the cars, their deviation over that of
    the prior, the larger share of them near one end, and whether the prior decides.
    """
    reference = prior.draw(2000, prior.plan.seed)
    first, last = prior.ranges.T
    low, median, high = np.quantile(cars, BAND, axis=0)
    places = (cars - first) / (last - first)
    near_low = np.mean(places < NEAR_A_BOUND, axis=0)
    at_a_bound = np.maximum(near_low, np.mean(places > 1.0 - NEAR_A_BOUND, axis=0))
    is_switch = np.array(prior.names) == "forward"
    return pd.DataFrame(
        {
            "parameter": prior.names,
            "prior_low": first,
            "prior_high": last,
            "low": low,
            "median": median,
            "high": high,
            "deviation_ratio": np.std(cars, axis=0) / np.std(reference, axis=0),
            "share_at_a_bound": at_a_bound,
            "near_a_bound": ~is_switch & (at_a_bound > MAX_AT_A_BOUND),
        }
    )


@styled()
def _forest(figures: pd.DataFrame) -> Drawing:
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
