"""Draws which folder uses which, from the imports that the code has: `python -m tests.import_picture`.

An arrow goes from a folder to one that imports it, the way that values take; arrows that others imply are left out. The
picture is `docs/concepts/imports.svg`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import mean

from tests.test_homes import LAYERS, ROOT, imports, module_of

PICTURE = ROOT / "docs" / "concepts" / "imports.svg"
PACKAGES = ("optimisation", "workbench", "hardware")
"""From left to right."""
COLOURS = {"optimisation": "#f4f2ec", "workbench": "#eef3f7", "hardware": "#f3eef4"}
LETTER, HEIGHT, GAP, ROW, EDGE = 7.4, 28, 18, 62, 26
"""Pixels: width of a letter, height of a box, between boxes, from row to row, around a package."""
SWEEPS = 12

Folder = tuple[str, str]
Arrow = tuple[Folder, Folder]


def folder_arrows() -> set[Arrow]:
    """(imported, importing), each (package, folder), without folders that import themselves."""
    found = set()
    for package in PACKAGES:
        for path in (ROOT / package).glob("*/**/*.py"):
            to = (package, module_of(path)[1])
            used = {(name[0], name[1]) for name in imports(path.read_text(encoding="utf-8")) if len(name) > 1}
            found |= {(start, to) for start in used if start != to and start[1] in LAYERS[start[0]]}
    return found


def reduced(arrows: set[Arrow]) -> set[Arrow]:
    """Without the arrows that a longer way implies."""
    after: dict[Folder, set[Folder]] = {}
    for start, end in arrows:
        after.setdefault(start, set()).add(end)

    def reached(starts: Iterable[Folder]) -> set[Folder]:
        seen: set[Folder] = set()
        waiting = list(starts)
        while waiting:
            waiting += after.get(place := waiting.pop(), set()) - seen
            seen |= after.get(place, set())
        return seen

    return {(start, end) for start, end in arrows if end not in reached(after[start] - {end})}


@dataclass
class Panel:
    """The folders of a package in rows: each stands below all that it imports. A folder's key is its name; a long arrow
    has a bend in each row that it passes.
    """

    package: str
    arrows: list[tuple[str, str]]
    rows: list[list[str]] = field(default_factory=list)
    ways: list[list[str]] = field(default_factory=list)
    x: dict[str, float] = field(default_factory=dict)
    y: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        depth: dict[str, int] = {}
        for name in LAYERS[self.package]:  # whatever it imports comes before it
            depth[name] = 1 + max((depth[start] for start, end in self.arrows if end == name), default=-1)
        self.rows = [[name for name in depth if depth[name] == row] for row in range(1 + max(depth.values()))]
        for start, end in self.arrows:
            bends = [f"{start}>{end}>{row}" for row in range(depth[start] + 1, depth[end])]
            for row, bend in enumerate(bends, depth[start] + 1):
                self.rows[row].append(bend)
            self.ways.append([start, *bends, end])
        self._sort()
        self._place()

    @property
    def width(self) -> float:
        return max(map(self._row_width, self.rows)) + 2 * EDGE

    def _row_width(self, row: list[str]) -> float:
        return sum(box_width(name) + GAP for name in row) - GAP

    def _sort(self) -> None:
        """Each folder near the middle of those that it is joined to, row by row, down and up again."""
        joined: dict[str, list[str]] = {name: [] for row in self.rows for name in row}
        for way in self.ways:
            for start, end in pairwise(way):
                joined[start].append(end)
                joined[end].append(start)
        for sweep in range(SWEEPS):
            for row in self.rows if sweep % 2 == 0 else reversed(self.rows):
                place = {name: index / max(1, len(r) - 1) for r in self.rows for index, name in enumerate(r)}
                row.sort(key=lambda name: (mean(place[other] for other in [name, *joined[name]]), name))

    def _place(self) -> None:
        for number, row in enumerate(self.rows):
            left = (self.width - self._row_width(row)) / 2
            for name in row:
                self.x[name] = left + box_width(name) / 2
                self.y[name] = 2 * EDGE + number * ROW + HEIGHT / 2
                left += box_width(name) + GAP


def box_width(name: str) -> float:
    return 0 if ">" in name else LETTER * len(name) + 20


def draw() -> str:
    """The picture as SVG."""
    arrows = reduced(folder_arrows())
    panels = {
        package: Panel(package, sorted((a[1], b[1]) for a, b in arrows if a[0] == b[0] == package))
        for package in PACKAGES
    }
    lines, left, offsets = [], 0.0, {}
    height = max(EDGE + ROW * len(panel.rows) for panel in panels.values()) + EDGE
    for package, panel in panels.items():
        offsets[package], width, colour = left, panel.width, COLOURS[package]
        lines += [
            f'<rect x="{left:.0f}" y="0" width="{width:.0f}" height="{height}" rx="8" fill="{colour}"/>',
            f'<text x="{left + width / 2:.0f}" y="24" text-anchor="middle" font-weight="bold">{package}</text>',
        ]
        left += width + 2 * EDGE
    lines += [_curve(panels, offsets, arrow) for arrow in sorted(arrows) if arrow[0][0] != arrow[1][0]]
    lines += [_line(panel, offsets[package], way) for package, panel in panels.items() for way in panel.ways]
    lines += [
        box for package, panel in panels.items() for name in panel.x for box in _box(panel, offsets[package], name)
    ]
    return _HEAD.format(width=round(left - 2 * EDGE), height=height) + "\n".join(lines) + "\n</svg>\n"


_HEAD = """<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" font-size="13" \
font-family="DejaVu Sans, Verdana, sans-serif">
<title>Which folder uses which</title>
<desc>Made by tests/import_picture.py from the imports of the code: an arrow goes from a folder to one that imports \
it; arrows that others imply are left out.</desc>
<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="6" markerHeight="6" orient="auto">\
<path d="M0 0 10 5 0 10z" fill="#37474f"/></marker></defs>
<rect width="{width}" height="{height}" fill="#ffffff"/>
"""


def _box(panel: Panel, left: float, name: str) -> list[str]:
    if ">" in name:
        return []
    x, y, width = left + panel.x[name], panel.y[name], box_width(name)
    return [
        f'<rect x="{x - width / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{width:.0f}" height="{HEIGHT}" rx="5" '
        'fill="#ffffff" stroke="#37474f" stroke-width="1.3"/>',
        f'<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle" fill="#1c2430">{name}</text>',
    ]


def _line(panel: Panel, left: float, way: list[str]) -> str:
    """From the foot of a box, through the bends, to the head of another."""
    points = [(left + panel.x[name], panel.y[name]) for name in way]
    points[0] = points[0][0], points[0][1] + HEIGHT / 2
    points[-1] = points[-1][0], points[-1][1] - HEIGHT / 2
    path = f"M{points[0][0]:.0f} {points[0][1]:.0f}"
    for (x0, y0), (x1, y1) in pairwise(points):
        middle = (y0 + y1) / 2
        path += f"C{x0:.0f} {middle:.0f} {x1:.0f} {middle:.0f} {x1:.0f} {y1:.0f}"
    return f'<path d="{path}" fill="none" stroke="#37474f" stroke-width="1.3" marker-end="url(#a)"/>'


def _curve(panels: dict[str, Panel], offsets: dict[str, float], arrow: Arrow) -> str:
    """From one package to another: from the side of a box, behind what stands there, to the side of a box."""
    (package, start), (other, end) = arrow
    side = 1 if offsets[other] > offsets[package] else -1
    x0 = offsets[package] + panels[package].x[start] + side * box_width(start) / 2
    x1 = offsets[other] + panels[other].x[end] - side * box_width(end) / 2
    y0, y1, middle = panels[package].y[start], panels[other].y[end], (x0 + x1) / 2
    return (
        f'<circle cx="{x0 + side * 3:.0f}" cy="{y0:.0f}" r="3" fill="#c75b39"/>'
        f'<path d="M{x0:.0f} {y0:.0f}C{middle:.0f} {y0:.0f} {middle:.0f} {y1:.0f} {x1:.0f} {y1:.0f}" fill="none" '
        'stroke="#c75b39" stroke-width="1.1" marker-end="url(#a)"/>'
    )


if __name__ == "__main__":
    PICTURE.parent.mkdir(exist_ok=True)
    Path(PICTURE).write_text(draw(), encoding="utf-8")
