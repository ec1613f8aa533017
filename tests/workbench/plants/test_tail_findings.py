"""What is odd about a tail is named, and an ordinary one is not blamed."""

from __future__ import annotations

import math
import re

import pytest

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.plants.tail import tail_geometry
from aerodima.workbench.plants.tail_findings import (
    geometry_findings,
    overlap_findings,
    resting_lean,
    tail_findings,
    weight_torque,
)
from aerodima.workbench.plants.tail_geometry import TailArm, TailGeometry
from aerodima.workbench.plants.tail_plate import Plate


def with_plates(**named) -> TailGeometry:
    common = {"root": (0.0, 0.0, 0.3), "lengths": (0.4,), "chords": (0.1, 0.1), "density": 0.3}
    plates = [Plate(name=name, **(common | values)) for name, values in named.items()]
    return TailGeometry("t", TailArm((0.7,), 0.06), tuple(plates))


@pytest.mark.parametrize("name", ["turn_swing", "turn_held", "turn_designed", "turn_none"])
def test_tails_that_ship_are_not_blamed(name: str) -> None:
    assert tail_findings(load_scenario(name)) == []


def test_tail_of_three_metres_falls_on_the_ground() -> None:
    (line,) = tail_findings(load_scenario("turn_swing", ["tail.length=3"]))
    assert line.startswith("the tail falls on the ground")
    heavy = " ".join(tail_findings(load_scenario("turn_swing", ["tail.length=3", "tail.mass=1"])))
    assert "the car falls over" in heavy
    assert "more than the 8.3 N m that its motor holds for long" in heavy
    assert (
        "the tail falls over: its weight takes back 22.6 N m per rad from upright, controller.hold_kp gives 17" in heavy
    )
    assert "controller.swing_speed is 8" in heavy
    heaviest = " ".join(tail_findings(load_scenario("turn_swing", ["tail.length=3", "tail.mass=1.5"])))
    assert "more than the 24.8 N m that its motor has at the most: it falls" in heaviest


def test_wide_sail_reaches_the_ground_in_its_range_of_motion() -> None:
    (line,) = tail_findings(load_scenario("turn_swing", ["tail.sail_width=0.6", "tail.sail=locked"]))
    # Rolled by 90 degrees and pitched by 90, half the width is below a mount at 0.235 m.
    assert line.startswith("the tail reaches 0.065 m below the ground within its range of motion: pitch")


def test_longer_tail_touches_before_the_car_tips() -> None:
    (line,) = tail_findings(load_scenario("turn_swing", ["tail.length=2", "tail.mass=0.05"]))
    found = re.fullmatch(
        r"sideways the tail touches the ground once the car leans (.*) deg, before it tips \(8\)", line
    )
    assert found is not None
    # The car leans about its outer wheels, half a track before the tip; the sail hangs down by half its width.
    scenario = load_scenario("turn_swing")
    height = scenario.tail.mount_height - scenario.tail.sail_width / 2
    lean = math.degrees(math.atan(height / (2.0 - scenario.car.outer_half_track)))
    assert float(found[1]) == pytest.approx(lean, abs=0.1)


def test_normal_across_the_flow_is_named() -> None:
    wrong = with_plates(sail={"normal": (1.0, 0.0, 0.0)})
    assert geometry_findings(wrong) == [
        "plate 'sail': its normal (1, 0, 0) is across the flow (0, 1, 0): air from there makes no force on it"
    ]
    assert geometry_findings(wrong, flow=(1.0, 0.0, 0.0)) == []


def test_plates_in_each_others_wake_are_named_once() -> None:
    rows = with_plates(front={"normal": (0.0, 1.0, 0.0)}, back={"normal": (0.0, 1.0, 0.0), "root": (0.0, -0.25, 0.3)})
    (line,) = geometry_findings(rows)
    assert "stand 0.25 m (2.5 chords) one behind the other" in line
    beside = with_plates(one={"normal": (0.0, 1.0, 0.0)}, two={"normal": (0.0, 1.0, 0.0), "root": (0.2, -0.25, 0.3)})
    assert geometry_findings(beside) == []


def test_sections_inside_the_body_are_counted() -> None:
    geometry = with_plates(sail={"normal": (0.0, 1.0, 0.0)})
    box = ((-0.1, -0.1, -0.1), (0.1, 0.1, 0.45))
    assert geometry_findings(geometry, body=box) == ["plate 'sail': 2 of 5 sections are inside the body"]
    assert geometry_findings(geometry, body=((-0.1, -0.1, -0.1), (0.1, 0.1, 0.3))) == []


def test_tail_inside_the_deck_is_named() -> None:
    assert overlap_findings(load_scenario("turn_swing")) == []
    low = overlap_findings(load_scenario("turn_swing", ["tail.mount_height=0.12", "tail.mount_x=0.1"]))
    assert any("mm inside the" in line for line in low)


def test_weight_and_lean_of_the_cars_tail() -> None:
    scenario = load_scenario("turn_swing")
    geometry, tail = tail_geometry(scenario.tail), scenario.tail
    rod, sail = tail.mass * (1 - tail.sail_mass_fraction), tail.mass * tail.sail_mass_fraction
    expected = 9.81 * (rod * tail.length / 2 + sail * (tail.length - tail.sail_length / 2))
    assert weight_torque(geometry, 9.81) == pytest.approx(expected)
    assert resting_lean(scenario, geometry) < math.radians(2.0)
