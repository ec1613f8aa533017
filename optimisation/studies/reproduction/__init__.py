"""What of the thesis this project reproduces: one row per claim, figure or table, with its evidence and a verdict."""
