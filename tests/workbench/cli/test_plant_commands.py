"""Commands that read logs read those of any plant, as far as they apply."""

import pytest

from tests.commands import done
from tests.workbench.view.cart_poles import observed_swing


@pytest.fixture(scope="module")
def swings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swings")
    files = [folder / f"{name}.parquet" for name in ("narrow", "wide")]
    for width, file in zip((0.1, 0.2), files, strict=True):
        observed_swing(0.002, file, settings={"plate": {"width_m": width}})
    return files


def test_metrics_of_a_plant_are_printed_and_written(swings, tmp_path):
    printed = done("log", "metrics", *swings, "--out", tmp_path / "metrics.csv")
    assert "tail_force_pole_max_n" in printed
    assert "tail_force_pole_max_n" in (tmp_path / "metrics.csv").read_text(encoding="utf-8")


@pytest.mark.slow
def test_replay_draws_the_plant(swings, tmp_path):
    done("replay", swings[0], "--html", tmp_path / "swing.html", "--strip", tmp_path / "swing.png")
    page = (tmp_path / "swing.html").read_text(encoding="utf-8")
    assert "my cart" in page
    assert (tmp_path / "swing.png").stat().st_size > 10_000


def test_comparison_names_what_differs(swings, tmp_path):
    told = done("log", "compare", *swings, "--html", tmp_path / "both.html")
    assert "plate.width_m" in told
    assert (tmp_path / "both.html").stat().st_size > 1e6
