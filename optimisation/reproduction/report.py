"""Writes the reproduction report: runs, rows, table, page, replays."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from optimisation.calibration.plan import CALIBRATED_METRICS
from optimisation.calibration.runs import RunStore
from optimisation.calibration.validation import start_settings
from optimisation.reproduction.claims import all_rows
from optimisation.reproduction.evidence import Evidence, gather
from optimisation.reproduction.page import reproduction_page
from optimisation.sweep.engine import Engine
from workbench.atomic_write import write_atomically
from workbench.ensemble import Ensemble
from workbench.errors import UserError
from workbench.published import flip_bracket
from workbench.scenario import load_scenario

PAGE, TABLE = "index.html", "rows.csv"


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
) -> Path:
    """Runs members drawn by weight, writes `rows.csv` and `index.html`; the path of the page.

    Args:
        number: of members; all of them if there are fewer.
        out: folder; runs that are in it are not run again.
        settings: overrides that all runs share, such as a shorter run.

    Raises:
        UserError: wrong number of members, one that is no possible car, or the folder holds runs of other parameters.
    """
    members = ensemble.drawn(number)
    for member in members:
        ensemble.scenario(member, "turn_swing")
    varied = {key for member in ensemble.members for key in member.values}
    store = RunStore(out, load_scenario("turn_none"), varied, force=force)
    evidence = gather(members, store, engine, say, settings)
    calibrated = frozenset(CALIBRATED_METRICS if "targets" in ensemble.provenance else ())
    targets = ensemble.provenance.get("targets", {})
    rows = all_rows(evidence, calibrated, "calibrated to" if targets.get("tailed_is_met") else "prediction")
    frame = pd.DataFrame([row.as_row() for row in rows])
    write_atomically(out / TABLE, lambda path: frame.to_csv(path, index=False, lineterminator="\n"), True, UserError)
    made = _replays(ensemble, evidence, out, say, settings) if replays else {}
    page = reproduction_page(rows, evidence, ensemble, made)

    def write(path: Path) -> None:
        path.write_text(page, encoding="utf-8")

    return write_atomically(out / PAGE, write, True, UserError)


def _replays(
    ensemble: Ensemble, evidence: Evidence, out: Path, say: Callable[[str], None], settings: tuple[str, ...]
) -> dict[str, str]:
    """Replays of the best member: both sides of the tailless bracket, the swung tail, the held one; words -> file."""
    from workbench.replay.page import write_replay_html
    from workbench.trial import run_trial

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
        overrides = [f"manoeuvre.speed={speed!r}", *start_settings(speed), *settings]
        scenario = ensemble.scenario(ensemble.best, f"turn_{mode}", overrides)
        trial = run_trial(scenario, signals="all", stop_when_flipped=False)
        write_replay_html(trial.run_log, out / name, force=True)
        made[f"tail {mode}, {speed:.2f} m/s: {trial.summary.metrics.outcome.result}"] = name
    return made
