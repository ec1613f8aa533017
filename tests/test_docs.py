"""Every example of the documentation runs, page by page, in an empty folder, and comes out as the
page says.
"""

import math
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import pytest
import yaml

from tests.code_measure import ROOT
from tests.commands import call
from tests.page_blocks import blocks, run_blocks

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if blocks(path))


def index_comes_out(folder: Path, told: Mapping[str, str], page: str) -> None:
    outcomes = re.findall(r"^outcome: .*$", "".join(told.values()), re.MULTILINE)
    assert outcomes == ["outcome: flipped", "outcome: survived, tail touched the ground"]
    assert all(outcome in page for outcome in outcomes)
    assert all(
        (folder / name).is_file() for name in ("swing.html", "compare.html", "fits/report.html")
    )


def tails_come_out(folder: Path, told: Mapping[str, str], page: str) -> None:
    chapter = page.split("## What the tails gain ", 1)[1].split(" ## ", 1)[0]
    runs = [output for line, output in told.items() if line in chapter]
    assert [re.findall(r"outcome: (.*)", run) for run in runs] == [
        ["survived, clean"], ["survived, tail touched the ground"], ["survived, clean"]
    ]  # fmt: skip
    headings = [
        math.degrees(float(re.findall(r"heading_change_rad +(\S+)", run)[0])) for run in runs
    ]
    assert all(f"{degrees:.0f} degrees)" in chapter for degrees in headings), headings


def foreign_log_comes_out(folder: Path, told: Mapping[str, str], page: str) -> None:
    assert "gap of 0.03 s" in "".join(told.values())
    fits = yaml.safe_load((folder / "fits" / "fits.yaml").read_text(encoding="utf-8"))
    (mass,) = (e for e in fits["fits"][0]["estimates"] if e["name"] == "added_mass")
    # The straight line across the gap and the encoder's counts cost less than one percent.
    assert mass["value"] == pytest.approx(0.02, rel=0.01)
    assert mass["lower"] < mass["upper"]
    assert {path.name for path in (folder / "fits").iterdir()} >= {
        "report.html",
        "fits.csv",
        "averages.csv",
    }


OUTCOMES: dict[str, Callable[[Path, Mapping[str, str], str], None]] = {
    "index.md": index_comes_out,
    "howto/optimise.md": tails_come_out,
    "howto/identify.md": foreign_log_comes_out,
}
"""Page -> check of its folder, of what each line of sh has told, and of the words of the page."""


def test_pages_with_outcomes_are_there() -> None:
    assert {*OUTCOMES} <= {page.relative_to(DOCS).as_posix() for page in PAGES}


def marked(page: Path) -> Any:
    """A page as a case: the first page is run with the slow tests, the others at night."""
    name = page.relative_to(DOCS).as_posix()
    marks = [pytest.mark.slow] if name == "index.md" else [pytest.mark.slow, pytest.mark.nightly]
    return pytest.param(page, id=name, marks=marks)


@pytest.mark.parametrize("page", [marked(page) for page in PAGES])
def test_examples_of_the_page_run(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    matplotlib.use("Agg")
    told: dict[str, str] = {}

    def command(line: str, where: str) -> None:
        program, *words = shlex.split(line, comments=True) or ["aerodima", "--version"]
        assert program == "aerodima", f"{where}: {line}"
        result = call(*words)
        assert result.exit_code == 0, f"{where}: {line}\n{result.output}"
        told[" ".join(line.split())] = result.output

    run_blocks(page, tmp_path, command)
    plt.close("all")
    if check := OUTCOMES.get(page.relative_to(DOCS).as_posix()):
        check(tmp_path, told, " ".join(page.read_text(encoding="utf-8").split()))


def test_search_from_disk_needs_no_network() -> None:
    """The plugin `offline` asks a server for its shim unless a file with this name is given."""
    settings = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    (script,) = re.findall(r"polyfills: \[(\S*iframe-worker\S*)\]", settings)
    assert "  - offline" in settings
    assert "window.Worker=" in (DOCS / script).read_text(encoding="utf-8")
