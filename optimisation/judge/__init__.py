"""Gain of a candidate: the measure, the search of a limit, candidates and suites."""
