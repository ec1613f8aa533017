"""The real car behind the station's ports: CAN, serial and radio links, safety, emulators, operator console."""

if __name__ != "aerodima.hardware":
    raise ImportError("this package has one name, aerodima.hardware; `make install` installs it")
