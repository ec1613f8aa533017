"""Errors that a user can cause and fix: one line with the place, the value and what is allowed."""


class UserError(Exception):
    """Wrong input from outside (file, flag, frame, port).

    The command line prints it and exits with status 2. A parser or a device may report several
    lines; the message joins them into one.
    """

    def __init__(self, message: str = "") -> None:
        lines = [line.strip() for line in str(message).splitlines()]
        super().__init__(" ".join(line for line in lines if line))


class ScenarioError(UserError, ValueError):
    """A scenario or parameter file has an unknown key, a wrong unit or a value out of range."""


class ModelError(UserError, ValueError):
    """A model file is missing, does not load, is unphysical, or carries an attribute that Drake
    would ignore.
    """


class LogError(UserError, ValueError):
    """A run log is missing, truncated, of another schema, or would be overwritten."""


class SwingFileError(UserError, ValueError):
    """A swing file is malformed or was made for another car."""


class HardwareError(UserError):
    """A device, a bus, a frame or a wiring of the real car is not as it must be."""


class EnsembleError(UserError, ValueError):
    """An ensemble file is missing, malformed, of another schema, or one of its members is not a
    possible car.
    """


class FitError(UserError, ValueError):
    """A fit cannot be set up or solved: bounds exclude the seed, a residual is not finite, too
    little data.
    """


class SwingError(UserError, ValueError):
    """A swing cannot be posed or found: no tail, a turn that needs none, limits that leave no
    motion, no solver.
    """


class SweepError(UserError):
    """A sweep cannot go on: a folder is in use, damaged or full, or a study is invalid."""
