"""The templates of pages, and the library that draws their interactive plots."""

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import jinja2
    import markupsafe


def render(template: str, **values: Any) -> str:
    """A template of `templates/` with values; every text in them is escaped."""
    return _templates().get_template(template).render(values)


@cache
def _templates() -> "jinja2.Environment":
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    loader = FileSystemLoader(Path(__file__).parent / "templates")
    made = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    made.tests["a"] = lambda part, name: type(part).__name__ == name
    made.globals["shipped"] = _shipped
    return made


PLOT_LIBRARY = "uPlot-1.6.32"
"""Folder of the library that draws interactive plots, as its authors publish it, with its licence (MIT)."""


def _shipped(name: str) -> "markupsafe.Markup":
    """A file of the plot library, for a page; its template syntax, if it had any, is not read."""
    from markupsafe import Markup

    return Markup((Path(__file__).parent / "templates" / PLOT_LIBRARY / name).read_text(encoding="utf-8"))
