"""Identification, calibration, parameter studies and swing optimisation on top of `workbench`."""

if __name__ != "aerodima.optimisation":
    raise ImportError("this package has one name, aerodima.optimisation; `make install` installs it")
