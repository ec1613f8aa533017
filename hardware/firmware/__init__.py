"""The Teensy's firmware: a portable C++ core, the Arduino sketch on top of it, and the core on this
computer by ctypes.
"""
