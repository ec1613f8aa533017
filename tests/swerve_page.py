"""Stores a comparison of swerves and writes its tables and pictures into the page of results:
`python -m tests.swerve_page FOLDER...`, folders of `aerodima swing judge`.

The motions of the case that the demo shows are copied to `models/swings`, and its settings name
them there; settings of other full runs that name a motion are left out.
"""

import json
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from aerodima.optimisation import AIMS, summarise_swerves
from aerodima.optimisation.swerve.swerve_table import swerve_figure
from aerodima.workbench import simulate
from aerodima.workbench.car.swerve import LATER, SOON, outline_from_above
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.figure_style import new_figure, png, styled
from aerodima.workbench.view.run_figures import RUN_STYLES
from aerodima.workbench.view.swerve_chapter import (
    AROUND,
    PLACE,
    SWERVES,
    ShownSwerve,
    load_shown_swerve,
)
from tests.code_measure import ROOT

PAGE = ROOT / "docs" / "swerves.md"
NO_TAIL = "no tail"
BEGIN = "<!-- tables of models/swerve/swerves.csv -->\n"
END = "<!-- end of the tables -->\n"
SWING = "controller.swing_file="
FIRST_PAGES = (ROOT / "README.md", ROOT / "docs" / "index.md", PAGE)
FIRST_BEGIN = "<!-- first table of models/swerve/swerves.csv -->\n"
FIRST_END = "<!-- end of the first table -->\n"
FIRST_FLOORS = ("x 1", "x 1.2")
FIRST_AIMS = {
    "aside-0.5": ("aside after 0.5 s", "full"),
    "aside-1.0": ("aside after 1 s", "full"),
    "course": ("change of course in 1 s", "reduced"),
    "sustained": ("held turn", "reduced"),
}
FIRST_CANDIDATES = {
    "feedback": "tail with the feedback law",
    "bound": "best motion of the tail that was found",
    "low ballast": "no tail, its mass bolted low",
    "tail folded back, locked": "tail folded back and locked",
}


@styled()
def figure_from_above(run_logs: Mapping[str, RunLog]) -> Figure:
    """Plots outlines of cars from above, `SOON` and `LATER` after the start of the steering; the
    course at the start leads to the right, in m.
    """
    figure, axes = new_figure(9.0, 4.0, 1, 2)
    instants = (SOON, LATER)
    for (name, log), (colour, line) in zip(run_logs.items(), RUN_STYLES, strict=False):
        ahead, left = outline_from_above(log, instants)[:, AROUND]
        for place, axis in enumerate(axes[0]):
            look = {"edgecolor": colour, "linestyle": line, "label": name}
            axis.fill(ahead[:, place], left[:, place], fill=False, **look)
    for axis, instant in zip(axes[0], instants, strict=True):
        axis.set_aspect("equal")
        axis.set_title(f"after {instant:g} s")
        axis.set_xlabel("ahead, m")
    axes[0, 0].set_ylabel("to the left, m")
    axes[0, 0].legend(loc="upper center", bbox_to_anchor=(1.0, -0.2), ncols=3)
    return figure


def page_cell(row: Mapping[str, Any]) -> str:
    """The median without tail in the unit of the aim, of all others the gain over it with its
    interval, and how many cars complete the swerve where one does not.
    """
    if not row["with_value"]:
        return "none"
    gain, low, high = (100.0 * row[key] for key in ("gain", "gain_low", "gain_high"))
    cell = f"{gain:+.0f} %"
    if row["cars"] > 1:
        cell += f" ({low:+.0f} to {high:+.0f})"
    if row["candidate"] == NO_TAIL:
        cell = f"{row['median']:.3f} {AIMS[row['aim']].unit}"
    if row["with_value"] < row["cars"]:
        cell += f", {row['with_value']:.0f} of {row['cars']:.0f}"
    return cell


def page_tables(table: pd.DataFrame) -> str:
    """The tables of the page: one for each kind of car and aim, with a column for each floor and
    speed and a line for each candidate.
    """
    parts = []
    for (plant, aim), own in table.groupby(["plant", "aim"], sort=False):
        places = sorted({*zip(own["floor"], own["speed_m_per_s"], strict=True)})
        cells: dict[str, dict[Any, str]] = {}
        for row in summarise_swerves(own).to_dict("records"):
            place = (row["floor"], row["speed_m_per_s"])
            cells.setdefault(row["candidate"], {})[place] = page_cell(row)
        columns = [f"friction {floor}, {speed:g} m/s" for floor, speed in places]
        lines = [[f"{aim}, {own['car'].nunique()} {plant} cars", *columns]]
        lines.append(["---"] * len(lines[0]))
        lines += [
            [name, *[found.get(place, "") for place in places]] for name, found in cells.items()
        ]
        parts.append("".join(f"| {' | '.join(line)} |\n" for line in lines))
    return "\n".join(parts)


