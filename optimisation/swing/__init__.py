"""Optimised tail swings: reduced models, the turn as a profile, collocation, solvers, swing files."""
