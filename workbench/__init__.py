"""Plants, controllers, sensors, stations, logs and metrics of the AeroDima car and its wind-tunnel rig.

Importing the package loads nothing heavy: Drake is imported by the modules that simulate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str

if __name__ != "aerodima.workbench":
    raise ImportError("this package has one name, aerodima.workbench; `make install` installs it")


def __getattr__(name: str) -> str:
    """`__version__`, read from the installed distribution when it is asked for (it costs 30 ms)."""
    if name == "__version__":
        from importlib.metadata import version

        return version("aerodima-workbench")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
