"""The car with few states, many at once as arrays."""