def first_table(table: pd.DataFrame) -> str:
    """The table of the first pages: median gains on `FIRST_FLOORS`, in brackets where the interval
    contains zero; a column of reduced cars has a star.
    """
    plants = {aim: plant for aim, (_, plant) in FIRST_AIMS.items()}
    stars = {"full": "", "reduced": " *"}
    lines = [["", *[words + stars[plant] for words, plant in FIRST_AIMS.values()]]]
    lines.append(["---"] * len(lines[0]))
    for candidate, words in FIRST_CANDIDATES.items():
        cells = [words]
        for aim, plant in plants.items():
            chosen = (table["aim"] == aim) & (table["plant"] == plant)
            summary = summarise_swerves(table[chosen])
            rows = summary[summary["candidate"] == candidate].set_index("floor")
            cells.append(" / ".join(first_gain(rows.loc[floor]) for floor in FIRST_FLOORS) + " %")
        lines.append(cells)
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def first_gain(row: pd.Series) -> str:
    """A gain, in brackets where its interval contains zero."""
    gain = f"{100.0 * row['gain']:+.0f}"
    return f"({gain})" if row["gain_low"] <= 0.0 <= row["gain_high"] else gain


def store(folders: list[Path]) -> None:
    """Writes table, swings and page."""
    parts = [pd.read_csv(folder / "swerves.csv") for folder in folders]
    table = pd.concat(parts, ignore_index=True)
    shown = load_shown_swerve()
    is_shown = (table["plant"] == "full") & table["value"].notna()
    for column in PLACE:
        is_shown &= table[column] == getattr(shown, column)
    names_a_file = table["settings"].str.contains(f"{SWING}/", regex=False, na=False)
    table["settings"] = table["settings"].where(is_shown | ~names_a_file, "")
    for index in table.index[is_shown]:
        settings = json.loads(table.loc[index, "settings"])
        for number, setting in enumerate(settings):
            path = Path(setting.removeprefix(SWING))
            if setting.startswith(SWING) and path.is_file():
                name = f"swerve_{shown.speed_m_per_s:g}_m_per_s"
                shutil.copyfile(path, ROOT / "models" / "swings" / f"{name}.yaml")
                settings[number] = SWING + name
        table.loc[index, "settings"] = json.dumps(settings)
    table.to_csv(ROOT / "models" / SWERVES, index=False)
    put(PAGE, (BEGIN, END), page_tables(table))
    for page in FIRST_PAGES:
        put(page, (FIRST_BEGIN, FIRST_END), first_table(table))
    draw(shown, table)


def part_of(page: Path, marks: tuple[str, str]) -> str:
    """The part of a page between two marks."""
    _, rest = page.read_text(encoding="utf-8").split(marks[0])
    return rest.split(marks[1])[0].strip("\n")


def put(page: Path, marks: tuple[str, str], part: str) -> None:
    """Writes a part of a page between two marks."""
    begin, end = marks
    before, rest = page.read_text(encoding="utf-8").split(begin)
    _, after = rest.split(end)
    page.write_text(f"{before}{begin}\n{part}\n{end}{after}", encoding="utf-8")


def draw(shown: ShownSwerve, table: pd.DataFrame) -> None:
    """Draws the gains of all full cars on the floor that is shown, and the shown swerve."""
    compared = table["plant"] == "full"
    for column in ("tail", "floor", "aim", "speed_m_per_s"):
        compared &= table[column] == getattr(shown, column)
    cars = table.loc[compared, "car"].nunique()
    title = f"{cars} full cars at {shown.speed_m_per_s:g} m/s, friction {shown.floor}, after 0.5 s"
    logs = {name: simulate(run) for name, run in shown.runs().items()}
    pictures = {
        "swerves": swerve_figure(table[compared], title),
        "swerve_from_above": figure_from_above(logs),
    }
    for name, figure in pictures.items():
        (ROOT / "docs" / "pictures" / f"{name}.png").write_bytes(png(figure))


if __name__ == "__main__":
    store([Path(folder) for folder in sys.argv[1:]])
