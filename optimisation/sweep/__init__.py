"""Sweeps: many runs of one study, in worker processes here or on a cluster, kept on the disk as
they come.
"""
