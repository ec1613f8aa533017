"""Live cells of a notebook: a replay or Meshcat in the page, and sliders that call a function."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.extras import install_command
from aerodima.workbench.core.ranges import check_range

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from aerodima.workbench.logs.schema import RunLog


@dataclass(frozen=True)
class LiveFrame:
    """A page inside a notebook; where it cannot be shown, as in a stored notebook, a line says what
    it would be.

    Attributes:
        words: line that stands for the page.
        source: HTML attribute that gives the frame its page, with its value escaped.
        height: height of the frame, pixels.
    """

    words: str
    source: str
    height: int

    def _repr_html_(self) -> str:
        return (
            f'<iframe {self.source} width="100%" height="{self.height}" style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        """Returns the line that stands for the page."""
        return self.words


def live_frame(shown: RunLog | Meshcat, height: int = 480) -> LiveFrame:
    """Shows the replay of a run with its signals, or a Meshcat, as a frame in a notebook.

    Args:
        shown: log of a run that can be replayed, or an open Meshcat.
        height: height of the frame, pixels, 100 to 4000.

    Raises:
        UserError: height out of range, or `shown` is neither of the two.
        LogError: the log cannot be replayed.
    """
    from aerodima.workbench.logs.schema import RunLog
    from aerodima.workbench.view.captions import run_caption

    check_range("live_frame: height", height, 100, 4000, "pixels")
    if isinstance(shown, RunLog):
        from aerodima.workbench.view.replay_page import replay_page

        words = f"live when this cell runs: the replay with its signals, {run_caption(shown).text}"
        return LiveFrame(words, f'srcdoc="{html.escape(replay_page(shown))}"', height)
    if not hasattr(shown, "web_url"):
        raise UserError(
            f"live_frame: a {type(shown).__name__}; must be a run log, or an open Meshcat"
        )
    return LiveFrame(
        "live when this cell runs: Meshcat", f'src="{html.escape(shown.web_url())}"', height
    )


def sliders(function: Callable[..., Any], **ranges: tuple[float, float, float]) -> None:
    """Calls a function with the values of sliders, again whenever one is released; only once
    without ipywidgets.

    Args:
        function: function that draws a figure or prints; called with a number per slider.
        ranges: lowest value, highest value and start of each argument; a slider has 20 steps.

    Raises:
        UserError: a start outside its range.
    """
    for name, (low, high, start) in ranges.items():
        if not low <= start <= high or low == high:
            raise UserError(
                f"sliders: {name} starts at {start:g}; must be {low:g} to {high:g}, not one value"
            )
    try:
        from ipywidgets import FloatSlider, interact
    except ImportError:
        print(
            f"sliders need ipywidgets: {install_command('notebooks')}; here with the values at the "
            "start"
        )
        function(**{name: start for name, (_, _, start) in ranges.items()})
        return
    shown = {}
    for name, (low, high, start) in ranges.items():
        step = (high - low) / 20
        shown[name] = FloatSlider(start, min=low, max=high, step=step, continuous_update=False)
    interact(function, **shown)
