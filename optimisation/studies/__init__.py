"""Studies of many runs, and searches of a limit."""
