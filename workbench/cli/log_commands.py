"""`aerodima metrics` and the group `aerodima log`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from aerodima.workbench.cli import log_files_commands as importing
from aerodima.workbench.cli.help_sections import RUNS
from aerodima.workbench.cli.options import Force


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(rich_help_panel=RUNS)(metrics)
    group = typer.Typer(no_args_is_help=True, help="Work on run logs.")
    group.command()(recover)
    importing.add_to_group(group)
    group.callback()(_group)
    app.add_typer(group, name="log", rich_help_panel=RUNS)


def _group() -> None:
    """Work on run logs."""


def metrics(
    runs: Annotated[list[Path], typer.Argument(help="Run logs (Parquet).")],
    csv: Annotated[Path | None, typer.Option(help="Also write the whole table, filtered figures included.")] = None,
    force: Force = False,
) -> None:
    """Outcome and metrics of runs as a table, one column per run; the eight of the thesis raw and filtered."""
    from aerodima.workbench.atomic_write import refuse_existing, write_atomically
    from aerodima.workbench.errors import LogError
    from aerodima.workbench.logs.schema import read_run_log

    run_logs = {}
    for path in runs:
        if str(path) in run_logs:
            raise LogError(f"{path}: named twice")
        run_logs[str(path)] = read_run_log(path)
    if csv is not None:
        refuse_existing(csv, force, LogError)
    import pandas as pd

    from aerodima.workbench.metrics.turn_metrics import jolt_line, metrics_of

    found = {name: metrics_of(run_log) for name, run_log in run_logs.items()}
    rows = {name: metrics.as_row() for name, metrics in found.items()}
    if csv is not None:
        table = pd.DataFrame.from_dict(rows, orient="index")
        write_atomically(csv, lambda temporary: table.to_csv(temporary, index_label="run"), force, LogError)
    for line in _metrics_lines(rows):
        typer.echo(line)
    for name, metrics in found.items():
        line = jolt_line(metrics)
        if line:
            typer.echo(f"note: {name}: {line}")


def _metrics_lines(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The table: what is of the run as a whole, then the eight metrics raw, then filtered."""
    from aerodima.workbench.metrics.published_figures import FILTERED, SIGNALS
    from aerodima.workbench.text_table import shown_value, text_table

    known = all(row["signals"] == "truth" for row in rows.values())
    raw_signals = SIGNALS["simulated"] if known else "as the sensors reported them, where `signals` is sensors"
    names = list(next(iter(rows.values())))
    filtered = [name for name in names if name.startswith(FILTERED)]
    raw = [name.removeprefix(FILTERED) for name in filtered]
    whole = [name for name in names if name not in (*filtered, *raw)]

    def lines(keys: list[str]) -> list[list[str]]:
        return [[f"  {key.removeprefix(FILTERED)}", *(shown_value(row[key]) for row in rows.values())] for key in keys]

    return text_table(
        ["", *rows],
        [
            ["the run"],
            *lines(whole),
            [f"in the turn, raw: {raw_signals}"],
            *lines(raw),
            [f"in the turn, filtered: {SIGNALS['physical']}"],
            *lines(filtered),
        ],
    )


def recover(
    journal: Annotated[Path, typer.Argument(help="Journal of a run that was cut off (*.journal).")],
    out: Annotated[Path | None, typer.Option(help="Parquet file to write; beside the journal by default.")] = None,
    force: Force = False,
) -> None:
    """Make a log of what a cut-off run left behind."""
    from aerodima.workbench.logs.journal import recover as recover_journal

    recovery = recover_journal(journal, out, force=force)
    state = "none was lost" if recovery.complete else "the last ones were lost with the process"
    typer.echo(f"{recovery.path}: {recovery.rows} rows recovered; {state}")
