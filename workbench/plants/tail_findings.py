"""What is odd about a tail: one line each, named before anything is simulated.

On any body: a face along the flow, sections inside the body, plates in each other's wake. Sections do not shade one
another in any law of ours. That holds for plates beside or behind one another along the tail. For plates one behind the
other in the flow it does not: in the plane wake of a plate with C_D the air is slower by 0.976 sqrt(C_D c / x) of its
speed, x behind a chord c, once x is beyond about 50 C_D c (Schlichting, Boundary-Layer Theory, wake of a single body):
at 100 chords with C_D 2 still by 14 %, which is 26 % of the force, and by far more next to the plate. So a second row
of plates is worth less than the model says at any distance that a tail has.

On a car: a tail that meets the ground in its range of motion or once the car leans, that overlaps the car, that the
motors cannot hold, and one that falls over because the gain on its angle is smaller than what its weight takes back.
"""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np

from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.scenario_file import load_parameter_file
from aerodima.workbench.config.signal_table import AXLES
from aerodima.workbench.plants.car_model import wheel_rates
from aerodima.workbench.plants.clearance import PARTS, TailQuery, tail_heights
from aerodima.workbench.plants.tail import tail_geometry
from aerodima.workbench.plants.tail_geometry import TailGeometry
from aerodima.workbench.plants.tail_plate import Vector, gap, overlap, unit_vector
from aerodima.workbench.resources import model_path

SWING_FLOW: Vector = (0.0, 1.0, 0.0)
"""Direction in which a roll swing moves the tail through the air."""

TIPPING_LEAN = math.radians(8.0)
"""Roll of the car on its springs and tyres at which both inner wheels are off the ground (models/README.md, "Tipping
limit"); a tail that meets the ground before does so in a turn that the car survives."""

_ALONG = 0.05
"""Cosine between normal and flow below which a plate is said to feel no force."""
_NODES = 19


def geometry_findings(
    geometry: TailGeometry, flow: Vector = SWING_FLOW, body: tuple[Vector, Vector] | None = None
) -> list[str]:
    """What is odd about a tail on any body.

    Args:
        flow: direction of the air past the tail in T; by default that of a roll swing.
        body: lower and upper corner in T, m, of a box that stands for the body that carries the tail.
    """
    found = []
    along = unit_vector(flow)
    for plate in geometry.plates:
        if max(abs(float(piece.normal @ along)) for piece in plate.pieces) < _ALONG:
            found.append(
                f"plate {plate.name!r}: its normal {_words(plate.normal)} is across the flow {_words(flow)}: air from "
                "there makes no force on it"
            )
    for one, other in permutations(geometry.plates, 2):
        apart = [gap(a, b) for a in one.pieces for b in other.pieces if overlap(a, b)]
        behind = min((distance for distance in apart if 0.0 < distance < math.inf), default=None)
        if behind is not None:
            chord = max(one.chords)
            found.append(
                f"plates {one.name!r} and {other.name!r} stand {behind:.3g} m ({behind / chord:.1f} chords) one behind "
                "the other: sections do not shade one another here, so broadside their force is too large"
            )
    if body is not None:
        low, high = np.asarray(body[0]), np.asarray(body[1])
        for plate in geometry.plates:
            centres = np.vstack([layout.p_BoSi_B for layout in plate.section_layouts()])
            inside = int(np.sum(np.all((centres > low) & (centres < high), axis=1)))
            if inside:
                found.append(f"plate {plate.name!r}: {inside} of {len(centres)} sections are inside the body")
    return found


def tail_findings(scenario: Scenario, geometry: TailGeometry | None = None) -> list[str]:
    """What is odd about a tail on the car of a scenario, without asking Drake; nothing for a car without tail.

    Args:
        geometry: the tail; by default the scenario's own.
    """
    if scenario.tail.mode == "none":
        return []
    own = geometry or tail_geometry(scenario.tail)
    return [*geometry_findings(own), *_ground_findings(scenario, own), *_motor_findings(scenario, own)]


def _points(scenario: Scenario, geometry: TailGeometry) -> np.ndarray:
    """Outermost points of a tail in T (n, 3), m; a sail that turns on its bearing has its edges all around."""
    if scenario.tail.sail == "locked":
        return geometry.points
    radius = scenario.tail.sail_reach if scenario.tail.sail == "free" else scenario.tail.sail_width / 2
    angles = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    ends = (scenario.tail.length - scenario.tail.sail_length, scenario.tail.length)
    return np.vstack([geometry.arm.points, *(np.column_stack([ring, np.full(len(ring), z)]) for z in ends)])


def _lowest(scenario: Scenario, points: np.ndarray, pitch: float, roll: float, lean: float = 0.0) -> float:
    root, *axes = (float(value) for value in tail_heights(scenario, pitch, roll, lean))
    return root + float((points @ np.asarray(axes)).min())


