from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.identify.line_fits import fit_spring
from aerodima.workbench.errors import FitError


def data(x: np.ndarray, force: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"displacement_m": x, "force_n": force})


def test_rate_and_preload_with_the_interval_of_the_textbook() -> None:
    x, rng = np.linspace(0.0, 0.02, 41), np.random.default_rng(5)
    force = 9869.34 * x + 3.0 + rng.normal(scale=0.5, size=41)  # front tyres of Table 6.1
    result = fit_spring(data(x, force))
    assert result["rate"].holds(9869.34)
    assert result["preload"].holds(3.0)
    reference = np.polyfit(x, force, 1, cov=True)
    assert result["rate"].standard_deviation == pytest.approx(np.sqrt(reference[1][0, 0]), rel=1e-6)
    assert result.warnings == ()


def test_a_stiffening_spring_is_told() -> None:
    x = np.linspace(0.0, 0.02, 21)
    result = fit_spring(data(x, 9000.0 * x + 2e5 * x**2 + 0.01 * np.cos(900 * x)))
    assert any("rate rises by" in warning and "not a linear spring" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (data(np.zeros(5), np.arange(5.0)), "is constant"),
        (data(0.01 * np.arange(2.0), np.arange(2.0)), "too few"),
        (data(0.01 * np.arange(5.0), -np.arange(5.0)), "falls with displacement"),
        (data(np.arange(5.0), np.arange(5.0)), r"reaches 4, beyond 0\.5 m; is it in mm"),
    ],
)
def test_data_that_make_no_spring_are_refused(table: pd.DataFrame, message: str) -> None:
    with pytest.raises(FitError, match=message):
        fit_spring(table)
