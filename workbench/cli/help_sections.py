"""Sections of `aerodima --help`, in their order. A command names its own as Typer's `rich_help_panel`."""

RUNS = "Run the car and look at runs"
SWINGS = "Find swings and vary numbers"
COEFFICIENTS = "Coefficients, from rig to fit"
THESIS = "Calibrate, and compare with the thesis"
CAR = "Drive the real or the emulated car"
CHECKS = "Look into models and installation"

SECTIONS = (RUNS, SWINGS, COEFFICIENTS, THESIS, CAR, CHECKS)
