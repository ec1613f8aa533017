"""`aerodima doctor`: what this machine has, what it lacks, and for what."""

from __future__ import annotations

import typer

from aerodima.workbench.cli.help_sections import CHECKS


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=CHECKS)(doctor)


def doctor() -> None:
    """Check Python, Drake, solvers, extras, browser, CAN, serial ports and disk; says how to get what is missing."""
    from aerodima.workbench.cli.machine_check import examine
    from aerodima.workbench.errors import UserError

    findings = examine()
    for finding in findings:
        mark = "ok  " if finding.ok else ("FAIL" if finding.required else "none")
        typer.echo(f"{mark} {finding.subject + ':':<18} {finding.found}")
        if finding.remedy:
            typer.echo(f"     {'':<18} -> {finding.remedy}")
    broken = [finding.subject for finding in findings if finding.required and not finding.ok]
    if broken:
        raise UserError(f"nothing works without: {', '.join(broken)}")
    typer.echo("everything needed for simulation, fits and reports is there")
