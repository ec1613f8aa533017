"""Scenarios, parameters, ensembles, swing files: what a run is made of, typed and checked."""
