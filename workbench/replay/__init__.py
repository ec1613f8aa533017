"""Replays of run logs: in Meshcat, and as a strip of five pictures; and diagrams of one's own,
watched and logged.
"""
