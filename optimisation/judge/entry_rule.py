"""Rule by which a run completes its manoeuvre, as a function of the row of the run.

No two wheels of one side are more than `TWO_WHEELS` above the ground at a time, nothing but wheels
touches it from the start of the steering on (the anti-ramp board: while the car is steered; it
catches a car that gathers speed again), and the car survives. On a path, the path is kept to its
end. Elsewhere the car goes straight again: it yaws at most `EXIT_YAW_RATE` at the end of the run,
unless it is steered there, and it turns enough: its mean lateral acceleration while it is steered
is at least `MIN_LATERAL_SHARE` of that of the car without tail.
"""

from typing import Literal

import numpy as np

from aerodima.workbench.car.verdict import goes_straight, keeps_path, keeps_sides_down
from aerodima.workbench.core.file_reading import Facts

MIN_LATERAL_SHARE = 0.9
"""Share of the tailless car's lateral acceleration that a candidate must reach."""
OFF_PATH = "off_path_m"
"""Column of a run on a path: how far it leaves its lane, m, not above 0 where it keeps to it."""
PATH_END = "path_end_reached"
"""Column of a run on a path: whether it gets to the end."""
ERROR = "error: "
"""Begins the failure of a run without outcome."""
LATERAL = "lateral"
"""Failure of a run with too little lateral acceleration."""
Rule = Literal["lateral", "path"]
"""Condition beside staying upright: enough lateral acceleration, or a path that is kept."""


def failed_rule(row: Facts, rule: Rule, lateral: float, min_lateral: float) -> str:
    """Returns the first rule that a run breaks; empty where it breaks none.

    It is `two wheels`, `ground: PART`, `flipped`, `path`, `end of the path` (too slow), `exit`,
    `lateral` or `error: ...`.

    Args:
        row: of the run.
        rule: of its manoeuvre.
        lateral: mean lateral acceleration of the run, m/s2; NaN where it has none.
        min_lateral: that is enough, m/s2; -inf for the candidate without tail.
    """
    if row["outcome"] is None:
        return f"{ERROR}{row['error']}"
    missing = [name for name in ("side_lift_m", "touched_when_steered") if row.get(name) is None]
    if rule == "path":
        missing += [name for name in (OFF_PATH, PATH_END) if name not in row]
    if missing:
        return f"{ERROR}the row has no {', '.join(missing)}"
    touched = row["touched_when_steered"]
    broken = {
        "two wheels": not keeps_sides_down(row["side_lift_m"]),
        f"ground: {touched}": bool(touched),
        "flipped": row["outcome"] != "survived",
    }
    if rule == "path":
        off = row[OFF_PATH]
        broken["path"] = off is None or not keeps_path(off)
        broken["end of the path"] = not row[PATH_END]
    else:
        last = row.get("last_yaw_rate_rad_per_s")
        broken["exit"] = not goes_straight(last is None, np.nan if last is None else last)
        broken[LATERAL] = not lateral >= min_lateral
    return next((name for name, is_broken in broken.items() if is_broken), "")
