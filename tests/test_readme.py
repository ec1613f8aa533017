"""The examples of the README and of the pages that it leads to run, and come out as they say."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest
import yaml
from typer.testing import CliRunner

from aerodima.workbench.cli.program import build_app

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def section(title: str, page: str) -> str:
    """A chapter of a page, up to the next one."""
    return (ROOT / page).read_text(encoding="utf-8").split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]


def test_first_commands_are_the_two_of_make() -> None:
    assert re.match(r"make demo .*\nmake test .*\n$", re.findall(r"```sh\n(.*?)```", README, re.DOTALL)[0])


@pytest.mark.slow
def test_commands_come_out_as_the_first_page_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    block = "".join(re.findall(r"```sh\n(.*?)```", page, re.DOTALL))
    outcomes = []
    for line in block.splitlines():
        program, *words = shlex.split(line)
        assert program == "aerodima"
        result = CliRunner().invoke(build_app(), words, catch_exceptions=False)
        assert result.exit_code == 0, f"{line}: {result.output}"
        outcomes += re.findall(r"^outcome: .*$", result.stdout, re.MULTILINE)
    assert outcomes == ["outcome: flipped", "outcome: survived, tail touched the ground"]
    told = " ".join(page.split())
    assert all(outcome in told for outcome in outcomes)
    assert all((tmp_path / name).is_file() for name in ("swing.html", "compare.html", "fits/report.html"))


@pytest.mark.slow
def test_tails_come_out_as_the_page_says() -> None:
    chapter = section("What the tails gain", "docs/howto/optimise.md")
    (block,) = re.findall(r"```sh\n(.*?)```", chapter, re.DOTALL)
    said = []
    for line in block.splitlines():
        result = CliRunner().invoke(build_app(), shlex.split(line)[1:], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        said += re.findall(r"outcome: (.*)", result.stdout)
        (heading,) = re.findall(r"heading_change_rad +(\S+)", result.stdout)
        said.append(f"{math.degrees(float(heading)):.0f}")
    assert said[::2] == ["survived, clean", "survived, tail touched the ground", "survived, clean"]
    told = " ".join(chapter.split())
    assert all(f"{degrees} degrees)" in told for degrees in said[1::2]), said


@pytest.mark.slow
def test_python_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    before = plt.get_fignums()
    (block,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(compile(block, "README.md", "exec"), {})
    assert capsys.readouterr().out.split() == ["turn_none", "flipped", "turn_swing", "survived"]
    assert "# flipped, survived\n" in block
    figures = set(plt.get_fignums()) - set(before)
    assert [len(plt.figure(figure).axes[0].lines) for figure in sorted(figures)] == [3, 3]
    for figure in figures:
        plt.close(figure)


@pytest.mark.slow
def test_the_way_from_a_foreign_log_to_coefficients_finds_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    chapter = section("From a foreign log to coefficients", "docs/howto/identify.md")
    told = ""
    for language, title, text in re.findall(r'```(\w+)(?: title="(.*?)")?\n(.*?)```', chapter, re.DOTALL):
        if language == "yaml":
            (tmp_path / title).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, title, "exec"), {})
        else:
            for line in text.splitlines():
                program, *words = shlex.split(line)
                assert program == "aerodima"
                result = CliRunner().invoke(build_app(), words, catch_exceptions=False)
                assert result.exit_code == 0, f"{line}: {result.output}"
                told += result.output
    assert "gap of 0.03 s" in told
    fits = yaml.safe_load((tmp_path / "fits" / "fits.yaml").read_text(encoding="utf-8"))
    (mass,) = (e for e in fits["fits"][0]["estimates"] if e["name"] == "added_mass")
    # The straight line across the gap and the encoder's counts cost less than one percent.
    assert mass["value"] == pytest.approx(0.02, rel=0.01)
    assert mass["lower"] < mass["upper"]
    assert {path.name for path in (tmp_path / "fits").iterdir()} >= {"report.html", "fits.csv", "averages.csv"}
