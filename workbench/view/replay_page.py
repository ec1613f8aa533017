"""Self-contained HTML replays of one run, or of several side by side with their differences.

A replay is Meshcat with the animation, a title over it, a bar below, and the signals of the run
with a cursor at its time.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import LogError, UserError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.core.text_table import value_rows
from aerodima.workbench.logs.schema import PLANT_RUN, TAIL_LAW, RunLog
from aerodima.workbench.metrics.run_summary import metrics_of_runs, of_plants
from aerodima.workbench.view.captions import readings, run_caption
from aerodima.workbench.view.force_arrows import AIR_COLOUR, WHEEL_COLOUR, WHEEL_SCALE, Colour
from aerodima.workbench.view.logged_run import LoggedRun
from aerodima.workbench.view.recording import COM_COLOUR, TIP_COLOUR, frame_rows, record_run
from aerodima.workbench.view.report_page import (
    Finding,
    Page,
    Part,
    Section,
    Table,
    Templated,
    render,
)
from aerodima.workbench.view.run_channels import channels_of, line_looks
from aerodima.workbench.view.run_figures import RUN_STYLES
from aerodima.workbench.view.viewer import open_meshcat

MAX_RUNS = len(RUN_STYLES)
MAX_VIEWS = 8
"""Largest number of cars that a comparison draws in 3-D at a time; browsers allow 16 WebGL
views."""
FIRST_VIEWS = 4
"""Number of cars that a comparison draws in 3-D at first."""
_CAR_SECTIONS = ("car", "tail", "friction", "tail_motor", "servo", "drive")
"""Sections of a scenario that define the car; a difference in one of them is named first."""
_LIBRARY_MARK = "<!-- Meshcat -->"


def write_replay_html(
    run_log: RunLog, path: Path | str, *, force: bool = False, rate: float = 1.0
) -> Path:
    """Writes the replay of a run as one self-contained HTML file, which plays when it is opened.

    Args:
        run_log: log of the run.
        path: path of the HTML file.
        force: whether an existing file is replaced; it is refused otherwise.
        rate: seconds of the run per second of the replay.

    Raises:
        UserError: the file exists or cannot be written, rate out of range.
        LogError: the log cannot be replayed.
    """
    return write_atomically(Path(path), replay_page(run_log, rate), force, UserError)


def replay_page(run_log: RunLog, rate: float = 1.0, *, signals: bool = True) -> str:
    """Renders the page of `write_replay_html` as text: Drake's page of the scene, with title,
    readout, bar and signals.

    The script of the page has one clock, which drives Meshcat's animator and the cursor in the
    signals. A page that holds several replays, without `signals` of their own, shows them at the
    same time: it calls `replay.follow()` once and then `replay.show(seconds)` of each.
    """
    meshcat = open_meshcat()
    logged = record_run(run_log, meshcat, rate)
    head, scene = _split(meshcat.StaticHtml(), "<title>Drake MeshCat</title>")
    scene, end = _split(scene, "</body>")
    run_log = logged.run_log
    return render(
        "replay.html",
        head=head,
        scene=scene,
        end="</body>" + end,
        caption=run_caption(run_log),
        keys=_keys(logged),
        run=_frames(run_log, rate),
        channels=channels_of([run_log], [run_log.name]) if signals else None,
        rate=rate,
    )


def _keys(logged: LoggedRun) -> list[tuple[str, str, tuple[int, ...]]]:
    """Lists the legend of arrows and lines: sign, words, colour."""
    path = ("▬", "path of the centre of mass", _css(COM_COLOUR))
    length = f"{logged.air_scale / WHEEL_SCALE:.0f} times longer"
    keys = [("▲", "ground on the wheels", _css(WHEEL_COLOUR))]
    if logged.run_log.kind == PLANT_RUN:
        length = f"{logged.air_scale:g} m per newton"
        keys = []
    if not logged.tips:
        return [*keys, path]
    air = ("▲", f"air on the tail ({length})", _css(AIR_COLOUR))
    return [*keys, air, path, ("▬", "path of the tail tip", _css(TIP_COLOUR))]


def _frames(run_log: RunLog, rate: float) -> Json:
    """Collects what the page shows of each frame: time (s) and the readings of the run."""
    rows, frames_per_second = frame_rows(run_log.time, rate)
    return {
        "frames_per_second": frames_per_second,
        "rate": rate,
        "time": run_log.time[rows].round(3).tolist(),
        "readings": [
            vars(one) | {"values": one.values[rows].round(one.digits + 1).tolist()}
            for one in readings(run_log)
        ],
    }


def _css(colour: Colour) -> tuple[int, ...]:
    """Scales red, green and blue to 0 to 255."""
    return tuple(round(255 * part) for part in colour)


def _split(page: str, mark: str) -> tuple[str, str]:
    """Returns what stands before and after the last `mark`; Drake's scripts before it may hold the
    same characters.
    """
    before, separator, after = page.rpartition(mark)
    if not separator:
        raise RuntimeError(
            f"Drake's page has no {mark!r} any more; the title of the replay has no place"
        )
    return before, after


def metrics_rows(run_logs: Sequence[RunLog]) -> dict[str, list[Any]]:
    """Maps each metric with its unit to a value per run (None where a run has none).

    Raises:
        LogError: as `metrics_of_runs`.
    """
    rows = metrics_of_runs(run_logs)
    names = dict.fromkeys(name for row in rows for name in row if not name.startswith("filtered_"))
    return {name: [row.get(name) for row in rows] for name in names}


def scenario_differences(run_logs: Sequence[RunLog]) -> dict[str, list[Any]]:
    """Maps keys of the scenario that differ between runs to a value per run; the car's own keys
    come first.

    The name of a user's own tail law stands beside them as `tail_law`.

    Raises:
        LogError: fewer than 2 or more than `MAX_RUNS` runs.
    """
    check_range("number of runs", len(run_logs), 2, MAX_RUNS, NO_UNIT, error=LogError)
    flat: list[dict[Any, Any]] = []
    for run_log in run_logs:
        (scenario,) = pd.json_normalize(dict(run_log.scenario)).to_dict("records")
        flat.append(scenario | {TAIL_LAW: run_log.extra.get(TAIL_LAW)})
    keys = {key for scenario in flat for key in scenario}
    differences = {}
    for key in sorted(keys, key=lambda key: (key.split(".")[0] not in _CAR_SECTIONS, key)):
        values = [scenario.get(key) for scenario in flat]
        if len(set(map(json.dumps, values))) > 1:
            differences[key] = values
    return differences


def different_cars(differences: Mapping[str, Sequence[Any]]) -> list[str]:
    """Lists the keys that make a different car; how a car uses its tail (`tail.mode`) does not."""
    return [key for key in differences if key.split(".")[0] in _CAR_SECTIONS and key != "tail.mode"]


def comparison_page(run_logs: Sequence[RunLog], names: Sequence[str]) -> Page:
    """Makes the page of a comparison; it needs no other file.

    Args:
        run_logs: logs of 2 to `MAX_RUNS` runs with a turn.
        names: names of the runs, all different.

    Raises:
        LogError: wrong number of runs, or one of them cannot be replayed.
    """
    differences = scenario_differences(run_logs)
    plants = of_plants(run_logs)
    text = "Raw metrics of each run; units are at the end of the names."
    if not plants:
        text += " The turn is positive."
    metrics = Table(["metric", *names], value_rows(metrics_rows(run_logs).items()))
    sections = (
        Section("What was set differently", _settings(differences, names, plants)),
        Section("Replays and signals in step", [replays_in_step(run_logs, names)]),
        Section("Metrics", [text, metrics]),
    )
    return Page("Comparison of runs: " + ", ".join(names), "", sections)


def replays_in_step(
    run_logs: Sequence[RunLog], names: Sequence[str], captions: Sequence[str] | None = None
) -> Templated:
    """Makes the replays with one clock, and their signals over one another; the page holds Drake's
    library once.

    Args:
        run_logs: logs of the runs.
        names: names of the runs, shown beside their signals.
        captions: texts above their pictures; the names by default.
    """
    pages = [replay_page(run_log, signals=False) for run_log in run_logs]
    library = _library(pages[0])
    looks = zip(names, line_looks(), strict=False)
    values = {
        "runs": [{"name": name, **look} for name, look in looks],
        "captions": list(captions or names),
        "channels": channels_of(run_logs, names),
        "pages": [page.replace(library, _LIBRARY_MARK) for page in pages],
        "library": library,
        "mark": _LIBRARY_MARK,
        "most_views": MAX_VIEWS,
        "first_views": FIRST_VIEWS,
    }
    return Templated("replays.html", values)


def _library(page: str) -> str:
    """Cuts out the first script of Drake's page, the same in all pages: Meshcat itself."""
    start = page.index("<script")
    return page[start : page.index("</script>", start)] + "</script>"


def _settings(
    differences: Mapping[str, Sequence[Any]], names: Sequence[str], plants: bool
) -> list[Part]:
    """Shows what was set differently, and warns if that makes different cars."""
    if not differences:
        return ["Nothing: the scenarios are equal, the seed included."]
    rows = Table(["key", *names], value_rows(differences.items()))
    other = different_cars(differences)
    if plants or not other:
        return [rows]
    warning = (
        f"These are different cars: {', '.join(other)}. What differs between the runs may "
        "come from that alone."
    )
    return [Finding([warning]), rows]
