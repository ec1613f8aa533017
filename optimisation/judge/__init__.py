"""How much a candidate gains: the measure, the search of a limit, candidates and suites."""
