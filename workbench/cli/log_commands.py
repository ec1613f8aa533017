"""Commands of the group `log`: metrics, comparison, import, conditioning, export of run logs."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerodima import workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.text_table import text_table, value_rows

if TYPE_CHECKING:
    from aerodima.workbench.logs.exporters import SceneMessage
    from aerodima.workbench.logs.schema import RunLog


def register(app: typer.Typer) -> None:
    """Add the commands."""
    group = cli.command_group(
        app, "log", "Measure, compare, import, condition and export run logs.", cli.RUNS
    )
    for command in (metrics, compare, recover, import_, export, condition):
        group.command(command.__name__.strip("_"))(command)


def metrics(
    runs: Annotated[list[Path], typer.Argument(help="Run logs (Parquet).")],
    out: Annotated[Path | None, cli.written("Also write the table (.csv).", ".csv")] = None,
    force: cli.Force = False,
) -> None:
    """Show outcome and metrics of runs, one column per run.

    The eight metrics of the thesis are there raw and `filtered_`.

    Logs that `observe` wrote of another plant have its motion, the air on its tails, and the
    outcome where defined.

    Example: aerodima log metrics none.parquet swing.parquet --out metrics.csv
    """
    from aerodima.workbench.core.key_errors import require_unique

    require_unique(runs, "run", LogError)
    run_logs = [workbench.read_run_log(path) for path in runs]
    import pandas as pd

    from aerodima.workbench.metrics.run_summary import metrics_of_runs

    table = pd.DataFrame(
        metrics_of_runs(run_logs), index=pd.Index(map(str, runs), name="run"), dtype=object
    )
    if out is not None:
        write_atomically(out, table.to_csv(), force, LogError)
    typer.echo("\n".join(text_table(["", *table.index], value_rows(table.items()))))


def recover(
    journal: Annotated[Path, typer.Argument(help="Journal of a run that was cut off (*.journal).")],
    out: Annotated[
        Path | None,
        cli.written("Run log to write (.parquet); beside the journal by default.", ".parquet"),
    ] = None,
    force: cli.Force = False,
) -> None:
    """Make a log of what a cut-off run left behind.

    Rows of damaged batches are left out; what is damaged or missing is printed, and kept in the
    log's metadata.

    Example: aerodima log recover run.parquet.journal --out run.parquet
    """
    from aerodima.workbench.logs.journal import recover as recover_journal

    recovery = recover_journal(journal, out, force=force)
    state = "none was lost" if recovery.complete else "not all is whole"
    typer.echo(f"{recovery.path}: {recovery.rows} rows recovered; {state}")
    for damage in recovery.damage:
        typer.echo(f"note: {damage}", err=True)


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="Foreign log: CSV, Parquet, MAT, MCAP or ROS bag; several files of one run."
        ),
    ],
    out: cli.LogOut,
    mapping: Annotated[Path, typer.Option(help="Mapping file (YAML): foreign names and units.")],
    force: cli.Force = False,
) -> None:
    """Make a run log of the log of another program.

    Gaps, NaN and whatever else is odd are printed, and kept in its metadata.

    Example: aerodima log import swing.csv --mapping rig.yaml --out swing.parquet

    Example: aerodima log import drive.bag --mapping ros.yaml --out drive.parquet
    """
    from aerodima.workbench.logs.importers import import_log
    from aerodima.workbench.logs.mapping import load_mapping
    from aerodima.workbench.logs.schema import write_run_log

    refuse_existing(out, force, LogError)
    imported = import_log(files, load_mapping(mapping))
    write_run_log(imported.run_log, out, force)
    run_log = imported.run_log
    typer.echo(
        f"{out}: {run_log.kind}, {len(run_log.table)} rows from {run_log.time[0]:g} to "
        f"{run_log.time[-1]:g} s, {len(run_log.table.columns)} columns"
    )
    for finding in imported.findings:
        typer.echo(f"note: {finding}", err=True)


def export(
    log: Annotated[Path, typer.Argument(help="Run log (Parquet).")],
    to: Annotated[str, cli.chosen("Format.", "csv", "mcap")],
    out: Annotated[
        Path | None, cli.written("File to write; beside the log by default.", ".csv", ".mcap")
    ] = None,
    force: cli.Force = False,
) -> None:
    """Write a run log for other programs, every number to the last bit.

    Metadata goes with it. MCAP has the signals and, of a car, the scene that Foxglove draws:
    bodies, poses and forces.

    Example: aerodima log export run.parquet --to csv
    """
    from aerodima.workbench.logs.exporters import export_log

    path = out or log.with_suffix(f".{to}")
    if path.suffix.lower() != f".{to}":
        raise LogError(f"--out {path}: ending {path.suffix!r} must be .{to} with --to {to}")
    _refuse_raw(path, log)
    refuse_existing(path, force, LogError)
    run_log = workbench.read_run_log(log)
    form: Any = to
    scene = _scene(run_log) if to == "mcap" else ()
    typer.echo("\n".join(map(str, export_log(run_log, path, form, force, scene))))


def _scene(run_log: RunLog) -> Iterable[SceneMessage]:
    """Make the scene of a car's run for a viewer; a note says why there is none."""
    from aerodima.workbench.scenario.signal_table import RIG_KINDS

    if run_log.kind in RIG_KINDS:
        return ()
    from aerodima.workbench.view.foxglove_scene import foxglove_scene  # imports Drake

    try:
        return foxglove_scene(run_log)
    except LogError as error:
        typer.echo(f"note: signals only, no scene: {error}", err=True)
        return ()


