"""Identification, calibration, parameter studies and swing optimisation on top of `workbench`.

`__init__.pyi` lists what the package promises; a name is loaded when it is used.
"""

from lazy_loader import attach_stub

if __name__ != "aerodima.optimisation":
    raise ImportError(
        "this package has one name, aerodima.optimisation; `make install` installs it"
    )

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
