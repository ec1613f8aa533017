"""Figures of runs and of comparisons between runs, for reports and notebooks.

Each function returns a `matplotlib.figure.Figure` that no window owns: it needs no display, a notebook shows it,
`figure.savefig` writes it. Angles are drawn in degrees, everything else in SI; every axis names its unit. Colours are
told apart by colour-blind readers, and markers, line styles and hatches say the same without colour.
"""

from aerodima.workbench.figures.comparison_figures import plot_comparison, plot_metrics, plot_outcomes, plot_triggers
from aerodima.workbench.figures.run_figures import plot_turn
from aerodima.workbench.figures.tail_figures import plot_impulses, plot_moments

__all__ = [
    "plot_comparison",
    "plot_impulses",
    "plot_metrics",
    "plot_moments",
    "plot_outcomes",
    "plot_triggers",
    "plot_turn",
]
