"""Calibration of the car to what is published: priors, targets, surrogates, weighted ensemble."""
