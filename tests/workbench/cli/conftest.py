"""The program as a user calls it, in this process, so that Drake is imported once for all tests of
a folder.
"""

import pytest
from typer.testing import CliRunner

from aerodima.workbench.cli.program import build_app


@pytest.fixture(scope="session")
def call():
    """Runs `aerodima` with the given words; the result has exit_code, stdout and stderr."""
    app = build_app()
    runner = CliRunner()

    def run(*words):
        return runner.invoke(app, [str(word) for word in words], catch_exceptions=False)

    return run


@pytest.fixture
def refused(call):
    """Runs `aerodima` and returns the message of a user error: exit status 2, one line on stderr,
    no traceback.
    """

    def run(*words):
        result = call(*words)
        assert result.exit_code == 2, result.output
        assert result.stderr.startswith("error: ")
        assert "Traceback" not in result.output
        return result.stderr.removeprefix("error: ").strip()

    return run


@pytest.fixture
def untouched(tmp_path):
    """A file that must keep its content."""
    path = tmp_path / "precious.parquet"
    path.write_text("precious")
    return path
