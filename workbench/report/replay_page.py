"""The replay as one HTML page that needs nothing else: Meshcat with the animation, a title over it, a bar below."""

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Rgba

from aerodima.workbench.atomic_write import refuse_existing
from aerodima.workbench.errors import UserError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.replay.caption import caption_of, speed_and_roll
from aerodima.workbench.replay.forces import AIR_COLOUR, AIR_SCALE, WHEEL_COLOUR, WHEEL_SCALE
from aerodima.workbench.replay.recording import COM_COLOUR, TIP_COLOUR, frame_rows, record_run
from aerodima.workbench.replay.viewer import open_meshcat
from aerodima.workbench.report.report_page import render, write_files


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
    return write_files(path.parent, {path.name: replay_page(run_log, rate)}, force=force)[0]


def replay_page(run_log: RunLog, rate: float = 1.0) -> str:
    """The page of `write_replay_html` as text: Drake's page of the scene, with title, readout and bar put into it.

    The script of the page drives Meshcat's animator itself, so that a page that holds two replays can show both at the
    same time: it calls `replay.follow()` once and then `replay.show(seconds)` of each.
    """
    meshcat = open_meshcat()
    logged = record_run(run_log, meshcat, rate)
    head, scene = _split(meshcat.StaticHtml(), "<title>Drake MeshCat</title>")
    scene, end = _split(scene, "</body>")
    arrow, line = "▲", "▬"
    keys = [(arrow, "ground on the wheels", _css(WHEEL_COLOUR)), (line, "path of the centre of mass", _css(COM_COLOUR))]
    if logged.car.tail is not None:
        air = f"air on the tail ({AIR_SCALE / WHEEL_SCALE:.0f} times longer)"
        keys.insert(1, (arrow, air, _css(AIR_COLOUR)))
        keys.append((line, "path of the tail tip", _css(TIP_COLOUR)))
    drake = {"head": head, "scene": scene, "end": "</body>" + end}
    return render("replay.html", **drake, caption=caption_of(run_log), keys=keys, rate=rate, run=_frames(run_log, rate))


def _frames(run_log: RunLog, rate: float) -> dict[str, Any]:
    """What the page shows of each frame: time (s), speed (m/s), roll (degrees)."""
    rows, frames_per_second = frame_rows(run_log.time, rate)
    speed, roll = speed_and_roll(run_log)
    return {
        "frames_per_second": frames_per_second,
        "time": run_log.time[rows].round(3).tolist(),
        "speed": speed[rows].round(3).tolist(),
        "roll": np.degrees(roll[rows]).round(2).tolist(),
    }


def _css(colour: Rgba | tuple[float, float, float]) -> tuple[int, ...]:
    """Red, green and blue from 0 to 255."""
    parts = (colour.r(), colour.g(), colour.b()) if isinstance(colour, Rgba) else colour
    return tuple(round(255 * part) for part in parts)


def _split(page: str, mark: str) -> tuple[str, str]:
    """What stands before and after the last `mark`; Drake's scripts before it may hold the same characters."""
    before, found, after = page.rpartition(mark)
    if not found:
        raise RuntimeError(f"Drake's page has no {mark!r} any more; the title of the replay has no place")
    return before, after
