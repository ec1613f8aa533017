"""Replays, figures and pages."""
