"""`aerodima coefficients`: list and plot sets of aerodynamic coefficients."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import COEFFICIENTS
from aerodima.workbench.cli.options import Force


def register(app: typer.Typer) -> None:
    """Adds the command group `coefficients`."""
    group = typer.Typer(no_args_is_help=True)
    group.callback()(_group)
    group.command("list")(list_sets)
    group.command()(plot)
    app.add_typer(group, name="coefficients", rich_help_panel=COEFFICIENTS)


def _group() -> None:
    """Look at sets of aerodynamic coefficients."""


def list_sets() -> None:
    """List the embedded sets with their measured range and source."""
    from aerodima.workbench.aero.coefficient_files import embedded_sets, load_coefficients

    for name in embedded_sets():
        coefficients = load_coefficients(name)
        low, high = coefficients.speed_range
        measured = f"{low:g}-{high:g} m/s"
        if coefficients.angle_range is not None:
            measured += f", |gamma| {coefficients.angle_range[0]:.3f}-{coefficients.angle_range[1]:.3f} rad"
        typer.echo(f"{name}: {coefficients.law_kind}, measured {measured}; {coefficients.source}")


def plot(
    file: Annotated[str, typer.Argument(help="YAML or CSV file of a set, or the name of an embedded one.")],
    out: Annotated[
        Path | None, typer.Option(help="Picture to write (png, svg or pdf); <name>.png here when left out.")
    ] = None,
    force: Force = False,
) -> None:
    """Plot a set: curves with percentile bands, measured and seed nodes, and the surface.

    Example: aerodima coefficients plot cheetah_tail_1_major --out tail_1.png
    """
    from aerodima.workbench.aero.coefficient_files import load_coefficients
    from aerodima.workbench.aero.coefficient_plots import plot_coefficients
    from aerodima.workbench.atomic_write import write_atomically
    from aerodima.workbench.errors import ModelError

    coefficients = load_coefficients(file)
    target = out or Path(f"{Path(file).stem}.png")
    kind = target.suffix.lstrip(".").lower()
    if kind not in ("png", "svg", "pdf"):
        raise ModelError(f"--out {target}: the ending must be .png, .svg or .pdf")
    figure = plot_coefficients(coefficients)
    write_atomically(target, lambda path: figure.savefig(path, format=kind, dpi=130), force, ModelError)
    typer.echo(f"written {target}")
