"""From a scenario to a run: with a log, in memory, or as a campaign of many."""
