"""The page of commands has them all, and each has an example."""

import re
from collections.abc import Iterator
from typing import Any

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


def commands(command: Any, name: str = "aerodima") -> Iterator[tuple[str, Any]]:
    """Walks the program down to what is run: the words and the command."""
    for word, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, f"{name} {word}")
    if not hasattr(command, "commands"):
        yield name, command


def test_every_command_has_an_example_with_its_own_options() -> None:
    program = dict(commands(typer.main.get_group(build_app())))
    assert len(program) > 30
    for name, command in program.items():
        _, example, words = " ".join(command.help.split()).partition(f"Example: {name}")
        assert example, name
        options = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words.split() if word.startswith("-")} <= options, name
