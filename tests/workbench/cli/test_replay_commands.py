"""`aerodima replay`: files or a viewer, from a log alone."""

import time
from pathlib import Path

import pytest

from tests.commands import done


@pytest.fixture
def log(tailless):
    return Path(tailless.source)


@pytest.fixture
def impatient(monkeypatch):
    """Ctrl-C as soon as the program waits."""

    def interrupt(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", interrupt)


def test_files_are_written_and_nothing_waits(log, tmp_path):
    html = tmp_path / "run.html"
    strip = tmp_path / "run.png"
    for path in (html, strip):
        path.write_text("old")
    told = done("replay", log, "--html", html, "--strip", strip, "--rate", 0.5, "--force")
    assert told.splitlines() == [f"replay: {html}", f"strip: {strip}"]
    assert html.stat().st_size > 1e6
    assert strip.read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("impatient")
def test_viewer_tells_its_address_and_ends_with_ctrl_c(log):
    assert "http://127.0.0.1:" in done("replay", log)


@pytest.mark.parametrize("option", ["--html", "--strip", "--video"])
def test_existing_output_is_refused_before_anything_is_written(
    refused, log, untouched, tmp_path, option
):
    ending = {"--html": ".html", "--strip": ".png", "--video": ".gif"}
    other = "--strip" if option == "--html" else "--html"
    present = untouched.rename(untouched.with_suffix(ending[option]))
    absent = tmp_path / f"other{ending[other]}"
    message = refused("replay", log, other, absent, option, present)
    assert present.name in message
    assert present.read_text() == "precious"
    assert not absent.exists()


def test_several_runs_without_video_are_refused(refused, log, tmp_path):
    video = ("--video", tmp_path / "run.gif")
    for words in ((), (*video, "--html", tmp_path / "run.html")):
        message = refused("replay", log, log, *words)
        assert "2 runs" in message
        assert "--video" in message
    assert log.name in refused("replay", log, log, *video)
