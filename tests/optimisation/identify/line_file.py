"""A fit that takes no time, of a file: stands in for the fits of logs where only their batch is
tested.
"""

import pandas as pd

from aerodima.optimisation.identify.published_check import fit_line


def fit_line_file(path):
    """Rate and preload of a CSV file with `displacement_m` and `force_n`."""
    table = pd.read_csv(path)
    x = table["displacement_m"].to_numpy(float)
    force = table["force_n"].to_numpy(float)
    return fit_line(x, force, ("rate", "N/m"), ("preload", "N"), name=path, channel="force")
