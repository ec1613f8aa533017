"""A tail as large as the car carries and its motors swing: designed openly, not the one that was built.

The tunnel bounds the sail of the built tail (docs/tail_size.md): too small for the air to matter much. This one is as
large as the ground allows under a tail that lies sideways on a leaning car, and checked against the mass that the car
carries and the motor's peak and continuous torque. Numbers: `models/design/tail.yaml`; the result stands in
`models/scenarios/turn_designed.yaml`. A claim is about one of the two tails and says which. `swing_demand` tells of any
tail what it asks of its motor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.scenario_file import load_parameter_file
from aerodima.workbench.errors import FitError
from aerodima.workbench.plants.tail_findings import weight_torque
from aerodima.workbench.plants.tail_geometry import TailArm, TailGeometry
from aerodima.workbench.plants.tail_plate import Plate
from aerodima.workbench.resources import model_path

_STATIONS = 201
"""Along the sail, for the integrals of the air's force."""


@lru_cache(maxsize=1)
def design_numbers() -> MappingProxyType[str, float]:
    """What a designed tail is made of and must keep: `models/design/tail.yaml`, and the motor's limits.

    With `rated_torque` (N m) and `overload` (N2 m2 s) of `models/parameters/hardware/motor_safety.yaml`, of which
    `overload_share` may be used.
    """
    safety = load_parameter_file(model_path("parameters/hardware/motor_safety.yaml"))
    numbers = {name: float(entry.value) for name, entry in load_parameter_file(model_path("design/tail.yaml")).items()}
    numbers |= {name: float(safety[name].value) for name in ("rated_torque", "overload", "overload_share")}
    return MappingProxyType(numbers)


@dataclass(frozen=True)
class SwingDemand:
    """What a tail asks of car and motor.

    Attributes:
        inertia: about the roll axis with the rotor, kg m2.
        weight_torque: of the tail that lies sideways, N m.
        air_torque: about the roll axis at the swing rate, facing the driving wind, N m.
        air_force: across the car in that state, N.
        peak_torque: of a swing: air, ramp to the swing rate, weight and friction together, N m.
        rms_torque: over a cycle of swing and return, the rest held against the weight, N m; no swing takes more than
            the motor has.
        overload: square of the torque beyond the rated one over the swing, N2 m2 s.
        air_impulse: roll impulse of the air about the ground over a swing from side to side, N m s.
    """

    inertia: float
    weight_torque: float
    air_torque: float
    air_force: float
    peak_torque: float
    rms_torque: float
    overload: float
    air_impulse: float


def swing_demand(scenario: Scenario, geometry: TailGeometry, numbers: Mapping[str, float] | None = None) -> SwingDemand:
    """What a straight tail with one sail asks of the car of a scenario.

    Args:
        numbers: in place of `design_numbers`; with `swing_rate`, rad/s, that of the scenario's controller without.
    """
    limits = {"swing_rate": scenario.controller.swing_speed, **(numbers or design_numbers())}
    motor, friction, rate = scenario.tail_motor, scenario.friction, limits["swing_rate"]
    inertia = float(geometry.inertia_about_joints[0, 0]) + motor.rotor_inertia * motor.gear_ratio**2
    weight = weight_torque(geometry, scenario.environment.gravity)
    air, force = _air(scenario, geometry.plates[0], rate, limits["speed"])
    ramp = 0.5 * inertia * rate**2 / limits["ramp"]
    peak = air + ramp + weight + friction.coulomb + friction.viscous * rate
    swing, back = math.pi / rate, math.pi / limits["return_rate"]
    slow = weight + friction.coulomb + friction.viscous * limits["return_rate"]
    held = max(limits["cycle"] - swing - back, 0.0)
    given = min(peak, motor.torque_limit)
    heat = given**2 * swing + slow**2 * back + weight**2 * held
    return SwingDemand(
        inertia=inertia,
        weight_torque=weight,
        air_torque=air,
        air_force=force,
        peak_torque=peak,
        rms_torque=math.sqrt(heat / (swing + back + held)),
        overload=max(given**2 - limits["rated_torque"] ** 2, 0.0) * swing,
        # About the ground the force's arm grows by the height of the roll axis times the cosine of the angle.
        air_impulse=(math.pi * air + 2.0 * force * scenario.tail.mount_height) / rate,
    )


