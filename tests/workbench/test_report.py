"""The report says what the runs say: sentences change with the numbers, nothing is fetched, all text is escaped."""

import math
import re
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from jinja2 import UndefinedError

from aerodima.workbench.figures.figure_style import new_figure
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.published_values import FlipBracket, flip_bracket, published_values, tyre_damping
from aerodima.workbench.metrics.run_summary import RunSummary, summarise
from aerodima.workbench.report import turn_findings as findings
from aerodima.workbench.report.report_page import (
    Bullets,
    Finding,
    Folded,
    Heading,
    Link,
    Noted,
    Page,
    Plot,
    Preformatted,
    Section,
    Table,
    write_files,
)
from aerodima.workbench.report.turn_report import ReportFiles, turn_report
from tests.workbench.made_up_summaries import made_up_summary

PUBLISHED = FlipBracket(survived=3.33, flipped=3.61)


def _runs(outcomes: dict[float, str], mode: str = "none") -> list[RunSummary]:
    return [made_up_summary(mode, speed, result=result) for speed, result in outcomes.items()]


@pytest.mark.parametrize(
    ("outcomes", "words", "verdict"),
    [
        (
            {3.333: "survived", 3.611: "flipped"},
            "survives up to 3.33 m/s and flips from 3.61 m/s on",
            "The runs meet this bracket.",
        ),
        (
            {3.333: "survived", 3.611: "survived", 3.889: "flipped"},
            "survives up to 3.61 m/s and flips from 3.89 m/s on",
            "differ by +0.28 m/s (survived) and +0.28 m/s (flipped)",
        ),
        (
            {3.333: "survived", 5.0: "survived"},
            "survives every speed from 3.33 to 5.00 m/s",
            "1.39 m/s faster than that",
        ),
        ({3.333: "flipped", 5.0: "flipped"}, "flips at every speed from 3.33 to 5.00 m/s", "none of them survives"),
        ({3.0: "survived", 3.333: "survived"}, "survives every speed from 3.00 to 3.33 m/s", "No run is fast enough"),
        ({3.3: "survived", 3.6: "flipped", 3.9: "survived"}, "not monotone", "(survived)"),
    ],
)
def test_bracket(outcomes: dict[float, str], words: str, verdict: str) -> None:
    bracket = findings.bracket_of(_runs(outcomes))
    assert words in findings.bracket_in_words(bracket)
    assert verdict in findings.bracket_verdict(bracket, PUBLISHED)


def test_published_brackets_and_damping_are_those_of_the_thesis() -> None:
    assert flip_bracket("tailless") == FlipBracket(3.33, 3.61)  # section 7.1.1
    assert flip_bracket("tailed") == FlipBracket(4.44, 4.72)  # section 7.1.2
    assert tyre_damping() == (986.93, 1480.56)  # Table 6.1


def test_turning_faster_needs_a_clean_run_and_95_percent_of_the_heading_change() -> None:
    reference = made_up_summary("none", 3.33, heading=1.0)

    def claim(**changes: object) -> str:
        return findings.faster_claim([made_up_summary("swing", 4.44, **changes)], "swing", reference)  # type: ignore[arg-type]

    assert "turns faster, up to 4.44 m/s (+33 %)" in claim(heading=0.951)
    refused = claim(heading=0.949)
    assert "no claim of a faster turn holds" in refused
    assert "95 % of the reference" in refused
    assert "no clean run is faster" in claim(heading=1.0, touched=("tail",))
    assert "no clean run is faster" in claim(heading=1.0, result="flipped")
    slower = [made_up_summary("swing", 3.33, heading=1.0)]
    assert "no clean run is faster" in findings.faster_claim(slower, "swing", reference)


def test_reference_is_the_fastest_clean_run_without_tail() -> None:
    runs = [
        made_up_summary("none", 3.0),
        made_up_summary("none", 3.3),
        made_up_summary("none", 3.6, touched=("board",)),
        made_up_summary("none", 3.9, result="flipped"),
        made_up_summary("held", 5.0),
    ]
    found = findings.reference_run(runs)
    assert found is not None
    assert found.commanded_speed == 3.3
    assert findings.reference_run(runs[3:]) is None


