"""Writes the reproduction report: runs, rows, table, page, replays."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from aerodima.optimisation.calibration.calibration_runs import RunStore
from aerodima.optimisation.calibration.validation import as_table, compare
from aerodima.optimisation.studies.reproduction.claims import all_rows
from aerodima.optimisation.studies.reproduction.evidence import Evidence, gather
from aerodima.optimisation.studies.reproduction.reproduction_page import reproduction_page
from aerodima.optimisation.studies.reproduction.survival_curves import PAIRS, survival_table
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.workbench.config.ensemble import Ensemble
from aerodima.workbench.metrics.published_figures import flip_bracket
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.report.report_page import write_files

PAGE, TABLE, FIGURES, SURVIVAL = "index.html", "rows.csv", "figures.csv", "survival.csv"


def write_report(
    ensemble: Ensemble,
    number: int,
    out: Path,
    engine: Engine,
    say: Callable[[str], None],
    *,
    replays: bool = True,
    force: bool = False,
    settings: tuple[str, ...] = (),
    survival: bool = False,
) -> Path:
    """Runs members drawn by weight, writes `rows.csv`, `figures.csv` and `index.html`; the path of the page.

    Args:
        number: of members; all of them if there are fewer.
        out: folder; runs that are in it are not run again.
        settings: overrides that all runs share, such as a shorter run.
        survival: also runs every tail mode at every speed of `survival.SPEEDS` and writes `survival.csv`.

    Raises:
        UserError: wrong number of members, one that is no possible car, or the folder holds runs of other parameters.
    """
    members = ensemble.drawn(number)
    for member in members:
        ensemble.scenario(member, "turn_swing")
    varied = {key for member in ensemble.members for key in member.values}
    fitted = ensemble.provenance.get("fitted", ())
    with RunStore(out, varied, force=force) as store:
        evidence = gather(members, fitted, store, engine, say, settings, PAIRS if survival else ())
    rows = all_rows(evidence)
    compared = [compare(d, evidence.rows[d.turn.tail_mode, d.turn.speed], evidence.weights) for d in evidence.data]
    shares = survival_table(evidence) if survival else None
    tables = {TABLE: pd.DataFrame([row.as_row() for row in rows]), FIGURES: as_table(compared)}
    if shares is not None:
        tables[SURVIVAL] = shares
    write_files(out, tables)
    made = _replays(ensemble, evidence, out, say, settings) if replays else {}
    write_files(out, {PAGE: reproduction_page(rows, evidence, ensemble, made, shares)})
    return out / PAGE


def _replays(
    ensemble: Ensemble, evidence: Evidence, out: Path, say: Callable[[str], None], settings: tuple[str, ...]
) -> dict[str, str]:
    """Replays of the best member: both sides of the tailless bracket, the swung tail, the held one; words -> file."""
    from aerodima.workbench.report.replay_page import write_replay_html
    from aerodima.workbench.simulate.simulation import simulate

    none, swing = flip_bracket("tailless"), flip_bracket("tailed")
    shown = (
        ("none", none.survived),
        ("none", none.flipped),
        ("swing", swing.survived),
        ("held", evidence.held_speed),
    )
    made = {}
    for mode, speed in shown:
        name = f"replay_{mode}_{speed:.2f}.html"
        say(f"{name} ...")
        overrides = [f"manoeuvre.speed={speed!r}", *settings]
        scenario = ensemble.scenario(ensemble.best, f"turn_{mode}", overrides)
        run = simulate(scenario)
        write_replay_html(run, out / name, force=True)
        made[f"tail {mode}, {speed:.2f} m/s: {metrics_of(run).outcome.result}"] = name
    return made
