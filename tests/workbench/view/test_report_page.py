"""Pages say what the runs say, nothing is fetched, all text is escaped."""

import math
import re
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pandas as pd
import pytest
from jinja2 import UndefinedError

from aerodima.workbench.metrics.run_summary import summarise
from aerodima.workbench.view.demo import DemoRun, provenance, thesis_turn_chapter
from aerodima.workbench.view.figure_style import new_figure
from aerodima.workbench.view.report_page import (
    Bullets,
    Finding,
    Folded,
    Link,
    Page,
    Plot,
    Preformatted,
    Section,
    Table,
    percent,
    write_files,
)


class _Reader(HTMLParser):
    """Addresses, text, and tags that are open at the end."""

    def __init__(self):
        super().__init__()
        self.addresses = []
        self.open = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("href", "src")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def _read(text):
    reader = _Reader()
    reader.feed(text)
    reader.close()
    return reader


def test_text_is_escaped_once_wherever_it_stands():
    odd = '<script>"a" & b</script>'
    parts = [
        odd,
        ("see", Link(odd, odd)),
        Finding([Bullets([odd])]),
        Table([odd], [[odd]]),
        Plot(new_figure(1.0, 1.0)[0], odd, odd),
        Folded(odd, [Preformatted(odd)]),
    ]
    text = Page(odd, odd, [Section(odd, parts), *[Section(odd, [])] * 4]).html()
    assert "<script" not in text
    assert "&amp;amp;" not in text
    assert _read(text).text.count(odd) == 21  # title, lead, five headings and five links count too


def test_files_of_a_folder_are_all_made_before_any_is_written(tmp_path):
    drawing, axes = new_figure(4.0, 3.0)
    axes[0, 0].plot([0, 1])
    plot = Plot(drawing, "A caption.", "A line", "line")
    page = Page("A page", "", [Section("One", [plot])])
    table = pd.DataFrame({"a": [1, 2]})
    written = write_files(
        tmp_path, {"a.csv": table, "a.parquet": table, "index.html": page, "a.txt": "é"}
    )
    names = {path.name for path in written}
    assert names == {"a.csv", "a.parquet", "line.png", "index.html", "a.txt"}
    assert (tmp_path / "line.png").read_bytes() == plot.data
    assert 'src="line.png"' in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert pd.read_parquet(tmp_path / "a.parquet").equals(pd.read_csv(tmp_path / "a.csv"))
    with pytest.raises(UndefinedError):
        write_files(
            tmp_path, {"a.txt": "new", "index.html": Page("A", "", [Section("One", [None])])}
        )
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "é"


@pytest.fixture(scope="module")
def chapters(standard_runs):
    logs = {f"{mode}_3.33": run for mode, run in standard_runs.items()}
    summaries = [summarise(run, name) for name, run in logs.items()]
    made = {
        name: DemoRun(name, run.scenario, Path(run.source), Path("replay.html"))
        for name, run in logs.items()
    }
    return Page("Turns", "", (thesis_turn_chapter(summaries), provenance(made))).html()


def test_the_page_is_well_formed_and_needs_no_network(chapters):
    reader = _read(chapters)
    assert reader.open == []
    for address in reader.addresses:
        assert address.startswith(("data:image/png;base64,", "#")) or re.fullmatch(
            r"[\w./-]+", address
        ), address
        assert not address.startswith(("/", ".."))


def test_the_runs_stand_in_the_tables_beside_the_published_figures(chapters, standard_runs):
    cells = re.findall(r"<td[^>]*>(.*?)</td>", chapters)
    run = summarise(standard_runs["none"], "none_3.33").metrics
    place = cells.index("largest yaw rate")
    figure = run.raw.max_yaw_rate_rad_per_s
    assert cells[place - 3 : place + 5] == [
        "none_3.33", "Table 7.1", "simulated", "largest yaw rate", "rad/s", f"{figure:.2f}", "2.17",
        percent(figure / 2.17 - 1.0),
    ]  # fmt: skip
    assert f"{math.degrees(run.heading_change_rad):.1f}" in cells
    assert {("3.33", "3.61"), ("4.44", "4.72")} <= set(pairwise(cells))  # section 7.1
    assert standard_runs["none"].versions["drake"] in cells
