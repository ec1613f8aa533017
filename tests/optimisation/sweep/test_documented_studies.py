"""The studies that the documentation shows are read, planned and run as it says."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from aerodima.optimisation.sweep.run_study import read_table
from aerodima.optimisation.sweep.study import load_study, plan_runs
from aerodima.workbench.cli.program import build_app

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "howto" / "studies.md").read_text(
    encoding="utf-8"
)
SECTION = PAGE[: PAGE.index("## Workers")]


def write_study(folder: Path) -> Path:
    (text,) = re.findall(r"```yaml[^\n]*\n(.*?)```", SECTION, re.DOTALL)
    path = folder / "study.yaml"
    path.write_text(text)
    return path


@pytest.mark.slow
def test_study_of_the_page_is_planned_also_with_the_lines_that_are_commented_out(tmp_path):
    path = write_study(tmp_path)
    assert len(plan_runs(load_study(path))) == 9
    text = re.sub(r"^# (sample|ensemble)", r"\1", path.read_text(), flags=re.MULTILINE)
    path.write_text(text.replace("number: 64", "number: 2"))
    runs = plan_runs(load_study(path))
    assert len(runs) == 9 * 2 * len({run.place["member"] for run in runs})


@pytest.mark.slow
def test_commands_of_the_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_study(tmp_path)
    (block,) = re.findall(r"```sh\n(.*?)```", SECTION, re.DOTALL)
    outputs = []
    for line in block.splitlines():
        program, *words = shlex.split(line)
        assert program == "aerodima"
        result = CliRunner().invoke(build_app(), words, catch_exceptions=False)
        assert result.exit_code == 0, f"{line}: {result.output}"
        outputs.append(result.stdout)
    table = read_table(tmp_path / "sweeps" / "grip")
    assert table["outcome"].isin(["survived", "flipped"]).all()
    assert set(table["outcome"]) == {"survived", "flipped"}
    assert re.search(r"^car\.tyre_friction +0\.\d+ +0\.\d+ +0\.01 ", outputs[1], re.MULTILINE)
