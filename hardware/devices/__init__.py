"""The car's devices, each behind an object of its own: tail motors, Teensy, radio, IMU and GPS.

They need no Drake.
"""
