"""`aerodima log import`, `log export` and `log condition`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.options import Force, LogOut


def add_to_group(group: typer.Typer) -> None:
    """Adds the three commands to the group `log`."""
    group.command("import")(import_)
    group.command()(export)
    group.command()(condition)


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(help="Foreign log: CSV, Parquet, MAT or MCAP; several files when they share a clock."),
    ],
    out: LogOut,
    mapping: Annotated[
        Path | None, typer.Option(help="Mapping file (YAML): foreign names and units. Not needed for our own exports.")
    ] = None,
    force: Force = False,
) -> None:
    """Make a run log of a foreign log; gaps, NaN and whatever else is odd are printed, and kept in its metadata.

    Example: aerodima log import swing.csv --mapping rig.yaml --out swing.parquet
    """
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.errors import LogError
    from aerodima.workbench.logs.importers import import_log
    from aerodima.workbench.logs.mapping import load_mapping
    from aerodima.workbench.logs.schema import write_run_log

    refuse_existing(out, force, LogError)
    imported = import_log(files, None if mapping is None else load_mapping(mapping))
    write_run_log(imported.run_log, out, force)
    run_log = imported.run_log
    typer.echo(
        f"{out}: {run_log.kind}, {len(run_log.table)} rows from {run_log.time[0]:g} to {run_log.time[-1]:g} s, "
        f"{len(run_log.table.columns)} columns"
    )
    for finding in imported.findings:
        typer.echo(f"note: {finding}", err=True)


def export(
    log: Annotated[Path, typer.Argument(help="Run log (Parquet).")],
    to: Annotated[str, typer.Option("--to", help="csv or mcap.")],
    out: Annotated[Path | None, typer.Option(help="File to write; beside the log by default.")] = None,
    force: Force = False,
) -> None:
    """Write a run log for other programs. `aerodima log import` reads it back bit for bit."""
    from aerodima.workbench.errors import LogError
    from aerodima.workbench.logs.exporters import FORMATS, export_log
    from aerodima.workbench.logs.schema import read_run_log

    form = next((known for known in FORMATS if known == to), None)
    if form is None:
        raise LogError(f"--to: {to!r}; allowed: {', '.join(FORMATS)}")
    written = export_log(read_run_log(log), out or log.with_suffix(f".{form}"), form, force)
    typer.echo("\n".join(map(str, written)))


def condition(
    log: Annotated[Path, typer.Argument(help="Run log (Parquet).")],
    recipe: Annotated[Path, typer.Option(help="Recipe (YAML): the steps and their order.")],
    out: LogOut,
    plot: Annotated[Path | None, typer.Option(help="Also write before and after as a PNG.")] = None,
    force: Force = False,
) -> None:
    """Filter, cut, resample and correct a run log as a recipe states; the log that is read stays as it is.

    Example: aerodima log condition swing.parquet --recipe swing_recipe.yaml --out ready.parquet --plot ready.png
    """
    from aerodima.workbench.atomic_write import refuse_existing
    from aerodima.workbench.errors import LogError
    from aerodima.workbench.logs.recipe import apply_recipe, load_recipe
    from aerodima.workbench.logs.schema import read_run_log, write_run_log

    if out.resolve() == log.resolve():
        raise LogError(f"--out {out}: is the log that is read; raw logs are kept")
    for path in (out, plot):
        if path is not None:
            refuse_existing(path, force, LogError)
    before = read_run_log(log)
    result = apply_recipe(before, load_recipe(recipe))
    write_run_log(result.run_log, out, force)
    if plot is not None:
        from aerodima.workbench.figures.conditioning_figure import plot_conditioning
        from aerodima.workbench.figures.figure_style import png
        from aerodima.workbench.report.report_page import write_files

        picture = png(plot_conditioning(before, result.run_log, result.rest))
        write_files(plot.parent, {plot.name: picture}, force=force, error=LogError)
    typer.echo(f"{out}: {len(result.run_log.table)} rows, {len(result.run_log.table.columns)} columns")
    for note in result.notes:
        typer.echo(note)
