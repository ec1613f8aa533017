"""Check of the limits of a number from outside, without the library that reads files."""

import math

from aerodima.workbench.core.errors import UserError

NO_UNIT = "1"
"""Unit of a dimensionless number, a name, a flag or a count."""


def check_range(
    name: str,
    value: float,
    low: float,
    high: float,
    unit: str,
    *,
    above_low: bool = False,
    error: type[UserError] = UserError,
) -> None:
    """Raise `error` unless `value` is finite and within [low, high].

    Args:
        name: name of the setting that holds the value, e.g. "controller.swing_speed".
        value: number that is checked, in the unit of the limits.
        low: smallest value allowed.
        high: largest value allowed; may be infinite.
        unit: unit printed after the value.
        above_low: whether `low` itself is refused.
        error: class of the error raised.
    """
    if math.isfinite(value) and low <= value <= high and not (above_low and value == low):
        return
    shown = "" if unit == NO_UNIT else f" {unit}"
    relation = ">" if above_low else ">="
    limits = ["finite"]
    if low > -math.inf:
        limits.append(f"{relation} {low:g}{shown}")
    if high < math.inf:
        limits.append(f"<= {high:g}{shown}")
    if not above_low and math.isfinite(high - low):
        limits = [f"{low:g} to {high:g}{shown}"]
    raise error(f"{name}: {value:g}{shown} must be {', '.join(limits)}")
