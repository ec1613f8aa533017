"""The page of commands has them all."""

from __future__ import annotations

import re

import typer.main

from aerodima.workbench.cli.program import build_app
from tests.code_measure import ROOT


def test_table_of_commands_has_them_all() -> None:
    rows = re.findall(
        r"^\| (`aerodima .*?) \|", (ROOT / "docs/commands.md").read_text(encoding="utf-8"), re.M
    )
    commands = set(typer.main.get_group(build_app()).commands)
    listed = {word for row in rows for word in re.findall(r"`(?:aerodima )?([\w-]+)", row)}
    first_words = {word for row in rows for word in re.findall(r"`aerodima ([\w-]+)", row)}
    assert commands <= listed
    assert first_words <= commands
