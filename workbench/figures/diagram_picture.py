"""The block diagram of a Drake diagram as a picture, drawn by Graphviz."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from typing import TYPE_CHECKING

from aerodima.workbench.errors import UserError

if TYPE_CHECKING:
    from pydrake.systems.framework import System


@dataclass(frozen=True)
class DiagramPicture:
    """What Graphviz draws; a notebook shows it as a picture, or without Graphviz a line.

    Attributes:
        text: in Graphviz's language.
    """

    text: str

    def render(self, kind: str = "svg") -> bytes:
        """The picture as a file's content: svg, png, pdf, or what else Graphviz knows.

        Raises:
            UserError: Graphviz is not installed, or refuses text or kind.
        """
        program = shutil.which("dot")
        if program is None:
            raise UserError("Graphviz is not installed: `aerodima doctor` says how; the text is in `.text`")
        done = subprocess.run([program, f"-T{kind}"], input=self.text.encode(), capture_output=True, check=False)
        if done.returncode != 0:
            raise UserError(f"Graphviz failed: {done.stderr.decode(errors='replace').strip()}")
        return done.stdout

    def _repr_svg_(self) -> str | None:
        """As wide as the page, not as Graphviz's boxes are."""
        if shutil.which("dot") is None:
            return None
        return re.sub(r'<svg width="\S*" height="\S*"', '<svg width="100%"', self.render().decode(), count=1)

    def __repr__(self) -> str:
        """Says what is missing where it stands in the place of the picture."""
        return "block diagram" if shutil.which("dot") else "block diagram: not drawn, Graphviz is not installed"


def draw_diagram(diagram: System, depth: int = 1) -> DiagramPicture:
    """Draws a diagram: a box per system, an arrow per connection.

    Args:
        diagram: built.
        depth: how many levels of nested diagrams are opened.

    Raises:
        UserError: depth below 1.
    """
    if depth < 1:
        raise UserError(f"draw_diagram: depth is {depth}; allowed: 1 and more")
    return DiagramPicture(diagram.GetGraphvizString(max_depth=depth))
