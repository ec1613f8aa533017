"""Who takes part in the leaderboard, how much is run, and what may be otherwise than planned.

A controller is a name and the settings that make it, which may depend on the speed of the turn. A perturbation is a
named change of a scenario that a controller should stand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED, Search
from aerodima.optimisation.swing.full_car import FINE_STEP, FRICTION_STEP
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.law_of_scenario import find_swing
from aerodima.workbench.plants.car_model import gearbox_height
from aerodima.workbench.plants.tail import tail_geometry
from aerodima.workbench.resources import models_dir

FIXED_SPEEDS = (5.5, 6.0, 6.5, 7.0, 7.5, 9.0)
"""rad/s; with `FIXED_RELEASES` those among which the best fixed speed is looked for."""
FIXED_RELEASES = (0.5, 1.0)
"""Yaw rates that release the swing, rad/s."""
PUBLISHED_SWING = "thesis_8_rad_per_s"


@dataclass(frozen=True)
class Contestant:
    """One controller.

    Attributes:
        name: in tables and pictures.
        settings: overrides of any turn.
        swings: swing files that it plays, by the speed (m/s) that they were made for; empty without.
        choices: further settings by speed of the turn; the nearest speed's are taken.
        ballast: further settings of a car, from its scenario; None changes nothing.
    """

    name: str
    settings: tuple[str, ...]
    swings: tuple[str, ...] = ()
    choices: Mapping[float, tuple[str, ...]] = field(default_factory=dict, hash=False)
    ballast: Callable[[Scenario], tuple[str, ...]] | None = None

    def at(self, speed: float) -> tuple[str, ...]:
        """Settings for a turn at a speed, m/s."""
        if not self.choices:
            return self.settings
        nearest = min(self.choices, key=lambda other: (abs(other - speed), other))
        return (*self.settings, *self.choices[nearest])

    def made_for(self, speed: float) -> bool:
        """Whether it may be asked for a turn at a speed (m/s): swings are for the speeds that they were made for."""
        return not self.swings or not self.choices or speed in self.choices


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


def raised_gearbox(scenario: Scenario, mount_height: float) -> tuple[str, ...]:
    """The car with the tail's joints at another height, m, its gearbox moved with them."""
    centre = centre_of_raised(scenario, mount_height)
    return (f"car.com_height={centre!r}", f"tail.mount_height={mount_height!r}")


LOW_BALLAST = Contestant("no tail, its mass low", NO_TAIL.settings, ballast=low_ballast)
LOW_CENTRE = Contestant(
    "no tail, centre of mass at 0.2 m", (*NO_TAIL.settings, f"car.com_height={LOW_CENTRE_HEIGHT!r}")
)


def best_fixed(choices: Mapping[float, tuple[float, float]], name: str = "best fixed speed") -> Contestant:
    """The thesis' law with roll rate and release (rad/s) by speed of the turn (m/s)."""
    words = ", ".join(f"{rate:g} @ {release:g}" for rate, release in dict.fromkeys(choices.values()))
    laws = {speed: fixed_law(*choice) for speed, choice in choices.items()}
    return Contestant(f"{name} ({words})", SWINGING, choices=laws)


def swing_player(path_or_name: str, tracking: str = "joint_pd") -> Contestant:
    """Plays a swing file; without feedback unless another tracking is asked for.

    Raises:
        UserError: the file is missing or malformed.
    """
    swing = find_swing(path_or_name)
    name = swing.name if tracking == "joint_pd" else f"{swing.name} ({tracking.replace('_', ' ')})"
    return Contestant(name, (*SWINGING, *_playing(path_or_name, tracking)), (path_or_name,))


def swing_players(swings: Sequence[str]) -> list[Contestant]:
    """Optimised swings of one kind are one controller, that plays the one made for the speed; others by themselves.

    Raises:
        UserError: a file is missing or malformed.
    """
    kinds: dict[str, dict[float, str]] = {}
    alone = []
    for path in swings:
        swing = find_swing(path)
        kind, speed = _kind(swing), swing.provenance.found.get("survived_speed_m_per_s")
        if kind is None or speed is None or float(speed) in kinds.get(kind, {}):
            alone.append(swing_player(path))
        else:
            kinds.setdefault(kind, {})[float(speed)] = path
    found = []
    for kind, paths in sorted(kinds.items()):
        choices = {speed: _playing(path, "joint_pd") for speed, path in sorted(paths.items())}
        found.append(Contestant(kind, SWINGING, tuple(paths[speed] for speed in sorted(paths)), choices))
    return found + alone


def trackings_of(path_or_name: str) -> list[Contestant]:
    """A swing in the ways it can be played, for the table of robustness; a refined one has no torques of its own."""
    ways = ["joint_pd"]
    swing = find_swing(path_or_name)
    if swing.gains.feedback is not None:
        ways += ["feedback", "open_loop"]
    elif swing.knots.roll_torque_n_m is not None:
        ways += ["open_loop"]
    return [swing_player(path_or_name, way) for way in ways]


def shipped_swings() -> list[str]:
    """Names of the optimised swings in `models/swings`."""
    return sorted(p.stem for p in (models_dir() / "swings").glob("*.yaml") if p.stem != PUBLISHED_SWING)


def standard_contestants(swings: Sequence[str]) -> list[Contestant]:
    """Without the best fixed speed, which is found first."""
    return [NO_TAIL, HELD, THESIS, *swing_players(swings)]