def test_held_and_swung_tail_are_compared_at_equal_speeds() -> None:
    runs = [
        made_up_summary("held", 3.0, peak_roll=math.radians(2.0)),
        made_up_summary("swing", 3.0, peak_roll=math.radians(6.5)),
        made_up_summary("held", 4.0, peak_roll=math.radians(4.0)),
        made_up_summary("swing", 4.0, peak_roll=math.radians(3.0)),
        made_up_summary("swing", 5.0, peak_roll=math.radians(1.0)),
    ]
    said = findings.held_beside_swing(runs)
    assert "at 1 of 2 speeds the swinging car leans less" in said
    assert "+4.5° at 3.00 m/s" in said


def test_late_and_missing_triggers_are_named_with_their_times() -> None:
    runs = [
        made_up_summary("swing", 3.33, trigger=2.13),
        made_up_summary("swing", 4.44, trigger=2.55),
        made_up_summary("swing", 5.00, trigger=None),
    ]
    said = " ".join(findings.trigger_sentences(runs, threshold=1.0, steering_back=2.5))
    assert "At 4.44 m/s the swing begins only at 2.55 s, 0.05 s after" in said
    assert "At 5.00 m/s the tail never swings: the IMU's yaw rate reaches 0.90 rad/s" in said
    assert "3.33" not in said
    early = " ".join(findings.trigger_sentences(runs[:1], threshold=1.0, steering_back=2.5))
    assert "In every run" in early


def test_tipping_is_that_of_a_rigid_car_on_the_edges_of_its_tyres() -> None:
    # On points under the middle of its tyres 9.81 x 0.14 / 0.2433 = 5.64 m/s2, on edges 0.025 m outside 6.65 m/s2.
    tailless = next(r for r in published_values() if r.source == "Table 7.1")
    run = made_up_summary(raw={"max_linear_acceleration_m_per_s2": 6.2})
    car = {"track": 0.28, "com_height": 0.2433, "tyre_friction": 0.6, "tyre_width": 0.05, "tyre_shape": "ellipsoid"}
    said = " ".join(findings.tipping_sentences(car, 9.81, tailless, run))
    assert "tips from 5.64 m/s²" in said
    assert "5.01 m/s², -11 % beside" in said
    assert "6.20 m/s² raw (+1.19)" in said
    assert "7.16 m/s²" in said  # 3.30 m/s x 2.17 rad/s
    edges = " ".join(findings.tipping_sentences(car | {"tyre_shape": "cylinder"}, 9.81, tailless, run))
    assert "stand 0.165 m beside" in edges
    assert "tips from 6.65 m/s²" in edges


def test_a_jolt_is_told_from_cornering() -> None:
    jolt = made_up_summary(
        "swing",
        raw={"max_linear_acceleration_m_per_s2": 14.0},
        filtered={"max_linear_acceleration_m_per_s2": 4.5},
    )
    assert "14.00 m/s², is a jolt" in findings.jolt_sentence([jolt, made_up_summary("held")])
    assert findings.jolt_sentence([made_up_summary("held")]) == ""


