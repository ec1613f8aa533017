"""Drake plants built from the SDF files of `models/` and the parameters of a scenario."""
