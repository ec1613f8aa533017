"""The car: plant, tail, laws, sensors, station, run, trial record and verdict."""
