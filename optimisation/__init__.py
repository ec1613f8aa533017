"""Identification, calibration, parameter studies and swing optimisation on top of `workbench`."""

if __name__ != "aerodima.optimisation":
    raise ImportError(
        "this package has one name: import aerodima.optimisation (installed by `make install`), not optimisation"
    )
