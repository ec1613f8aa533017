"""The files of `models/` are found in a checkout and in a wheel, and a wrong name is answered with
the right one.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from aerodima.workbench import resources
from aerodima.workbench.errors import ModelError, UserError
from aerodima.workbench.resources import model_path, models_dir


@pytest.fixture
def fresh_lookup() -> Iterator[None]:
    models_dir.cache_clear()
    yield
    models_dir.cache_clear()


def test_checkout_has_its_models_beside_the_packages() -> None:
    assert models_dir() == Path(__file__).resolve().parents[2] / "models"


def test_file_is_found_by_its_path_below_models() -> None:
    path = model_path("published/manoeuvre_metrics.csv")
    assert path.is_absolute()
    assert path.read_text(encoding="utf-8")


def test_wheel_has_its_models_inside_the_package(
    fresh_lookup: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "car.sdf").write_text("<sdf/>")
    monkeypatch.setattr(resources, "_SHIPPED", tmp_path)
    assert models_dir() == tmp_path
    assert model_path("car.sdf") == tmp_path / "car.sdf"


def test_installation_without_models_says_where_it_looked(
    fresh_lookup: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(resources, "_SHIPPED", tmp_path / "a")
    monkeypatch.setattr(resources, "_CHECKOUT", tmp_path / "b")
    with pytest.raises(ModelError, match=f"neither {tmp_path}/a nor {tmp_path}/b"):
        models_dir()


def test_misspelt_file_is_answered_with_the_nearest() -> None:
    with pytest.raises(
        ModelError,
        match=r"'published/manoeuver_metrics\.csv' does not exist in .*nearest: "
        r"published/manoeuvre_metrics\.csv",
    ):
        model_path("published/manoeuver_metrics.csv")


def test_name_like_no_other_is_answered_with_the_files_of_its_folder() -> None:
    with pytest.raises(ModelError, match=r"published/ has: .*published/constants\.csv"):
        model_path("published/qqqqqqqqqqqqqqqqqqqq")


def test_unknown_folder_is_named() -> None:
    with pytest.raises(ModelError, match="there is no folder zzzz/"):
        model_path("zzzz/qqqqqqqqqqqqqqqqqqqqqqqqqqq")


@pytest.mark.parametrize(
    "relative", ["../pyproject.toml", "/etc/hostname", "published/../../README.md"]
)
def test_path_that_leaves_models_is_refused(relative: str) -> None:
    with pytest.raises(UserError, match="must be a path inside models/"):
        model_path(relative)
