"""Videos: what is on the frames, several runs in step, and what is told when an encoder is
missing.
"""

import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from PIL import Image

from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.extras import install_command
from aerodima.workbench.view.video import FRAMES_PER_SECOND, Film, write_video
from tests.refusals import assert_refused

PANEL, HEADER, GAP = (480, 300), 52, 4
REST = 25
"""Frames for which the last one stays."""


def cut(run_log, length):
    """The beginning of a run."""
    return replace(run_log, table=run_log.table[run_log.time <= run_log.time[0] + length + 1e-9])


@pytest.fixture(scope="module")
def brief(short_runs):
    """The runs' first 0.2 s, and 0.12 s of the tailless one: 6 and 4 frames."""
    return {"tailed": cut(short_runs["swing"], 0.2), "tailless": cut(short_runs["none"], 0.12)}


@pytest.fixture(scope="module")
def film(brief):
    return Film({"longer": brief["tailed"], "shorter": brief["tailless"]}, 1.0)


def panel(frame, which):
    left = which * (PANEL[0] + GAP)
    return np.asarray(frame.crop((left, HEADER, left + PANEL[0], HEADER + PANEL[1])))


@pytest.mark.usefixtures("renderer")
def test_runs_of_different_length_are_in_step_to_the_end_of_the_longest(film):
    assert film.number == 6
    last = [film.frame(number) for number in (3, 4, 5)]
    assert np.array_equal(panel(last[0], 1), panel(last[2], 1))  # over since frame 3
    assert not np.array_equal(panel(last[1], 0), panel(last[2], 0))


@pytest.mark.slow
@pytest.mark.usefixtures("renderer")
@pytest.mark.parametrize(("ending", "rate", "frames"), [("gif", 1.0, 6), ("webp", 0.5, 11)])
def test_file_has_every_frame_and_rests_at_the_end(brief, tmp_path, ending, rate, frames):
    told = []
    path = write_video(
        {"run": brief["tailed"]},
        tmp_path / f"run.{ending}",
        rate=rate,
        progress=lambda *done: told.append(done),
    )
    assert told == [(number + 1, frames) for number in range(frames)]
    with Image.open(path) as read:
        assert read.size == (640, 400 + HEADER)
        assert read.info["loop"] == 0
        shown = 0
        for number in range(read.n_frames):
            read.seek(number)
            read.load()
            shown += read.info["duration"]
    # Encoders keep a picture that stays as one frame, shown longer.
    assert shown == 1000 // FRAMES_PER_SECOND * (frames + REST)


@pytest.mark.usefixtures("renderer")
def test_mp4_has_every_frame(brief, tmp_path):
    ffmpeg = pytest.importorskip(
        "imageio_ffmpeg", reason="imageio-ffmpeg (the extra `video`) is not installed"
    )
    path = write_video({"run": brief["tailed"]}, tmp_path / "run.mp4")
    frames, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert frames == 6 + REST
    assert seconds == pytest.approx(frames / FRAMES_PER_SECOND, abs=0.05)
    assert [other.name for other in tmp_path.iterdir()] == ["run.mp4"]


def test_missing_encoder_is_one_line(brief, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    work = partial(write_video, {"run": brief["tailed"]}, tmp_path / "run.mp4")
    assert_refused(work, UserError, "run.mp4", install_command("video"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "name", "rate", "named"),
    [
        (7, "run.gif", 1.0, ["7", "1 to 6"]),
        (0, "run.gif", 1.0, ["0", "1 to 6"]),
        (1, "run.avi", 1.0, ["'.avi'", ".mp4", ".gif", ".webp"]),
        (1, "run.gif", 0.0, ["--rate", "0.02", "20"]),
    ],
)
def test_wrong_number_ending_or_rate(brief, tmp_path, number, name, rate, named):
    runs = {str(place): brief["tailed"] for place in range(number)}
    assert_refused(partial(write_video, runs, tmp_path / name, rate=rate), UserError, *named)


def test_video_of_many_minutes_is_refused(brief):
    run = replace(brief["tailed"], table=stretched(brief["tailed"], 3.0))
    assert_refused(lambda: Film({"run": run}, 0.02), UserError, "150 s", "0.02", "120 s")


def stretched(run_log, length):
    table = run_log.table.copy()
    table["time_s"] = np.linspace(0.0, length, len(table))
    return table
