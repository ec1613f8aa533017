"""Studies of many runs, and thresholds."""
