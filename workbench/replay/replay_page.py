"""The replay as one HTML page that needs nothing else: Meshcat with the animation, a title over it, a bar below."""

import html
from pathlib import Path

import numpy as np
from pydrake.geometry import Rgba

from aerodima.workbench.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.caption import Caption, caption_of, speed_and_roll
from aerodima.workbench.replay.controls import page_controls
from aerodima.workbench.replay.forces import AIR_COLOUR, AIR_SCALE, WHEEL_COLOUR, WHEEL_SCALE
from aerodima.workbench.replay.recording import COM_COLOUR, TIP_COLOUR, frame_rows, record_run
from aerodima.workbench.replay.viewer import open_meshcat

_STYLE = """
<style>
  #run { position: fixed; left: 16px; top: 14px; max-width: 76vw; padding: 10px 14px; pointer-events: none;
         font: 15px/1.45 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1c2430;
         background: rgba(255, 255, 255, 0.82); border-radius: 6px; }
  #run h1 { margin: 0; font-size: 20px; } #run p { margin: 2px 0; }
  #run .survived { color: #14713a; } #run .flipped { color: #b3261e; } #run .unknown { color: #6b5b00; }
  #run-now { font-variant-numeric: tabular-nums; white-space: pre; }
  #run .key { font-size: 13px; } #run i { font-style: normal; font-weight: bold; }
</style>
"""


def write_replay_html(run_log: RunLog, path: Path | str, *, force: bool = False, rate: float = 1.0) -> Path:
    """Writes the replay of a run as one self-contained HTML file, which plays when it is opened.

    Args:
        run_log: of a simulated run.
        path: the file; refused when it exists, unless `force`.
        rate: seconds of the run per second of the replay.

    Raises:
        UserError: the file exists or cannot be written, rate out of range.
        LogError: the log cannot be replayed.
    """
    path = Path(path)
    refuse_existing(path, force, UserError)
    text = replay_page(run_log, rate)
    return write_atomically(path, lambda temporary: _write(temporary, text), force, UserError)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def replay_page(run_log: RunLog, rate: float = 1.0) -> str:
    """The page of `write_replay_html` as text."""
    meshcat = open_meshcat()
    logged = record_run(run_log, meshcat, rate)
    caption = caption_of(run_log)
    overlay = _STYLE + _title(caption, with_tail=logged.car.tail is not None, rate=rate) + _readout(run_log, rate)
    page = _replace_once(
        meshcat.StaticHtml(), "<title>Drake MeshCat</title>", f"<title>{_escaped(caption.text)}</title>"
    )
    return _replace_once(page, "</body>", overlay + "</body>")


def _title(caption: Caption, with_tail: bool, rate: float) -> str:
    speed = "" if rate == 1.0 else f", replay at {rate:g} times its speed"
    arrow, line = "&#9650;", "&#9644;"
    keys = [(arrow, "ground on the wheels", WHEEL_COLOUR), (line, "path of the centre of mass", _rgb(COM_COLOUR))]
    if with_tail:
        keys.insert(1, (arrow, f"air on the tail ({AIR_SCALE / WHEEL_SCALE:.0f} times longer)", AIR_COLOUR))
        keys.append((line, "path of the tail tip", _rgb(TIP_COLOUR)))
    legend = " &nbsp; ".join(
        f'<i style="color: {_css(colour)}" aria-hidden="true">{sign}</i> {name}' for sign, name, colour in keys
    )
    return (
        f'<div id="run"><h1>{_escaped(caption.name)}</h1>'
        f'<p>{_escaped(caption.facts)}: <b class="{caption.result}">{_escaped(caption.outcome)}</b>{speed}</p>'
        f'<p id="run-now"></p><p class="key">{legend}</p></div>'
    )


def _readout(run_log: RunLog, rate: float) -> str:
    rows, frames_per_second = frame_rows(run_log.time, rate)
    speed, roll = speed_and_roll(run_log)
    data = {
        "frames_per_second": frames_per_second,
        "time": run_log.time[rows].round(3).tolist(),
        "speed": speed[rows].round(3).tolist(),
        "roll": np.degrees(roll[rows]).round(2).tolist(),
    }
    return page_controls(data)


def _rgb(colour: Rgba) -> tuple[float, float, float]:
    return colour.r(), colour.g(), colour.b()


def _css(colour: tuple[float, float, float]) -> str:
    return "rgb(" + ", ".join(str(round(255 * part)) for part in colour) + ")"


def _escaped(text: str) -> str:
    return html.escape(text)


def _replace_once(page: str, mark: str, text: str) -> str:
    """Replaces the last `mark`; Drake's scripts before it may hold the same characters."""
    before, found, after = page.rpartition(mark)
    if not found:
        raise RuntimeError(f"Drake's page has no {mark!r} any more; the title of the replay has no place")
    return before + text + after
