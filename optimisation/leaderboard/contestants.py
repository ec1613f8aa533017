"""Who takes part: a controller is a name and the settings that make it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from workbench.controllers.law_of_scenario import find_swing
from workbench.resources import models_dir

FIXED_SPEEDS = (4.0, 5.0, 6.0, 7.0, 9.0)
"""rad/s; the best of them is the "best fixed speed". The thesis' 8 rad/s takes part on its own."""
PUBLISHED_SWING = "thesis_8_rad_per_s"


@dataclass(frozen=True)
class Contestant:
    """One controller.

    Attributes:
        name: in tables and pictures.
        settings: overrides of any turn.
        swing: name of its swing file, without which there is none.
    """

    name: str
    settings: tuple[str, ...]
    swing: str = ""


NO_TAIL = Contestant("no tail", ("tail.mode=none",))
HELD = Contestant("held", ("tail.mode=held",))


def fixed_speed(speed: float, name: str = "") -> Contestant:
    """The thesis' law with another roll rate, rad/s."""
    law = ("tail.mode=swing", "controller.swing_file=none", f"controller.swing_speed={speed!r}")
    return Contestant(name or f"{speed:g} rad/s", law)


THESIS = fixed_speed(8.0, "thesis, 8 rad/s")


def swing_player(path_or_name: str, tracking: str = "automatic") -> Contestant:
    """Plays a swing file.

    Raises:
        UserError: the file is missing or malformed.
    """
    swing = find_swing(path_or_name)
    place = str(Path(path_or_name).resolve()) if Path(path_or_name).exists() else path_or_name
    name = swing.name if tracking == "automatic" else f"{swing.name} ({tracking.replace('_', ' ')})"
    law = ("tail.mode=swing", f"controller.swing_file={place}", f"controller.tracking={tracking}")
    return Contestant(name, law, place)


def trackings_of(path_or_name: str) -> list[Contestant]:
    """The same swing in every way it can be played, for the table of robustness."""
    ways = ["joint_pd"]
    swing = find_swing(path_or_name)
    if swing.gains.feedback is not None:
        ways += ["torque", "open_loop"]
    elif swing.knots.roll_torque_n_m is not None:
        ways += ["open_loop"]
    return [swing_player(path_or_name, way) for way in ways]


def shipped_swings() -> list[str]:
    """Names of the optimised swings in `models/swings`."""
    return sorted(p.stem for p in (models_dir() / "swings").glob("*.yaml") if p.stem != PUBLISHED_SWING)


def standard_contestants(swings: Sequence[str]) -> list[Contestant]:
    """Without the best fixed speed, which is found first."""
    return [NO_TAIL, HELD, THESIS, *(swing_player(swing) for swing in swings)]
