"""Calibration of the car against the published turns."""
