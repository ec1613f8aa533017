"""Figures of runs and of comparisons between runs, for reports and notebooks.

Each function returns a `matplotlib.figure.Figure` that no window owns: it needs no display, a
notebook shows it, `figure.savefig` writes it. Angles are drawn in degrees, everything else in SI;
every axis names its unit. Colours are distinguished by colour-blind readers, and markers, line
styles and hatches say the same without colour.
"""
