"""Fits: parameters, data, residual, least squares, intervals, batches and their report."""
