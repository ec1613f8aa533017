"""Errors of the fits that a user can cause and mend."""

from aerodima.workbench.errors import UserError


class FitError(UserError, ValueError):
    """A fit cannot be set up or solved: bounds exclude the seed, a residual is not finite, too little data."""


class SwingError(UserError, ValueError):
    """A swing cannot be posed or found: no tail, a turn that needs none, limits that leave no motion, no solver."""
