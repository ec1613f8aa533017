"""Identification, calibration, parameter studies and swing optimisation on top of `workbench`."""