def _playing(path_or_name: str, tracking: str) -> tuple[str, ...]:
    place = str(Path(path_or_name).resolve()) if Path(path_or_name).exists() else path_or_name
    return (f"controller.swing_file={place}", f"controller.tracking={tracking}")


def _kind(swing: SwingFile) -> str | None:
    """By joints, cars and heading; None for a swing that was not optimised."""
    options, found = swing.provenance.options, swing.provenance.found
    if "dof" not in options:
        return None
    joints = {1: "roll", 2: "roll and pitch"}[int(options["dof"])]
    cars = f", {options['members']} more cars" if options.get("members") else ""
    turning = "" if "heading_ratio" in found else ", heading free"
    return f"optimised {joints}{cars}{turning}"


FRICTION_CLIMB = Search(FRICTION, 0.3, 1.3, 0.05, FRICTION_STEP)
ROBUST_CLIMB = Search(FRICTION, 0.3, 1.3, 0.05, 2 * FRICTION_STEP)
FINE_CLIMB = Search(FRICTION, 0.3, 1.3, 0.025, FRICTION_STEP)
SPEED_CLIMB = Search(SPEED, 2.5, 8.0, 0.5, 0.1)
NEAR_CLIMB = Search(FRICTION, 0.3, 1.3, FRICTION_STEP, FRICTION_STEP)
FIRST_SPEED = 3.5
"""m/s; where the climb over speed begins."""


@dataclass(frozen=True)
class Plan:
    """How much is run.

    Attributes:
        speeds: of the turns, m/s; the middle one is also that of maps and robustness.
        friction: climb of the critical friction; at the fine step `fine` from the published swing's upwards, and `near`
            where the ordinary step is expected to be right; `robust` under perturbations.
        top_speed: climb of the highest speed at `grip` times the car's own friction.
        map_speeds: of the survival map.
        map_strides: its frictions, in strides of the climb above the car's own.
        step: of the plant, s; `fine_step` that of claims.
        perturbed: whether the robustness is measured.
        fixed, releases: roll rates and yaw rates of release tried for the best fixed speed, rad/s.
    """

    speeds: tuple[float, ...] = (3.6, 4.5, 6.0)
    friction: Search = FRICTION_CLIMB
    fine: Search = FINE_CLIMB
    near: Search = NEAR_CLIMB
    robust: Search = ROBUST_CLIMB
    top_speed: Search = SPEED_CLIMB
    grip: float = 1.1
    map_speeds: tuple[float, ...] = (3.6, 4.5, 6.0)
    map_strides: tuple[int, ...] = (0, 1, 2, 3, 4)
    step: float = 0.002
    fine_step: float = FINE_STEP
    perturbed: bool = True
    fixed: tuple[float, ...] = FIXED_SPEEDS
    releases: tuple[float, ...] = FIXED_RELEASES

    @property
    def middle_speed(self) -> float:
        """m/s."""
        return sorted(self.speeds)[len(self.speeds) // 2]


QUICK = Plan(
    speeds=(4.5,),
    top_speed=Search(SPEED, 3.0, 6.0, 1.0, 0.5),
    map_speeds=(3.6, 4.5, 6.0),
    map_strides=(0, 2, 4),
    fine_step=0.002,
    perturbed=False,
    fixed=(6.0, 7.0),
    releases=(1.0,),
)
"""A look in minutes, without the fine step."""


AIR_SHARE, FRICTION_SHARE, TORQUE_SHARE = 0.3, 0.05, 0.2
DELAY = 0.020
"""s, on top of the delay of the scenario's IMU."""
NOISE_FACTOR = 4.0
"""Noise and bias of the IMU grow by this: to about the upper ends of their priors."""


@dataclass(frozen=True)
class Perturbation:
    """A change: a name for tables, and the settings that make it."""

    name: str
    settings: tuple[str, ...]


def perturbations(scenario: Scenario) -> list[Perturbation]:
    """The changes of a scenario, "as planned" first.

    The force of the sail is changed through the density of the air, which acts on nothing else, so that every kind of
    coefficients can be perturbed; it equals a change of C_N.
    """
    air, friction, imu = scenario.environment.air_density, scenario.car.tyre_friction, scenario.imu
    noises = ("gyro_noise", "gyro_bias", "accelerometer_noise", "attitude_noise")
    noisy = tuple(f"imu.{name}={NOISE_FACTOR * getattr(imu, name):.9g}" for name in noises)
    late = f"imu.delay={imu.delay + DELAY:.9g}"
    weak, strong = (f"environment.air_density={air * (1 + sign * AIR_SHARE):.9g}" for sign in (-1, 1))
    return [
        Perturbation("as planned", ()),
        Perturbation("C_N -30 %", (weak,)),
        Perturbation("C_N +30 %", (strong,)),
        Perturbation("IMU 20 ms late", (late,)),
        Perturbation("IMU noise x4", noisy),
        Perturbation("C_N -30 %, late, noisy", (weak, late, *noisy)),
        Perturbation("C_N +30 %, late, noisy", (strong, late, *noisy)),
        Perturbation("friction -5 %", (f"car.tyre_friction={friction * (1 - FRICTION_SHARE):.9g}",)),
        Perturbation("friction +5 %", (f"car.tyre_friction={friction * (1 + FRICTION_SHARE):.9g}",)),
        Perturbation("torque -20 %", (f"tail_motor.torque_error={-TORQUE_SHARE}",)),
        Perturbation("torque +20 %", (f"tail_motor.torque_error={TORQUE_SHARE}",)),
    ]
