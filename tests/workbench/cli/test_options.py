"""A command that takes its options as one value shows them one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from aerodima.workbench.cli.options import WorkOptions, grouped


@dataclass(frozen=True)
class OwnOptions:
    name: Annotated[str, typer.Option(help="Has no default.")]
    speed: Annotated[float, typer.Option("--at", min=0.0)] = 2.0


@grouped
def command(own: OwnOptions, count: int = 1, *, work: WorkOptions) -> None:
    """Prints what it got."""
    typer.echo(f"{own} {count} {work.workers} {work.force}")


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        (["--name", "a"], 0, "OwnOptions(name='a', speed=2.0) 1 2 False"),
        (
            ["--name", "a", "--at", "3", "--count", "4", "--workers", "5", "--force"],
            0,
            "OwnOptions(name='a', speed=3.0) 4 5 True",
        ),
        ([], 2, "Missing option '--name'"),
        (["--name", "a", "--at", "-1"], 2, "--at"),
    ],
)
def test_every_field_is_an_option_of_the_command(words, status, said):
    app = typer.Typer(rich_markup_mode=None)
    app.command()(command)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == status
    assert said in result.output
