"""Many independent pieces of work: in this process, in worker processes, or on a Dask cluster.

The loss, pause, stop or replacement of a worker is handled and reported in one place, whatever the
work is: runs of a study, logs of a campaign, fits.
"""
