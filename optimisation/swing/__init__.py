"""Tail swings on the full car: swing files, one run, the verdict on a swing."""
