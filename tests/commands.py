"""`aerodima` as a user calls it, in this process, so that Drake is imported once for all tests."""

from functools import cache

from click.testing import Result
from typer.testing import CliRunner

from aerodima.workbench.cli.program import build_app

_program = cache(build_app)

TURN = ("manoeuvre.turn_start=0.4", "manoeuvre.speed_ramp=0.3", "manoeuvre.duration=1.2")
SHORT = tuple(word for setting in TURN for word in ("--set", setting))
"""A turn of 1.2 s: enough for the window of the metrics, quick to simulate."""


def call(*words: object) -> Result:
    """What `aerodima` with these words ends in: exit_code, stdout and stderr."""
    return CliRunner().invoke(_program(), list(map(str, words)), catch_exceptions=False)


def done(*words: object) -> str:
    """What a command tells that ends well."""
    result = call(*words)
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(*words: object) -> str:
    """Message of a user error: exit status 2, one line on stderr, no traceback."""
    result = call(*words)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")
