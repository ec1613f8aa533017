"""Driving the real car: checks, arming, the loop, the way out, the log.

Only `drive_diagram` needs Drake.
"""
