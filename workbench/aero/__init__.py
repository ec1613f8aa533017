"""Aerodynamics of tails: sections, laws, coefficients, wind, added mass and the free sail (see README.md beside this file)."""
