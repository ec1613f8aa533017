"""Pages that open without a network: of turns, of runs side by side, of a replay; and what pages
are made of.
"""
