"""Many independent pieces of work: in this process, in worker processes on this computer, or on a
Dask cluster.

What happens to a worker (lost, paused, stopped, replaced) is handled and said in one place,
whatever the work is: runs of a study, logs of a campaign, fits.
"""
