"""Who takes part in studies of turns: a name, and the settings that make it, which may depend on the turn's speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Search
from aerodima.optimisation.swing.full_car import FRICTION_STEP
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.law_of_scenario import find_swing
from aerodima.workbench.errors import SweepError
from aerodima.workbench.plants.car_model import gearbox_height
from aerodima.workbench.plants.tail import tail_geometry


@dataclass(frozen=True)
class Contestant:
    """One controller.

    Attributes:
        name: in tables and pictures.
        settings: overrides of any turn.
        choices: further settings by speed of the turn; the nearest speed's are taken.
        ballast: further settings of a car, from its scenario; None changes nothing.
    """

    name: str
    settings: tuple[str, ...]
    choices: Mapping[float, tuple[str, ...]] = field(default_factory=dict, hash=False)
    ballast: Callable[[Scenario], tuple[str, ...]] | None = None

    def at(self, speed: float) -> tuple[str, ...]:
        """Settings for a turn at a speed, m/s."""
        if not self.choices:
            return self.settings
        nearest = min(self.choices, key=lambda other: (abs(other - speed), other))
        return (*self.settings, *self.choices[nearest])


NO_TAIL = Contestant("no tail", ("tail.mode=none",))
HELD = Contestant("held", ("tail.mode=held",))
SWINGING = ("tail.mode=swing",)


def fixed_law(speed: float, release: float | None = None) -> tuple[str, ...]:
    """Settings of the thesis' law with another roll rate and release, both rad/s."""
    law = ("controller.swing_file=none", f"controller.swing_speed={speed!r}")
    return law if release is None else (*law, f"controller.trigger_yaw_rate={release!r}")


THESIS = Contestant("thesis, 8 rad/s", (*SWINGING, *fixed_law(8.0)))


LOW_PLACE = 0.07
"""Height at which a mass is low in the car, m: about that of the axles."""
LOW_CENTRE_HEIGHT = 0.20
"""m; of a car without tail, 4 cm lower than the nominal one."""


def low_ballast(scenario: Scenario) -> tuple[str, ...]:
    """The car without tail, its gearbox with both motors `LOW_PLACE` above the ground and the arm's mass with it."""
    car, tail = scenario.car, scenario.tail
    arm = tail_geometry(tail).inertial.mass + tail.hub_mass if tail.has_own_geometry else tail.mass + tail.hub_mass
    total = car.mass + arm
    lowered = LOW_PLACE - gearbox_height(car, tail)
    x = (car.mass * car.com_x + arm * car.gearbox_x) / total
    z = (car.mass * car.com_height + car.gearbox_mass * lowered + arm * LOW_PLACE) / total
    mount = tail.mount_height + lowered
    return (f"car.mass={total!r}", f"car.com_x={x!r}", f"car.com_height={z!r}", f"tail.mount_height={mount!r}")


def centre_of_raised(scenario: Scenario, mount_height: float) -> float:
    """Height of the car's centre of mass once its gearbox has moved with the tail's joints to another height, m."""
    car = scenario.car
    return car.com_height + car.gearbox_mass / car.mass * (mount_height - scenario.tail.mount_height)


LOW_BALLAST = Contestant("no tail, its mass low", NO_TAIL.settings, ballast=low_ballast)
LOW_CENTRE = Contestant(
    "no tail, centre of mass at 0.2 m", (*NO_TAIL.settings, f"car.com_height={LOW_CENTRE_HEIGHT!r}")
)


def swing_player(path_or_name: str) -> Contestant:
    """Plays a swing file.

    Raises:
        UserError: the file is missing or malformed.
    """
    place = str(Path(path_or_name).resolve()) if Path(path_or_name).exists() else path_or_name
    return Contestant(find_swing(path_or_name).name, (*SWINGING, f"controller.swing_file={place}"))


def refuse_twice(names: Sequence[str], what: str) -> None:
    """Raises SweepError where one of these is named twice: the rows of both would be taken for one.

    Args:
        names: of contestants, cars or numbers.
        what: they are, for the message.
    """
    for place, name in enumerate(names):
        if name in names[:place]:
            raise SweepError(f"{what} {name!r}: named twice; allowed: once")


FRICTION_CLIMB = Search(FRICTION, 0.3, 1.3, 0.05, FRICTION_STEP)
