"""The example of the documentation that plays a swing with feedback comes out as it says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from aerodima.workbench.cli.program import build_app

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "howto" / "optimise.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_feedback_keeps_the_turn_clean_where_the_joints_alone_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    section = PAGE[PAGE.index("## Play a swing with feedback") :]
    block = re.search(r"```sh\n(.*?)```", section, re.DOTALL)
    assert block is not None
    said = []
    for line in block.group(1).splitlines():
        result = CliRunner().invoke(build_app(), shlex.split(line)[1:], catch_exceptions=False)
        assert result.exit_code == 0, f"{line}: {result.output}"
        said += re.findall(r"outcome: (.*)|peak roll ([0-9.]+) deg", result.stdout)
    outcomes = [outcome for outcome, _ in said if outcome]
    rolls = [float(roll) for _, roll in said if roll]
    told = " ".join(section.split())
    assert all(f"`outcome: {outcome}`" in told for outcome in outcomes)
    assert all(outcome.startswith("survived, clean") for outcome in outcomes)
    assert rolls[1] < 0.85 * rolls[0]
    assert all(f"{roll:.0f} degrees" in told for roll in rolls), rolls
