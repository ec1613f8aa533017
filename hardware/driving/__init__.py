"""Driving the real car: checks, arming, the loop, the way out, the log.

`diagram` alone needs Drake.
"""
