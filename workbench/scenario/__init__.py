"""Parameters, scenarios, ensembles, swing files and the table of signals."""
