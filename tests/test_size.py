"""The repository stays as small as `size.toml` says."""

import tomllib
from pathlib import Path

import pytest

from tests.code_measure import measures

ROOT = Path(__file__).resolve().parent.parent
LIMITS = tomllib.loads((ROOT / "tests" / "size.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def measured() -> dict[str, object]:
    return measures(ROOT)


@pytest.mark.parametrize("name", LIMITS)
def test_no_measure_is_above_its_limit(measured: dict[str, object], name: str) -> None:
    value = measured[name]
    assert isinstance(value, int)
    assert 0 <= value <= LIMITS[name], f"{name}: {value}; allowed: {LIMITS[name]} (tests/size.toml)"
