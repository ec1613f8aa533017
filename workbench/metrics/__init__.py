"""Metrics and outcome of a run, and the published figures beside them."""
