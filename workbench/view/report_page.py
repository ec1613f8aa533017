"""Pages as plain objects; `templates/` defines their look, `write_files` puts them in a folder.

A part of a page is a text (a paragraph) or one of the classes below; a text is a string, a `Link`,
or a tuple of these, which a blank separates.
The templates escape every text once.
"""

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from matplotlib.figure import Figure

from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.file_reading import Facts, Json
from aerodima.workbench.view.chart_panels import chart_panels
from aerodima.workbench.view.figure_style import png

if TYPE_CHECKING:
    import jinja2
    import markupsafe
    import pandas as pd


_PIXELS_PER_INCH = 95
"""Resolution of figures on the page. Letters have the same size in all figures, and a figure of 11
inches fills the page."""
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?( ?%|°)?(\s(to\s|\().*)?|nan|[-–]?")
"""Pattern of cells that are aligned to the right: a number, a range, or none."""
Content: TypeAlias = "Page | pd.DataFrame | str | bytes"
PLOT_LIBRARY = "uPlot-1.6.32"
"""Folder of the library for interactive plots, as its authors publish it, with licence (MIT)."""


@dataclass(frozen=True)
class Link:
    """A link to a file beside the page or to an anchor; without words of its own it shows the
    address.
    """

    target: str
    words: str = ""


Text: TypeAlias = str | Link | tuple[str | Link, ...]


@dataclass(frozen=True)
class Finding:
    """Result of a chapter, set off from the rest."""

    parts: Sequence["Part"]


@dataclass(frozen=True)
class Bullets:
    """A list."""

    items: Sequence[Text]


@dataclass(frozen=True)
class Table:
    """A table; columns of numbers are aligned to the right.

    Args:
        header: names of the columns, with their units.
        rows: cells of each row.
        marked: indices of the rows that stand out.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[Text]]
    marked: Sequence[int] = ()

    @property
    def numbers(self) -> list[bool]:
        """Says which columns hold numbers alone."""
        columns = list(zip(*self.rows, strict=True)) or [("none",)] * len(self.header)
        return [
            all(isinstance(cell, str) and _NUMBER.fullmatch(cell) for cell in column)
            for column in columns
        ]


@dataclass(frozen=True)
class Plot:
    """A figure inside the page, or beside it.

    Args:
        drawing: figure that is drawn.
        caption: text below the figure.
        alternative: description of the figure for those who cannot see it.
        name: name of the figure's PNG beside the page, without ending; "" for a figure inside.
    """

    drawing: Figure
    caption: Text
    alternative: str
    name: str = ""

    @cached_property
    def data(self) -> bytes:
        """Draws the figure as PNG."""
        return png(self.drawing)

    @property
    def source(self) -> str:
        """Gives the address of the image."""
        if self.name:
            return f"{self.name}.png"
        return f"data:image/png;base64,{base64.b64encode(self.data).decode()}"

    @property
    def width(self) -> int | None:
        """Gives the width on the page, pixels; None for an image beside it, which has its own."""
        return None if self.name else round(_PIXELS_PER_INCH * self.drawing.get_figwidth())


@dataclass(frozen=True)
class InteractivePlot(Plot):
    """A figure in which a reader can zoom and read values off; printed, or without scripts, it is
    the figure's image.

    Args:
        panels: panels made by `chart_panels`.
    """

    panels: Json = field(default_factory=dict)


@dataclass(frozen=True)
class Folded:
    """Content that opens on a click."""

    summary: str
    parts: Sequence["Part"]


@dataclass(frozen=True)
class Preformatted:
    """Text in columns, such as JSON."""

    text: str


@dataclass(frozen=True)
class Templated:
    """Part with a template of its own, and the values that it names."""

    template: str
    values: Facts


def zoomable(drawing: Figure, alternative: str) -> Plot:
    """Makes an interactive plot of a figure that was not drawn yet; see `chart_panels`."""
    return InteractivePlot(drawing, "", alternative, panels=chart_panels(drawing))


Part: TypeAlias = Text | Finding | Bullets | Table | Plot | Folded | Preformatted | Templated


@dataclass(frozen=True)
class Section:
    """One chapter: its title and its parts."""

    title: str
    parts: Sequence[Part]

    @property
    def anchor(self) -> str:
        """Makes the target of links to the section."""
        return re.sub(r"\W+", "_", self.title.lower()).strip("_")


@dataclass(frozen=True)
class Page:
    """A whole document: title, lead on what it is about, chapters."""

    title: str
    lead: Text
    sections: Sequence[Section]

    def html(self) -> str:
        """Renders the document; equal pages give equal text."""
        return render("page.html", page=self)

    @property
    def parts(self) -> list[Part]:
        """Lists the parts of the chapters, one after the other."""
        return [part for section in self.sections for part in section.parts]

    @property
    def interactive(self) -> bool:
        """Says whether the plot library must be on the page for its plots."""
        return any(isinstance(part, InteractivePlot) for part in self.parts)


def write_files(
    folder: Path,
    contents: Mapping[str, Content],
    error: type[UserError] = UserError,
) -> list[Path]:
    """Writes files into a folder, each in one step, and none of them before all are made; those
    that exist are replaced.

    Args:
        folder: folder of the files; made when it is not there.
        contents: content of each file by its name; a table becomes CSV or Parquet by the name, a
            page brings the plots beside it.
        error: class of the error raised where a file cannot be written.
    """
    made: dict[str, str | bytes] = {}
    for name, content in contents.items():
        if isinstance(content, Page):
            for part in content.parts:
                if isinstance(part, Plot) and part.name:
                    made[f"{part.name}.png"] = part.data
            made[name] = content.html()
        elif isinstance(content, str | bytes):
            made[name] = content
        elif name.endswith(".csv"):
            made[name] = content.to_csv(index=False)
        else:
            made[name] = content.to_parquet(index=False)
    return [write_atomically(folder / name, content, True, error) for name, content in made.items()]


def percent(ratio: float) -> str:
    """Writes a ratio as `+12 %`."""
    return f"{100 * ratio:+.0f} %"


def render(template: str, **values: Any) -> str:
    """Fills a template of `templates/` with values; every text in them is escaped."""
    return _templates().get_template(template).render(values)


@cache
def _templates() -> "jinja2.Environment":
    """Opens the folder of templates."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).parent / "templates")
    templates = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.tests["a"] = lambda part, name: type(part).__name__ == name
    templates.globals["shipped"] = _shipped
    return templates


def _shipped(name: str) -> "markupsafe.Markup":
    """Reads a file of the plot library for a page; template syntax in it, if any, is not
    interpreted.
    """
    from markupsafe import Markup

    return Markup(
        (Path(__file__).parent / "templates" / PLOT_LIBRARY / name).read_text(encoding="utf-8")
    )