class _Reader(HTMLParser):
    """Addresses, tags that are open at the end, and the width of each table row."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.open: list[str] = []
        self.rows: list[list[int]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("href", "src")]
        if tag == "table":
            self.rows.append([])
        if tag == "tr":
            self.rows[-1].append(0)
        if tag in ("td", "th"):
            self.rows[-1][-1] += 1

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def _read(text: str) -> _Reader:
    reader = _Reader()
    reader.feed(text)
    reader.close()
    return reader


def test_text_is_escaped_once_wherever_it_stands() -> None:
    odd = '<script>"a" & b</script>'
    parts = [
        odd,
        ("see", Link(odd, odd)),
        Heading(odd),
        Finding([Bullets([odd])]),
        Table([odd], [[odd], [Noted(odd, odd)]]),
        Plot("a.png", odd, odd),
        Folded(odd, [Preformatted(odd)]),
    ]
    text = Page(odd, odd, [Section(odd, parts)]).html()
    assert "<script" not in text
    assert "&amp;amp;" not in text
    assert _read(text).text.count(odd) == 16  # title, heading, lead and navigation count too


def test_columns_of_numbers_are_set_to_the_right() -> None:
    rows = [["a", "1.5", "-", "1 to 2", "+3 %", "nan"], ["2 b", "2e-05", "-4.0", "", "12.0° (11.0 .. 13.0)", "1.2 kg"]]
    assert Table(list("nabcde"), rows).numbers == [False, True, True, True, True, False]
    assert Table(["empty"], []).numbers == [False]


def test_files_of_a_folder_are_all_made_before_any_is_written(tmp_path: Path) -> None:
    drawing, axes = new_figure(4.0, 3.0)
    axes[0, 0].plot([0, 1])
    plot = Plot(drawing, "A caption.", "A line", "line")
    page = Page("A page", "", [Section("One", [plot])])
    table = pd.DataFrame({"a": [1, 2]})
    written = write_files(tmp_path, {"a.csv": table, "a.parquet": table, "index.html": page, "a.txt": "é"})
    assert [path.name for path in written] == ["a.csv", "a.parquet", "line.png", "index.html", "a.txt"]
    assert (tmp_path / "line.png").read_bytes() == plot.data
    assert 'src="line.png"' in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert pd.read_parquet(tmp_path / "a.parquet").equals(pd.read_csv(tmp_path / "a.csv"))
    with pytest.raises(UndefinedError):
        write_files(tmp_path, {"a.txt": "new", "index.html": Page("A", "", [Section("One", [None])])})  # type: ignore[list-item]
    assert (tmp_path / "a.txt").read_text(encoding="utf-8") == "é"


@pytest.fixture(scope="module")
def report(standard_runs: dict[str, RunLog]) -> str:
    logs = {f"{mode}_3.33": run for mode, run in standard_runs.items()}
    summaries = [summarise(run, name) for name, run in logs.items()]
    files = ReportFiles(
        summary="summary.csv",
        logs={name: f"logs/{name}.parquet" for name in logs},
        replays={"swing_3.33": "replay_swing_3.33.html"},
        strips={"swing_3.33": "strip_swing_3.33.png"},
    )
    return turn_report(summaries, logs, ["none_3.33", "swing_3.33"], files).html()


def test_the_page_is_well_formed_and_needs_no_network(report: str) -> None:
    reader = _read(report)
    assert reader.open == []
    for address in reader.addresses:
        assert address.startswith(("data:image/png;base64,", "#")) or re.fullmatch(r"[\w./-]+", address), address
        assert not address.startswith(("/", ".."))
    for rows in reader.rows:
        assert len(set(rows)) == 1, rows
    anchors = {address[1:] for address in reader.addresses if address.startswith("#")}
    assert anchors == set(re.findall(r'<section id="(\w+)"', report))


def test_every_picture_is_described(report: str) -> None:
    pictures = re.findall(r"<img [^>]*>", report)
    assert len(pictures) >= 8
    assert all(re.search(r'alt="[^"]{10,}"', found) for found in pictures)


def test_the_runs_stand_in_the_text(report: str, standard_runs: dict[str, RunLog]) -> None:
    text = _read(report).text
    run = summarise(standard_runs["none"], "none_3.33").metrics
    assert f"{run.raw.max_yaw_rate_rad_per_s:.2f}" in text
    assert f"{run.raw.max_yaw_rate_rad_per_s - 2.17:+.2f}" in text  # Table 7.1
    assert f"{math.degrees(run.heading_change_rad):.1f}°" in text
    assert "Table 7.4" in text  # named as one that no run corresponds to
    assert standard_runs["none"].versions["drake"] in text


def test_tyre_damping_that_is_not_representable_is_stated(report: str) -> None:
    # 986.93 N s/m at 8 kg / 4 wheels and 1480.56 N s/m at 4.5 kg / 4 wheels, g = 9.81 m/s2: 50 to 134 s/m.
    assert "50 to 134 s/m over the masses that the car may have (4.5 to 8 kg)" in _read(report).text


def test_words_of_the_thesis_are_explained_beside_its_figures(report: str) -> None:
    assert "Kohut is the thesis' measure of a turn" in _read(report).text
    assert "E with a number is an entry of models/published/ERRATA.md" in report


def test_parameters_that_are_published_nowhere_stand_out(report: str) -> None:
    calibrated = r'<tr class="marked"><td>com_height</td>.*?◆ calibrated: calibration/car\.yaml.*?0\.12\xa0to\xa00\.32'
    assert re.search(calibrated, report)
    assert re.search(r'<tr class="marked"><td>knuckle_mass</td>.*?◆ assumed.*?0\.02\xa0to\xa00\.1', report)
    assert not re.search(r'<tr class="marked"><td>tyre_stiffness_front</td>', report)
