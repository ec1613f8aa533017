"""`aerodima metrics` and the group `aerodima log`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands import importing


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command()(metrics)
    group = typer.Typer(no_args_is_help=True, help="Work on run logs.")
    group.command()(recover)
    importing.add_to_group(group)
    group.callback()(_group)
    app.add_typer(group, name="log")


def _group() -> None:
    """Work on run logs."""


def metrics(
    runs: Annotated[list[Path], typer.Argument(help="Run logs (Parquet).")],
    csv: Annotated[Path | None, typer.Option(help="Also write the whole table, filtered figures included.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite existing output.")] = False,
) -> None:
    """Outcome and metrics of runs as a table, one column per run."""
    import pandas as pd

    from workbench.atomic_write import write_atomically
    from workbench.errors import LogError
    from workbench.logs.schema import read_run_log
    from workbench.metrics import metrics_of

    rows = {}
    for path in runs:
        name = str(path)
        if name in rows:
            raise LogError(f"{path}: named twice")
        rows[name] = metrics_of(read_run_log(path)).as_row()
    table = pd.DataFrame.from_dict(rows, orient="index")
    if csv is not None:
        write_atomically(csv, lambda temporary: table.to_csv(temporary, index_label="run"), force, LogError)
    shown = [name for name in table.columns if not name.startswith("filtered_")]
    with pd.option_context("display.float_format", "{:.4g}".format, "display.width", 160, "display.max_columns", None):
        typer.echo(table[shown].T.to_string(na_rep="-"))


def recover(
    journal: Annotated[Path, typer.Argument(help="Journal of a run that was cut off (*.journal).")],
    out: Annotated[Path | None, typer.Option(help="Parquet file to write; beside the journal by default.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing log.")] = False,
) -> None:
    """Make a log of what a cut-off run left behind."""
    from workbench.logs.journal import recover as recover_journal

    recovery = recover_journal(journal, out, force=force)
    state = "none was lost" if recovery.complete else "the last ones were lost with the process"
    typer.echo(f"{recovery.path}: {recovery.rows} rows recovered; {state}")
