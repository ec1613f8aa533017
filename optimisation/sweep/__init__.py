"""Sweeps: many runs of one study, in worker processes on this computer or on a cluster, kept on the disk as they come."""
