"""`aerodima replay`: files or a viewer, from a log alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.replay.viewer import open_meshcat
from aerodima.workbench.simulate.simulation import simulate


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = ["manoeuvre.duration=0.1", "manoeuvre.speed_ramp=0.1"]
    path = tmp_path_factory.mktemp("replay") / "run.parquet"
    simulate(load_scenario("turn_none", settings), path)
    return path


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C as soon as the program waits."""

    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", interrupt)


def test_files_are_written_and_nothing_waits(call: Callable, log: Path, tmp_path: Path) -> None:
    html = tmp_path / "run.html"
    strip = tmp_path / "run.png"
    result = call("replay", log, "--html", html, "--strip", strip, "--rate", 0.5)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [f"replay: {html}", f"strip: {strip}"]
    assert "replay at 0.5 times its speed" in html.read_text(encoding="utf-8")
    assert strip.read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("impatient")
def test_viewer_tells_its_address_and_ends_with_ctrl_c(call: Callable, log: Path) -> None:
    result = call("replay", log)
    assert result.exit_code == 0
    assert "published turn: left turn" in result.stdout
    assert "open http://127.0.0.1:" in result.stdout


def test_port_in_use_is_refused(refused: Callable, log: Path) -> None:
    other = open_meshcat()
    assert f"port {other.port()} of 127.0.0.1 is in use" in refused(
        "replay", log, "--port", other.port()
    )


@pytest.mark.parametrize("option", ["--html", "--strip", "--video"])
def test_existing_output_is_refused_before_anything_is_written(
    refused: Callable, log: Path, untouched: Path, tmp_path: Path, option: str
) -> None:
    ending = {"--html": ".html", "--strip": ".png", "--video": ".gif"}
    other = "--strip" if option == "--html" else "--html"
    present = untouched.rename(untouched.with_suffix(ending[option]))
    absent = tmp_path / f"other{ending[other]}"
    message = refused("replay", log, other, absent, option, present)
    assert "exists already" in message
    assert present.read_text() == "precious"
    assert not absent.exists()


def test_strip_is_a_png(refused: Callable, log: Path, tmp_path: Path) -> None:
    assert "'.jpg'; allowed: .png" in refused("replay", log, "--strip", tmp_path / "strip.jpg")
    assert not (tmp_path / "strip.jpg").exists()


def test_video_of_two_runs_is_named_after_their_files(
    call: Callable, log: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.parquet"
    video = tmp_path / "both.gif"
    other.write_bytes(log.read_bytes())
    result = call("replay", log, other, "--video", video)
    if "no off-screen renderer" in result.stderr:
        pytest.skip("Drake's VTK finds no OpenGL through EGL on this machine")
    assert result.exit_code == 0, result.output
    assert result.stdout == f"video: {video}\n"
    assert video.read_bytes().startswith(b"GIF89a")


def test_several_runs_without_video_are_refused(
    refused: Callable, log: Path, tmp_path: Path
) -> None:
    assert "2 runs: allowed with --video alone; `aerodima log compare`" in refused(
        "replay", log, log
    )
    message = refused(
        "replay", log, log, "--video", tmp_path / "run.gif", "--html", tmp_path / "run.html"
    )
    assert "2 runs: allowed with --video alone" in message
    assert "named twice" in refused("replay", log, log, "--video", tmp_path / "run.gif")


def test_video_of_another_ending_is_refused_before_the_log_is_read(
    refused: Callable, tmp_path: Path
) -> None:
    message = refused("replay", tmp_path / "missing.parquet", "--video", tmp_path / "run.mov")
    assert "'.mov'; allowed: .mp4, .gif, .webp" in message


def test_file_that_is_no_log_is_refused(refused: Callable, untouched: Path) -> None:
    assert "not a Parquet file" in refused("replay", untouched)


@pytest.mark.parametrize("rate", ["0", "-1", "100"])
def test_rate_out_of_range_is_refused(
    refused: Callable, log: Path, tmp_path: Path, rate: str
) -> None:
    assert "--rate" in refused("replay", log, "--html", tmp_path / "run.html", "--rate", rate)
