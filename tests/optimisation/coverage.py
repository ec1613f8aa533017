"""Whether intervals hold the truth as often as they promise: bands that follow from the number of
draws.
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2

ENDS = np.array([0.0005, 0.9995])
"""Of a band; a test of right intervals leaves it in one of a thousand sets of draws."""


def draws(few, many):
    """Runs a test with `number`: few draws in the ordinary suite, many at night."""
    return pytest.mark.parametrize("number", [few, pytest.param(many, marks=pytest.mark.nightly)])


def assert_held(held):
    """Asserts that independent intervals of 95 % hold their truth as often as promised."""
    low, high = binom.ppf(ENDS, len(held), 0.95)
    assert low <= np.sum(held) <= high, f"{np.sum(held)} of {len(held)}, allowed {low} to {high}"


def assert_standard(scores):
    """Asserts that independent errors over their standard deviations have the mean square 1.

    It tells half an interval from a whole one with far fewer draws than their share does.
    """
    square = float(np.mean(np.square(scores)))
    low, high = chi2.ppf(ENDS, len(scores)) / len(scores)
    assert low <= square <= high, f"mean square {square:.3f}, allowed {low:.3f} to {high:.3f}"