def condition(
    log: Annotated[Path, typer.Argument(help="Run log (Parquet).")],
    out: cli.LogOut,
    fill: Annotated[
        float | None, typer.Option(help="Longest gap that straight lines bridge, s.")
    ] = None,
    rest: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="START END", help="The drift in this rest goes, s."),
    ] = None,
    low_pass: Annotated[
        float | None, typer.Option(help="Cut-off of a filter of order 6 without delay, Hz.")
    ] = None,
    columns: Annotated[
        list[str] | None, typer.Option(help="To correct and filter; by default forces and torques.")
    ] = None,
    force: cli.Force = False,
) -> None:
    """Fill gaps, remove drift and filter, in this order.

    The log that is read stays as it is.

    Example: aerodima log condition swing.parquet --fill 0.05 --rest 0 2 --low-pass 20 --out
    ready.parquet
    """
    from aerodima.workbench.logs.schema import write_run_log
    from aerodima.workbench.logs.signals import conditioning_notes

    _refuse_raw(out, log)
    refuse_existing(out, force, LogError)
    if (fill, rest, low_pass) == (None, None, None):
        raise LogError("nothing to do: state --fill, --rest or --low-pass")
    run_log = workbench.read_run_log(log)
    before = len(conditioning_notes(run_log))
    chosen = columns or [
        name for name in run_log.table.columns if name.startswith(("force_", "torque_"))
    ]
    if fill is not None:
        run_log = workbench.fill_gaps(run_log, fill)
    if rest is not None:
        run_log = workbench.remove_drift(run_log, chosen, [rest])
    if low_pass is not None:
        run_log = workbench.low_pass_columns(run_log, chosen, workbench.LowPass(6, low_pass))
    write_run_log(run_log, out, force)
    typer.echo(f"{out}: {len(run_log.table)} rows, {len(run_log.table.columns)} columns")
    for note in conditioning_notes(run_log)[before:]:
        typer.echo(note)


def compare(
    runs: Annotated[list[Path], typer.Argument(help="Two to twenty run logs (Parquet).")],
    html: cli.Html = None,
    force: cli.Force = False,
) -> None:
    """Compare runs: what was set differently, and the metrics.

    With --html replays and signals in step, too.

    Example: aerodima log compare none.parquet swing.parquet --html compare.html
    """
    names = run_names(runs)
    refuse_existing(html, force, UserError)
    run_logs = [workbench.read_run_log(path) for path in runs]
    from aerodima.workbench.metrics.run_summary import of_plants
    from aerodima.workbench.view.replay_page import (
        comparison_page,
        different_cars,
        metrics_rows,
        scenario_differences,
    )

    differences = scenario_differences(run_logs)
    for group in (differences, metrics_rows(run_logs)):
        table = text_table(["", *names], value_rows(group.items()))
        typer.echo("\n".join([*table, ""]))
    other = different_cars(differences)
    if other and not of_plants(run_logs):
        typer.echo(f"note: these are different cars: {', '.join(other)}")
    if html is not None:
        page = comparison_page(run_logs, names).html()
        typer.echo(f"page: {write_atomically(html, page, force, UserError)}")


def _refuse_raw(out: Path, log: Path) -> None:
    if out.resolve() == log.resolve():
        raise LogError(f"--out {out}: must not be the log that is read; raw logs are kept")


def run_names(runs: list[Path]) -> list[str]:
    """List file names without ending; whole paths if these are not unique."""
    from aerodima.workbench.core.key_errors import require_unique

    require_unique(runs, "run", LogError)
    stems = [path.stem for path in runs]
    if len(set(stems)) == len(stems):
        return stems
    return [str(path) for path in runs]
