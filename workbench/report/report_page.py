"""The HTML of a report: page, sections, tables, figures. Plain strings; every text passes `html.escape` once."""

import base64
import html
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from aerodima.workbench.figures.figure_style import png

_STYLE = """
body { margin: 0 auto; max-width: 1120px; padding: 24px 28px 80px; color: #1c2430; background: #fff;
       font: 16px/1.55 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 30px; line-height: 1.2; margin: 8px 0 4px; } h2 { font-size: 22px; margin: 48px 0 8px;
     padding-top: 10px; border-top: 2px solid #1c2430; } h3 { font-size: 17px; margin: 26px 0 6px; }
p, li { max-width: 860px; } .lead { font-size: 18px; color: #3a4656; }
nav { margin: 18px 0; padding: 10px 16px; background: #f4f2ec; border-radius: 6px; } nav a { margin-right: 16px; }
a { color: #0b5394; } a:focus, summary:focus { outline: 2px solid #0b5394; outline-offset: 2px; }
figure { margin: 18px 0; } figure img { max-width: 100%; height: auto; display: block; }
figcaption { font-size: 14px; color: #4a5565; max-width: 900px; margin-top: 4px; }
.scroll { overflow-x: auto; margin: 12px 0; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { padding: 4px 10px; border-bottom: 1px solid #d8d8d8; text-align: left; vertical-align: top; }
td.number, th.number { text-align: right; white-space: nowrap; } thead th { border-bottom: 2px solid #1c2430; }
tr.marked td { background: #fbf3dc; } td small { display: block; color: #4a5565; font-size: 13px; }
.finding { border-left: 4px solid #1c2430; background: #f4f2ec; padding: 8px 16px; margin: 16px 0; }
.finding p { margin: 6px 0; }
details { margin: 14px 0; } summary { cursor: pointer; font-weight: 600; }
pre { font-size: 13px; line-height: 1.4; background: #f6f6f6; padding: 12px; overflow-x: auto; }
@media print { nav { display: none; } h2 { break-before: auto; } figure, tr { break-inside: avoid; } }
"""


_PIXELS_PER_INCH = 95
"""Of figures on the page, so that their letters are equally large; one of 11 inches fills it."""


@dataclass(frozen=True)
class Markup:
    """HTML that needs no escaping any more."""

    text: str


Cell = str | Markup


@dataclass(frozen=True)
class Section:
    """One chapter: its anchor, its heading, what stands in it."""

    anchor: str
    heading: str
    parts: tuple[Markup, ...]


def escaped(text: Cell) -> str:
    """Text of a page; `Markup` as it is."""
    return text.text if isinstance(text, Markup) else html.escape(text)


def page(title: str, lead: Cell, sections: Sequence[Section]) -> str:
    """The whole document."""
    links = "".join(f'<a href="#{section.anchor}">{html.escape(section.heading)}</a> ' for section in sections)
    body = "\n".join(
        f'<section id="{section.anchor}">\n<h2>{html.escape(section.heading)}</h2>\n'
        + "\n".join(part.text for part in section.parts)
        + "\n</section>"
        for section in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f'<h1>{html.escape(title)}</h1>\n<p class="lead">{escaped(lead)}</p>\n'
        f'<nav aria-label="Chapters">{links}</nav>\n{body}\n</body>\n</html>\n'
    )


def paragraph(*sentences: Cell) -> Markup:
    """Sentences of one paragraph; empty ones are left out."""
    return Markup("<p>" + " ".join(escaped(sentence) for sentence in sentences if sentence != "") + "</p>")


def heading(text: str) -> Markup:
    """A heading inside a chapter."""
    return Markup(f"<h3>{html.escape(text)}</h3>")


def finding(*paragraphs: Markup) -> Markup:
    """What a chapter comes to, set off from the rest."""
    return Markup('<div class="finding">' + "".join(part.text for part in paragraphs) + "</div>")


def bullets(items: Iterable[Cell]) -> Markup:
    """A list."""
    return Markup("<ul>" + "".join(f"<li>{escaped(item)}</li>" for item in items) + "</ul>")


def link(target: str, text: str) -> Markup:
    """A link to a file beside the page or to an anchor."""
    return Markup(f'<a href="{html.escape(target, quote=True)}">{html.escape(text)}</a>')


def table(
    header: Sequence[str], rows: Iterable[Sequence[Cell]], numbers: Sequence[int] = (), marked: Sequence[int] = ()
) -> Markup:
    """A table.

    Args:
        header: names of the columns, with their units.
        rows: cells.
        numbers: columns that hold numbers and are set to the right.
        marked: rows that stand out.
    """
    aligned = ['class="number"' if column in numbers else "" for column in range(len(header))]
    head = "".join(f'<th scope="col" {a}>{html.escape(name)}</th>' for name, a in zip(header, aligned, strict=True))
    lines = []
    for number, row in enumerate(rows):
        cells = "".join(f"<td {a}>{escaped(cell)}</td>" for cell, a in zip(row, aligned, strict=True))
        lines.append(f'<tr class="marked">{cells}</tr>' if number in marked else f"<tr>{cells}</tr>")
    body = "\n".join(lines)
    return Markup(f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>')


def figure(drawing: Figure, caption: Cell, alternative: str) -> Markup:
    """A figure inside the page.

    Args:
        drawing: the figure.
        caption: below it.
        alternative: what it shows, for those who cannot see it.
    """
    data = base64.b64encode(png(drawing)).decode("ascii")
    width = round(_PIXELS_PER_INCH * drawing.get_figwidth())
    return picture(f"data:image/png;base64,{data}", caption, alternative, width)


def picture(source: str, caption: Cell, alternative: str, width: int | None = None) -> Markup:
    """An image by its address relative to the page; `width` in pixels of the page, None for its own."""
    shown = "" if width is None else f' width="{width}"'
    return Markup(
        f'<figure><img src="{html.escape(source, quote=True)}" alt="{html.escape(alternative, quote=True)}"{shown}>'
        f"<figcaption>{escaped(caption)}</figcaption></figure>"
    )


def noted(text: str, note: str) -> Markup:
    """A cell with a smaller note below its text."""
    return Markup(f"{html.escape(text)}<small>{html.escape(note)}</small>" if note else html.escape(text))


def folded(summary: str, *parts: Markup) -> Markup:
    """Content that opens on a click."""
    return Markup(f"<details><summary>{html.escape(summary)}</summary>{''.join(part.text for part in parts)}</details>")


def preformatted(text: str) -> Markup:
    """Text in columns, such as JSON."""
    return Markup(f"<pre>{html.escape(text)}</pre>")
