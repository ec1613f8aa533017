"""Replays of run logs: in Meshcat, and as a strip of five pictures."""
