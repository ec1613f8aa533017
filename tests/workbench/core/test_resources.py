"""The files of `models/` are found in a checkout and in a wheel."""

import pytest

from aerodima.workbench.core import resources
from aerodima.workbench.core.errors import ModelError
from aerodima.workbench.core.resources import model_path, models_dir
from tests.refusals import assert_refused


@pytest.fixture
def fresh_lookup():
    models_dir.cache_clear()
    yield
    models_dir.cache_clear()


def test_file_is_found_by_its_path_below_models():
    path = model_path("published/manoeuvre_metrics.csv")
    assert path.is_absolute()
    assert path.read_text(encoding="utf-8")


def test_wheel_has_its_models_inside_the_package(fresh_lookup, monkeypatch, tmp_path):
    (tmp_path / "car.sdf").write_text("<sdf/>")
    monkeypatch.setattr(resources, "_SHIPPED", tmp_path)
    assert models_dir() == tmp_path
    assert model_path("car.sdf") == tmp_path / "car.sdf"


def test_installation_without_models_says_where_it_looked(fresh_lookup, monkeypatch, tmp_path):
    monkeypatch.setattr(resources, "_SHIPPED", tmp_path / "a")
    monkeypatch.setattr(resources, "_CHECKOUT", tmp_path / "b")
    assert_refused(models_dir, ModelError, f"{tmp_path}/a", f"{tmp_path}/b")


def test_missing_file_is_named_with_its_folder():
    path = "published/manoeuver_metrics.csv"
    assert_refused(lambda: model_path(path), ModelError, path, str(models_dir()))
