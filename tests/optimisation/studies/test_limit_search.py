"""A climb finds the end of the unbroken row of values that hold, on the grid of its search."""

import math

import pytest

from aerodima.optimisation.studies.limit_search import Bracket, LimitSearch

SEARCH = LimitSearch(0.4, 1.0, 0.1, 0.0125)


def climbed(holds, start=0.7):
    """The bracket of a climb, and what it evaluated, in order."""
    verdicts = {}
    while wanted := SEARCH.next_values(start, verdicts):
        (value,) = wanted
        verdicts[value] = holds(value)
    return Bracket.from_verdicts(verdicts), list(verdicts)


@pytest.mark.parametrize("limit", [0.5537, 0.8537])
def test_a_climb_goes_towards_the_limit_and_ends_within_the_tolerance(limit):
    bracket, values = climbed(lambda value: value < limit)
    assert bracket.held < limit <= bracket.lost
    assert bracket.lost - bracket.held == pytest.approx(SEARCH.tolerance)
    assert len(values) <= 7


@pytest.mark.parametrize(
    ("holds", "bracket"), [(True, Bracket(1.0, math.inf)), (False, Bracket(-math.inf, 0.4))]
)
def test_a_climb_ends_at_an_end_of_its_range(holds, bracket):
    assert climbed(lambda value: holds)[0] == bracket


def test_a_bracket_ignores_islands_beyond_the_first_loss_and_values_without_verdict():
    verdicts = {0.5: True, 0.6: None, 0.7: False, 0.8: True, 0.9: False}
    assert Bracket.from_verdicts(verdicts) == Bracket(0.5, 0.7)
