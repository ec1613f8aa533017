"""`python -m aerodima` is the program `aerodima`."""

from aerodima.workbench.cli.program import main

main()
