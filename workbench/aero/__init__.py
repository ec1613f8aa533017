"""Aerodynamics of tails: sections, laws, coefficients, wind, added mass and the free sail;
README.md has the law.
"""
