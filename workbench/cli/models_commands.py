"""`aerodima models check`: are the models what they claim to be?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import CHECKS


def register(app: typer.Typer) -> None:
    """Adds the command group `models`."""
    group = typer.Typer(no_args_is_help=True)
    group.callback()(_group)
    group.command()(check)
    app.add_typer(group, name="models", rich_help_panel=CHECKS)


def _group() -> None:
    """Look after models and parameters."""


def check(
    files: Annotated[list[Path] | None, typer.Argument(help="SDF or URDF files; all that ship when left out.")] = None,
    update: Annotated[
        bool, typer.Option("--update", help="First write the numbers of models/parameters into the SDF files.")
    ] = False,
) -> None:
    """Check that models load, are physical, hide nothing, name their sources and equal the parameters."""
    from aerodima.workbench.cli.model_check import check_model_file, check_shipped_models, update_model_files
    from aerodima.workbench.errors import ModelError

    if update:
        for path in update_model_files():
            typer.echo(f"written {path}")
    results = [result for path in files for result in check_model_file(path)] if files else list(check_shipped_models())
    for result in results:
        typer.echo(f"{'ok  ' if not result.problems else 'FAIL'} {result.subject}")
    problems = [problem for result in results for problem in result.problems]
    if problems:
        raise ModelError(f"{len(problems)} problem(s):\n  " + "\n  ".join(problems))
