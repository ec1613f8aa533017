"""Reduced cars with few states, many at once as arrays."""
