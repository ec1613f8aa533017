"""The examples of the README run, and come out as it says."""

import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

from tests.code_measure import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_first_commands_are_the_two_of_make() -> None:
    assert re.match(
        r"make demo .*\nmake test .*\n$", re.findall(r"```sh\n(.*?)```", README, re.DOTALL)[0]
    )


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
