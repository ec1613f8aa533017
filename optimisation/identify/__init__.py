"""Identification: from logs and tables to coefficients with intervals."""
