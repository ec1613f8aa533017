"""`aerodima coverage`: how often the 95 % intervals of fits hold the truth of simulated logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import COEFFICIENTS


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=COEFFICIENTS)(coverage)


def coverage(
    fits: Annotated[Path, typer.Argument(help="Folder that `aerodima fit ... --out` wrote, of simulated logs.")],
) -> None:
    """How often the 95 % intervals of fits hold the truth that simulated logs carry.

    Example: aerodima rig campaign static --out holds, aerodima fit static holds/*.parquet --out fits,
    aerodima coverage fits
    """
    from aerodima.optimisation.fit.fit_batch import coverage as measure

    table = measure(fits)
    path = fits / "coverage.csv"
    table.to_csv(path, index=False)
    for row in table.to_dict("records"):
        typer.echo(
            f"{row['parameter']:12s} held in {row['held']:4d} of {row['identifiable']:4d} intervals, "
            f"{100.0 * row['coverage']:5.1f} % (not determined in {row['fits'] - row['identifiable']})"
        )
    typer.echo(f"wrote {path}")