def _ground_findings(scenario: Scenario, geometry: TailGeometry) -> list[str]:
    tail, points = scenario.tail, _points(scenario, geometry)
    pitches = np.linspace(-tail.pitch_limit, tail.pitch_limit, _NODES)
    rolls = np.linspace(-tail.roll_limit, tail.roll_limit, _NODES)
    depth, pitch, roll = min((_lowest(scenario, points, p, r), p, r) for p in pitches for r in rolls)
    if depth < 0.0:
        return [
            f"the tail reaches {-depth:.3g} m below the ground within its range of motion: pitch "
            f"{math.degrees(pitch):.0f}, roll {math.degrees(roll):.0f} deg on a level car"
        ]
    held = scenario.controller.pitch_angle
    leans = np.radians(np.arange(0.0, 45.0, 0.1))
    touching = [lean for lean in leans if _lowest(scenario, points, held, tail.roll_limit, lean) < 0.0]
    if not touching:
        return []
    own, touch = math.degrees(resting_lean(scenario, geometry)), math.degrees(touching[0])
    if own >= 90.0:
        return ["the car falls over: the weight of its tail sideways tips it while it stands"]
    if touch <= 2.0 * own:
        return [
            f"the tail falls on the ground: sideways its weight leans the standing car by about {own:.1f} deg, and "
            f"twice that when it is let go; it touches from {touch:.1f} deg on"
        ]
    if touching[0] < TIPPING_LEAN:
        tips = math.degrees(TIPPING_LEAN)
        return [f"sideways the tail touches the ground once the car leans {touch:.1f} deg, before it tips ({tips:.0f})"]
    return []


def resting_lean(scenario: Scenario, geometry: TailGeometry) -> float:
    """Roll (rad) of the standing car whose tail lies sideways, on suspension and tyres in series; pi/2: it tips."""
    car, gravity = scenario.car, scenario.environment.gravity
    stiffness = -car.mass * gravity * car.com_height
    for axle in AXLES:
        tyre = car.tyre_stiffness_front if axle == "front" else car.tyre_stiffness_rear
        wheel = 1.0 / (1.0 / wheel_rates(car, axle)[0] + 1.0 / tyre)
        stiffness += 2.0 * wheel * (car.track / 2) ** 2
    weight = weight_torque(geometry, gravity)
    if stiffness <= 0.0 or weight > car.mass * gravity * car.outer_half_track:
        return math.pi / 2
    return min(weight / stiffness, math.pi / 2)


def weight_torque(geometry: TailGeometry, gravity: float) -> float:
    """Torque of the weight of arm and plates about the roll axis when the tail lies sideways, N m."""
    whole = geometry.inertial
    return whole.mass * gravity * math.hypot(whole.com[1], whole.com[2])


def _motor_findings(scenario: Scenario, geometry: TailGeometry) -> list[str]:
    torque = weight_torque(geometry, scenario.environment.gravity)
    rated = float(load_parameter_file(model_path("parameters/hardware/motor_safety.yaml"))["rated_torque"].value)
    peak, found = scenario.tail_motor.torque_limit, []
    said = f"sideways the tail weighs {torque:.3g} N m about the roll axis"
    if torque > peak:
        found.append(f"{said}: more than the {peak:.3g} N m that its motor has at the most: it falls")
    elif torque > rated:
        found.append(f"{said}: more than the {rated:.3g} N m that its motor holds for long")
    control = scenario.controller
    gains = {"hold_kp": control.hold_kp, "settle_kp": control.settle_kp}
    for name, gain in gains.items():
        if torque > gain:
            found.append(
                f"the tail falls over: its weight takes back {torque:.3g} N m per rad from upright, controller.{name} "
                f"gives {gain:.3g}; only the stops of its joint hold it"
            )
    whole = geometry.inertial
    inertia = whole.moments[0] + whole.mass * (whole.com[1] ** 2 + whole.com[2] ** 2)
    reach = math.sqrt(2.0 * max(peak - torque, 0.0) * control.travel / inertia)
    if torque <= peak and reach < control.swing_speed:
        found.append(
            f"the motor's peak torque brings the tail to {reach:.2g} rad/s within the swing's travel; "
            f"controller.swing_speed is {control.swing_speed:.3g}"
        )
    return found


def overlap_findings(scenario: Scenario) -> list[str]:
    """Where the scenario's tail overlaps its car over the range of roll, at the pitch that is held; asks Drake.

    Raises:
        ModelError: the car does not load.
    """
    if scenario.tail.mode == "none":
        return []
    query, tail = TailQuery(scenario), scenario.tail
    rolls = np.linspace(-tail.roll_limit, tail.roll_limit, _NODES)
    found = np.array([query.clearances(scenario.controller.pitch_angle, float(roll)) for roll in rolls])
    worst = found.argmin(axis=0)
    return [
        f"the tail is {-1000 * found[worst[part], part]:.0f} mm inside the {name} at roll "
        f"{math.degrees(rolls[worst[part]]):.0f} deg"
        for part, name in enumerate(PARTS)
        if name != "ground" and found[worst[part], part] < 0.0
    ]


def _words(vector: Vector) -> str:
    return "(" + ", ".join(f"{value:g}" for value in vector) + ")"
