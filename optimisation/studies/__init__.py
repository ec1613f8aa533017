"""Studies on top of sweeps: the built-in ones, the judging of laws, what of the thesis is reproduced."""
