"""Stores a comparison of swerves and writes its tables and pictures into the page of results:
`python -m tests.swerve_page FOLDER...`, folders of `aerodima swing judge`.

The motions of the case that the demo shows are copied to `models/swings`, and its settings name
them there; settings of other full runs that name a motion are left out.
"""

import json
import shutil
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

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
BEGIN = "<!-- tables of models/swerve/swerves.csv -->\n"
END = "<!-- end of the tables -->\n"
SWING = "controller.swing_file="


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


def page_rows(own: pd.DataFrame) -> Iterator[str]:
    """Rows of a table: the median without tail in the unit of the aim, of all others the gain over
    it with its interval, and how many cars complete the swerve where one does not.
    """
    summary = summarise_swerves(own)
    for candidate, rows in summary.groupby("candidate", sort=False):
        cells = [str(candidate)]
        for row in rows.sort_values("speed_m_per_s").to_dict("records"):
            gain, low, high = (100.0 * row[key] for key in ("gain", "gain_low", "gain_high"))
            cell = f"{gain:+.0f} %"
            if row["cars"] > 1:
                cell += f" ({low:+.0f} to {high:+.0f})"
            if candidate == "no tail":
                cell = f"{row['median']:.3f} {AIMS[row['aim']].unit}"
            if row["with_value"] < row["cars"]:
                cell += f", {row['with_value']:.0f} of {row['cars']:.0f}"
            cells.append(cell if row["with_value"] else "none")
        yield f"| {' | '.join(cells)} |"


def page_tables(table: pd.DataFrame) -> str:
    """The tables of the page, one for each kind of car, floor and aim."""
    parts = []
    for (plant, floor, aim), own in table.groupby(["plant", "floor", "aim"], sort=False):
        speeds = [f"{speed:g} m/s" for speed in sorted(own["speed_m_per_s"].unique())]
        cars = own["car"].nunique()
        words = f"{aim}, friction {floor}, {cars} {plant} car{'s' * (cars > 1)}"
        head = f"| {' | '.join([words, *speeds])} |"
        parts.append("\n".join([head, "|---" * (1 + len(speeds)) + "|", *page_rows(own)]) + "\n")
    return "\n".join(parts)


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
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}\n{page_tables(table)}\n{END}{after}", encoding="utf-8")
    draw(shown, table)


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
