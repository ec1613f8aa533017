"""Files, checks, errors, tables, real time, ports and event order: what every other folder uses."""
