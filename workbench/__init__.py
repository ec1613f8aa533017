"""Plants, controllers, sensors, stations, logs and metrics of the AeroDima car and its wind-tunnel
rig.

`__init__.pyi` lists what the package promises. Importing it loads nothing heavy: a name is loaded
when it is used.
"""

from typing import Any

from lazy_loader import attach_stub

if __name__ != "aerodima.workbench":
    raise ImportError("this package has one name, aerodima.workbench; `make install` installs it")

_load, __dir__, __all__ = attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """A promised name, or `__version__`, read from the installed distribution when it is asked for
    (it costs 30 ms).
    """
    if name == "__version__":
        from importlib.metadata import version

        return version("aerodima-workbench")
    return _load(name)
