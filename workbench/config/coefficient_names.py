"""Names of coefficient sets that suit the robot's tail; plain Python, so that a scenario is checked without Drake."""

from functools import cache
from pathlib import Path

import yaml

from aerodima.workbench.config.quantity import nearest
from aerodima.workbench.resources import models_dir

CONSTANT = "constant"
"""Word for the plain number of `tail.normal_force_coefficient`."""

FILE_ENDINGS = (".yaml", ".yml", ".csv")
_SAIL_LAWS = ("normal_force", "two_sided")


@cache
def robot_tail_sets() -> tuple[str, ...]:
    """Embedded sets (`models/coefficients`) whose law knows the normal of a sail, sorted."""
    files = sorted((models_dir() / "coefficients").glob("*.yaml"))
    return tuple(
        path.stem for path in files if yaml.safe_load(path.read_text(encoding="utf-8")).get("law") in _SAIL_LAWS
    )


def require_coefficient_name(name: str) -> None:
    """Refuses (ValueError) what is neither `constant` nor a set for the robot's tail nor a path of a YAML or CSV file.

    A file is looked at when the car is built: a log stays readable where the file is not at hand.
    """
    if name == CONSTANT or Path(name).suffix in FILE_ENDINGS or name in robot_tail_sets():
        return
    known = [CONSTANT, *robot_tail_sets()]
    raise ValueError(
        f"coefficients: {name!r} is no set for the robot's tail; {nearest(name, known)}; "
        f"or the path of a file ({', '.join(FILE_ENDINGS)})"
    )
