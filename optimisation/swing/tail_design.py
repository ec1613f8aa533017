"""A tail as large as the car carries and its motors swing: designed openly, not the one that was built.

The tunnel bounds the sail of the built tail (docs/tail_size.md): too small for the air to matter much. This one is as
large as the ground allows under a tail that lies sideways on a leaning car, and checked against the mass that the car
carries and the motor's peak and continuous torque. Numbers: `models/design/tail.yaml`; the result stands in
`models/scenarios/turn_designed.yaml`. A claim is about one of the two tails and says which.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.config.scenario_file import load_parameter_file
from aerodima.workbench.errors import FitError
from aerodima.workbench.resources import model_path

_STATIONS = 201
"""Along the sail, for the integrals of the air's force."""


@dataclass(frozen=True)
class TailDesign:
    """A tail and what it asks of car and motor.

    Attributes:
        length, sail_length, sail_width: m.
        rod_mass, sail_mass: kg, fixings included.
        inertia: about the roll axis with the rotor, kg m2.
        weight_torque: of the tail that lies sideways, N m.
        air_torque: about the roll axis at the swing rate, facing the driving wind, N m.
        air_force: across the car in that state, N.
        peak_torque: of a swing: air, ramp to the swing rate, weight and friction together, N m.
        rms_torque: over a cycle of swing and return, the rest held against the weight, N m.
        air_impulse: roll impulse of the air about the ground over a swing from side to side, N m s.
    """

    length: float
    sail_length: float
    sail_width: float
    rod_mass: float
    sail_mass: float
    inertia: float
    weight_torque: float
    air_torque: float
    air_force: float
    peak_torque: float
    rms_torque: float
    air_impulse: float

    @property
    def mass(self) -> float:
        """Rod and sail, kg."""
        return self.rod_mass + self.sail_mass

    def tail_parameters(self) -> dict[str, float]:
        """As section `tail` of a scenario, its mass rounded up to 5 g."""
        return {
            "length": self.length,
            "mass": math.ceil(self.mass * 200.0 - 1e-9) / 200.0,
            "sail_mass_fraction": round(self.sail_mass / self.mass, 2),
            "sail_length": self.sail_length,
            "sail_width": self.sail_width,
        }


def design_tail(scenario: Scenario | None = None, **changes: float) -> TailDesign:
    """The tail that fits the car of a scenario.

    Args:
        scenario: mount, motor, friction and air; by default those of `turn_designed`, whose mount is its own.
        changes: of numbers of `models/design/tail.yaml`, of `swing_rate` (rad/s; by default that of the scenario's
            controller) and `continuous_torque` (N m; the rated one of `models/parameters/hardware/motor_safety.yaml`).

    Raises:
        FitError: the tail does not clear the ground, is too heavy, or asks too much of the motor; with the numbers.
    """
    scenario = scenario or load_scenario("turn_designed")
    entries = load_parameter_file(model_path("design/tail.yaml"))
    limits = {name: float(entry.value) for name, entry in entries.items()}
    safety = load_parameter_file(model_path("parameters/hardware/motor_safety.yaml"))
    limits |= {"swing_rate": scenario.controller.swing_speed, "continuous_torque": float(safety["rated_torque"].value)}
    unknown = sorted(set(changes) - set(limits))
    if unknown:
        raise FitError(f"tail design: {unknown[0]}: unknown; allowed: {', '.join(limits)}")
    limits |= changes
    found = _size(scenario, limits)
    asked = {
        "mass (kg)": (found.mass, limits["mass_budget"]),
        "peak torque with margin (N m)": (
            found.peak_torque * limits["torque_margin"],
            scenario.tail_motor.torque_limit,
        ),
        "torque over a cycle (N m)": (found.rms_torque, limits["continuous_torque"]),
    }
    for words, (value, most) in asked.items():
        if value > most:
            raise FitError(f"tail design: {words} is {value:.3g}; allowed: at most {most:.3g}")
    return found


def _size(scenario: Scenario, limits: dict[str, float]) -> TailDesign:
    length = limits["length"]
    room = scenario.tail.mount_height - length * math.sin(limits["lean"]) - limits["ground_clearance"]
    width = math.floor(100.0 * 2.0 * room) / 100.0
    sail_length = round(length - limits["inner_end"], 3)
    if width <= 0.0 or sail_length <= 0.0:
        raise FitError(
            f"tail design: a tail of {length:g} m leaves no sail: {width:.3g} m wide above the ground, "
            f"{sail_length:.3g} m long beyond the wheels; allowed: both above 0"
        )
    extra = 1.0 + limits["fixings"]
    rod = extra * limits["rod_density"] * length
    half_cylinder = 0.5 * math.pi * width * sail_length
    discs = 0.25 * math.pi * width**2
    board = 0.5 * width * sail_length
    sail = extra * (
        limits["film_density"] * half_cylinder + limits["ring_density"] * discs + limits["board_density"] * board
    )
    middle = length - 0.5 * sail_length
    motor, gravity = scenario.tail_motor, scenario.environment.gravity
    inertia = rod * length**2 / 3.0 + sail * (middle**2 + sail_length**2 / 12.0)
    inertia += motor.rotor_inertia * motor.gear_ratio**2
    weight = gravity * (0.5 * rod * length + sail * middle)
    air, force = _air(scenario, limits, length, sail_length, width)
    rate = limits["swing_rate"]
    friction = scenario.friction.coulomb + scenario.friction.viscous * rate
    ramp = 0.5 * inertia * rate**2 / limits["ramp"]
    peak = air + ramp + weight + friction
    swing, back = math.pi / rate, math.pi / limits["return_rate"]
    slow = weight + scenario.friction.coulomb + scenario.friction.viscous * limits["return_rate"]
    held = max(limits["cycle"] - swing - back, 0.0)
    heat = peak**2 * swing + slow**2 * back + weight**2 * held
    # About the ground the force's arm grows by the height of the roll axis times the cosine of the angle.
    impulse = (math.pi * air + 2.0 * force * scenario.tail.mount_height) / rate
    return TailDesign(
        length, sail_length, width, rod, sail, inertia, weight, air, force, peak,
        math.sqrt(heat / (swing + back + held)), impulse,
    )  # fmt: skip


def _air(
    scenario: Scenario, limits: dict[str, float], length: float, sail_length: float, width: float
) -> tuple[float, float]:
    """Torque about the roll axis (N m) and force across the car (N) of a facing sail at the swing rate."""
    arm = np.linspace(length - sail_length, length, _STATIONS)
    across = limits["swing_rate"] * arm
    density, coefficient = scenario.environment.air_density, scenario.tail.normal_force_coefficient
    line = 0.5 * density * coefficient * width * np.hypot(across, limits["speed"]) * across
    return float(np.trapezoid(line * arm, arm)), float(np.trapezoid(line, arm))