@dataclass(frozen=True)
class TailDesign:
    """A tail and what it asks of car and motor."""

    geometry: TailGeometry
    demand: SwingDemand

    @property
    def mass(self) -> float:
        """Rod and sail, kg."""
        return self.geometry.inertial.mass

    def tail_parameters(self) -> dict[str, float]:
        """As section `tail` of a scenario, its mass rounded up to 5 g."""
        (sail,) = self.geometry.plates
        return {
            "length": sum(self.geometry.arm.lengths),
            "mass": math.ceil(self.mass * 200.0 - 1e-9) / 200.0,
            "sail_mass_fraction": round(self.geometry.sail_mass.mass / self.mass, 2),
            "sail_length": sail.lengths[0],
            "sail_width": sail.chords[0],
        }


def design_tail(scenario: Scenario | None = None, **changes: float) -> TailDesign:
    """The tail that fits the car of a scenario.

    Args:
        scenario: mount, motor, friction and air; by default those of `turn_designed`, whose mount is its own.
        changes: of `design_numbers`, or of `swing_rate` (rad/s; by default that of the scenario's controller).

    Raises:
        FitError: the tail does not clear the ground, is too heavy, or asks too much of the motor; with the numbers.
    """
    scenario = scenario or load_scenario("turn_designed")
    limits = {**design_numbers(), "swing_rate": scenario.controller.swing_speed}
    unknown = sorted(set(changes) - set(limits))
    if unknown:
        raise FitError(f"tail design: {unknown[0]}: unknown; allowed: {', '.join(limits)}")
    limits |= changes
    geometry = _size(scenario, limits)
    found = TailDesign(geometry, swing_demand(scenario, geometry, limits))
    asked = {
        "mass (kg)": (found.mass, limits["mass_budget"]),
        "peak torque with margin (N m)": (
            found.demand.peak_torque * limits["torque_margin"],
            scenario.tail_motor.torque_limit,
        ),
        "torque over a cycle (N m)": (found.demand.rms_torque, limits["rated_torque"]),
    }
    for words, (value, most) in asked.items():
        if value > most:
            raise FitError(f"tail design: {words} is {value:.3g}; allowed: at most {most:.3g}")
    return found


def _size(scenario: Scenario, limits: dict[str, float]) -> TailGeometry:
    length = limits["length"]
    room = scenario.tail.mount_height - length * math.sin(limits["lean"]) - limits["ground_clearance"]
    width = math.floor(100.0 * 2.0 * room) / 100.0
    sail_length = round(length - limits["inner_end"], 3)
    if width <= 0.0 or sail_length <= 0.0:
        raise FitError(
            f"tail design: a tail of {length:g} m leaves no sail: {width:.3g} m wide above the ground, "
            f"{sail_length:.3g} m long beyond the wheels; allowed: both above 0"
        )
    film = limits["film_density"] * 0.5 * math.pi
    discs = limits["ring_density"] * 0.25 * math.pi * width / sail_length
    areal = film + discs + 0.5 * limits["board_density"]
    extra = 1.0 + limits["fixings"]
    return straight_tail("designed", length, sail_length, width, extra * areal, extra * limits["rod_density"])


def straight_tail(
    name: str, length: float, sail_length: float, sail_width: float, areal_mass: float, rod_density: float
) -> TailGeometry:
    """A rod (kg/m) with one rectangular sail (kg/m2 of planform) that ends at its tip; lengths in m."""
    sail = Plate(
        name="sail",
        root=(0.0, 0.0, length - sail_length),
        lengths=(sail_length,),
        chords=(sail_width, sail_width),
        normal=(0.0, -1.0, 0.0),
        density=areal_mass,
    )
    return TailGeometry(name, TailArm((length,), rod_density), (sail,))


def _air(scenario: Scenario, sail: Plate, rate: float, speed: float) -> tuple[float, float]:
    """Torque about the roll axis (N m) and force across the car (N) of a facing sail at a swing rate."""
    arm = np.linspace(sail.root[2], sail.root[2] + sail.lengths[0], _STATIONS)
    across = rate * arm
    density, coefficient = scenario.environment.air_density, scenario.tail.normal_force_coefficient
    line = 0.5 * density * coefficient * sail.chords[0] * np.hypot(across, speed) * across
    return float(np.trapezoid(line * arm, arm)), float(np.trapezoid(line, arm))
