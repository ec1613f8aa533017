"""Controllers and drivers: what stands outside the station, between its ports.

Importing this loads no Drake.
"""
