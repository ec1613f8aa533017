"""The AeroDima workbench: `aerodima.workbench`, `aerodima.optimisation` and `aerodima.hardware`.

In a checkout the three packages stand at its top and are linked here; in a wheel they are folders
of this package.
"""
