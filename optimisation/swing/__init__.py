"""Optimised tail swings: reduced model, the turn as a profile, collocation, solvers, swing files."""
