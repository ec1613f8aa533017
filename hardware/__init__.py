"""The real car behind the station's ports: CAN, serial and radio links, safety, emulators, operator
console.

`__init__.pyi` lists what the package promises; a name is loaded when it is used.
"""

from lazy_loader import attach_stub

if __name__ != "aerodima.hardware":
    raise ImportError("this package has one name, aerodima.hardware; `make install` installs it")

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
