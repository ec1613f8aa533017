"""The Teensy's firmware: portable C++ core, Arduino sketch on top, and the core on this computer by
ctypes.
"""
