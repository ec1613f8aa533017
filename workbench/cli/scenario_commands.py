"""`aerodima diagram` and `aerodima export`: what a scenario means."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from aerodima.workbench.cli.help_sections import CHECKS
from aerodima.workbench.cli.options import Force, ScenarioArgument, Settings


def register(app: typer.Typer) -> None:
    """Adds the commands."""
    app.command(rich_help_panel=CHECKS)(diagram)
    app.command(rich_help_panel=CHECKS)(export)


def diagram(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="Picture (.svg, .png, .pdf) or text (.dot).")] = Path("diagram.svg"),
    depth: Annotated[int, typer.Option(help="How many levels of nested diagrams are drawn.", min=1)] = 2,
    settings: Settings = None,
    force: Force = False,
) -> None:
    """Draw the block diagram of a scenario; as text (.dot) where Graphviz is not installed."""
    import shutil
    import subprocess

    from aerodima.workbench.atomic_write import write_atomically
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.errors import UserError
    from aerodima.workbench.simulate.car_run import assemble

    kinds = (".svg", ".png", ".pdf", ".dot")
    if out.suffix not in kinds:
        raise UserError(f"--out {out}: ending {out.suffix!r}; allowed: {', '.join(kinds)}")
    text = assemble(load_scenario(scenario, settings)).builder.Build().GetGraphvizString(max_depth=depth)
    program = shutil.which("dot")
    if program is None and out.suffix != ".dot":
        out = out.with_suffix(".dot")
        typer.echo("Graphviz is not installed: writing text that `dot -Tsvg` draws elsewhere", err=True)

    def write(temporary: Path) -> None:
        if out.suffix == ".dot":
            temporary.write_text(text, encoding="utf-8")
            return
        command = [str(program), f"-T{out.suffix[1:]}", "-o", str(temporary)]
        done = subprocess.run(command, input=text, text=True, capture_output=True, check=False)
        if done.returncode != 0:
            raise UserError(f"--out {out}: Graphviz failed: {done.stderr.strip()}")

    write_atomically(out, write, force, UserError)
    typer.echo(f"diagram: {out}")


def export(
    scenario: ScenarioArgument,
    out: Annotated[Path | None, typer.Option(help="JSON file; standard output when left out.")] = None,
    settings: Settings = None,
    force: Force = False,
) -> None:
    """Write a resolved scenario, with every number and its swing in it, as one JSON bundle that needs no other file."""
    import json

    from aerodima.workbench.atomic_write import write_atomically
    from aerodima.workbench.config.scenario import load_scenario
    from aerodima.workbench.controllers.law_of_scenario import make_bundle
    from aerodima.workbench.errors import UserError

    text = json.dumps(make_bundle(load_scenario(scenario, settings)), indent=2) + "\n"
    if out is None:
        typer.echo(text, nl=False)
        return
    write_atomically(out, text, force, UserError)
    typer.echo(f"scenario: {out}")
