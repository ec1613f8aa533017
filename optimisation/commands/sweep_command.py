"""`aerodima sweep ...`: studies of many runs, here or on a cluster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from aerodima.workbench.cli.help_sections import SWINGS
from aerodima.workbench.cli.options import Members, Settings, WorkOptions, grouped

Out = Annotated[Path, typer.Option(help="Folder for tables, plots and index.html; a stopped study goes on in it.")]
STUDIES = {
    "turn": "Speed x tail mode x tail speed: 20 runs without tail, 48 with it (thesis Figures 7.8 and 7.10 to 7.13).",
    "tail": "What tail is worth building: critical friction over its length, width, mass and C_N; inertial tails "
    "beside.",
    "mount": "The yaw penalty of a swing, and its remedies: place of the tail, ballast in front, longer steering "
    "(Figure 7.9).",
    "trigger": "When the swing should begin: yaw rate, lateral acceleration or delayed steering; delay and travel "
    "(6.3.4).",
}
"""Studies without options of their own, and what they say of themselves."""


@dataclass(frozen=True)
class CaseOptions:
    """Of which car the runs of a study are."""

    settings: Settings = None
    ensemble: Annotated[
        str | None, typer.Option(help="Run every case for the members of this ensemble, such as car.")
    ] = None
    members: Members = None


def register(app: typer.Typer) -> None:
    """Adds the group `sweep`."""
    group = typer.Typer(no_args_is_help=True, help="Run studies of many runs, on this computer or a cluster.")
    group.callback()(_group)
    group.command("run")(run)
    for name, about in STUDIES.items():
        group.command(name, help=f"{about}\n\nExample: aerodima sweep {name} --out sweeps/{name}")(_command(name))
    group.command()(shapes)
    group.command("monte-carlo")(monte_carlo)
    app.add_typer(group, name="sweep", rich_help_panel=SWINGS)


def _group() -> None:
    """Run studies of many runs, on this computer or a cluster; each can be stopped and goes on when asked again."""


@grouped
def run(
    study: Annotated[Path, typer.Argument(help="Study file (YAML): scenario with grid and sampled factors.")],
    out: Out,
    work: WorkOptions,
) -> None:
    """Run a study file; one row per run in table.parquet and table.csv.

    Example: aerodima sweep run study.yaml --out sweeps/study
    """
    from aerodima.optimisation.sweep.run_study import TABLE, run_study
    from aerodima.optimisation.sweep.study import load_study, plan_runs
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.progress import terminal

    loaded = load_study(study)
    plan_runs(loaded)
    say = terminal()
    with open_engine(work.workers, work.scheduler, say=say, record=out / WORKER_RECORD) as engine:
        run_study(loaded, out, engine, force=work.force, say=say)
    print(f"table: {out / TABLE}")


def _command(name: str) -> Callable[..., None]:
    @grouped
    def command(out: Out, cases: CaseOptions, work: WorkOptions) -> None:
        _report(name, out, cases, work)

    return command


@grouped
def shapes(
    out: Out,
    cases: CaseOptions,
    work: WorkOptions,
    goals: Annotated[
        Path | None, typer.Argument(help="CFD goal table (CSV): shape, speed, angle, and C_D and C_L, or forces.")
    ] = None,
) -> None:
    """Sail shapes compared: drag and lift, the tunnel's coefficients beside, and what each does for the car.

    Without a table the drag coefficients of the thesis' Table 2.1 are taken.

    Example: aerodima sweep shapes goals.csv --out sweeps/shapes
    """
    _report("shapes", out, cases, work, goals=goals)


@grouped
def monte_carlo(
    out: Out,
    cases: CaseOptions,
    work: WorkOptions,
    samples: Annotated[int, typer.Option(help="Per tail mode; a power of 2 is best.", min=1)] = 32,
    seed: Annotated[int, typer.Option(help="Of the samples.", min=0)] = 1,
) -> None:
    """Rollover probability under uncertain friction, speed and trigger noise, with its interval.

    Example: aerodima sweep monte-carlo --samples 32 --out sweeps/monte-carlo
    """
    _report("monte-carlo", out, cases, work, samples=samples, seed=seed)


def _report(name: str, out: Path, cases: CaseOptions, work: WorkOptions, **own: Any) -> None:
    from aerodima.optimisation.studies.named_studies import named_study
    from aerodima.optimisation.studies.study_report import make_report
    from aerodima.optimisation.sweep.study import check_factors, plan_runs
    from aerodima.optimisation.sweep.study_engine import open_engine
    from aerodima.workbench.batch import WORKER_RECORD
    from aerodima.workbench.batch.progress import terminal

    study, read = named_study(name, cases.settings or (), cases.ensemble, cases.members, **own)
    check_factors(study, "--set")
    plan_runs(study)
    say = terminal()
    with open_engine(work.workers, work.scheduler, say=say, record=out / WORKER_RECORD) as engine:
        page = make_report(study, read, out, engine, force=work.force, say=say)
    print(f"report: {page}")
