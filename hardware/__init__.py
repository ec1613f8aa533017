"""The real car behind the station's ports: CAN, serial and radio links, safety, emulators, operator console."""
