"""Range check of settings, with the error message that a user needs."""

import math

from aerodima.workbench.errors import UserError


def check_range(name: str, value: float, low: float, high: float, unit: str, *, above_low: bool = False) -> None:
    """Raises UserError unless `value` is finite and within [low, high], or (low, high] with `above_low`.

    Args:
        name: where the value comes from, e.g. "controller.swing_speed".
        value: in the unit of the limits.
        low: smallest value allowed.
        high: largest value allowed; may be infinite.
        unit: printed after value and limits.
        above_low: refuse `low` itself.
    """
    if math.isfinite(value) and value <= high and (value > low if above_low else value >= low):
        return
    lower = f"{'>' if above_low else '>='} {low:g}"
    upper = f" and <= {high:g}" if math.isfinite(high) else ""
    raise UserError(f"{name}: {value:g} {unit}; allowed: {lower}{upper} {unit}")
