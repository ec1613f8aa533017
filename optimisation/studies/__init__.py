"""Studies on top of sweeps: the built-in ones, the leaderboard of controllers, what of the thesis is reproduced."""
