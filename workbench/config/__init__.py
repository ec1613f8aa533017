"""Scenarios, parameters, ensembles and swing files: everything that a run is made of, typed and
checked.
"""
