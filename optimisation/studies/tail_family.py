"""Tails with their laws: size, areal mass and mount of a tail are looked for together with the numbers of its law.

A candidate is a straight rod with one rectangular sail that faces the wind. What a tail of these numbers cannot be is
mended before it is looked at (a sail that begins at the wheels, an edge in the ground, a mass beyond the budget); what
else is wrong with it, `aerodima models tail` would say (`tail_findings`), and such a tail is not driven.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.optimisation.studies.contestants import Contestant, raised_gearbox
from aerodima.optimisation.studies.law_training import TRAINED, LawFamily
from aerodima.optimisation.sweep.study_engine import RememberingEngine, scenario_content
from aerodima.optimisation.swing.tail_design import design_numbers, straight_tail, swing_demand
from aerodima.workbench.batch.row_store import content_key
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.controllers.swing_law import SwingSettings
from aerodima.workbench.errors import ModelError, SweepError
from aerodima.workbench.plants.tail import tail_geometry
from aerodima.workbench.plants.tail_findings import overlap_findings, tail_findings

AREAL = "areal_mass"
"""kg/m2 of the sail's planform; a law has mass and share of the sail in its place."""
SIZES = {
    "tail.length": (0.4, 1.3),
    "tail.sail_length": (0.05, 1.0),
    "tail.sail_width": (0.02, 0.4),
    AREAL: (0.65, 3.0),
    "tail.mount_x": (-0.10, 0.26),
    "tail.mount_height": (0.16, 0.30),
}
"""Ranges, m; the lightest sail is of the lightest film, board and rings of `models/design/tail.yaml`, the heaviest is
ballast; the mount between the board and the front axle, at the heights of its prior."""
WHEEL_GAP, GROUND_GAP = 0.02, 0.02
"""Least distance of the sail from the outside of the wheels, and of its edge from the ground when it lies level, m."""
NO_MODEL = 10.0
"""How far beyond what is allowed a car is that cannot be built at all."""


@dataclass(frozen=True)
class TailFamily(LawFamily):
    """Tails with their laws on the car of a scenario.

    Attributes:
        scenario: whose car says what a tail may be.
        budget: most mass of rod and sail: of all beyond the roll motor's output, kg.
        first: laws that the search begins with, beside the published one on the tail of `turn_designed`.

    Raises:
        SweepError: a budget below the lightest tail.
    """

    scenario: str = "turn_fast"
    budget: float = math.inf
    first: tuple[Mapping[str, float], ...] = field(default=(), hash=False)

    def __post_init__(self) -> None:
        ends = {name: low for name, (low, _) in self.ranges.items()}
        lightest = self._rod_density * ends["tail.length"] + self._least_sail
        if not self.budget >= lightest:
            raise SweepError(
                f"budget {self.budget:g} kg: the lightest tail of these ranges, {ends['tail.length']:g} m with a sail "
                f"of {ends['tail.sail_length']:g} x {ends['tail.sail_width']:g} m, weighs {lightest:.3f} kg; allowed: "
                "that and more"
            )

    @property
    def _rod_density(self) -> float:
        numbers = design_numbers()
        return (1.0 + numbers["fixings"]) * numbers["rod_density"]

    @property
    def _least_sail(self) -> float:
        return math.prod(self.ranges[name][0] for name in ("tail.sail_length", "tail.sail_width", AREAL))

    def laws(self, shares: FloatArray) -> list[dict[str, float]]:
        """As `LawFamily.laws`, each mended to what a tail of its budget can be."""
        wheels = load_scenario(self.scenario).car.outer_half_track
        return [self._mended(law, wheels + WHEEL_GAP) for law in super().laws(shares)]

    def _mended(self, law: dict[str, float], inner_end: float) -> dict[str, float]:
        areal, lowest = law.pop(AREAL), self.ranges[AREAL][0]
        length = min(law["tail.length"], (self.budget - self._least_sail) / self._rod_density)
        sail = max(min(law["tail.sail_length"], length - inner_end), self.ranges["tail.sail_length"][0])
        width = min(law["tail.sail_width"], 2.0 * (law["tail.mount_height"] - GROUND_GAP))
        room = self.budget - self._rod_density * length
        areal = max(min(areal, room / (sail * width)), lowest)
        shrink = min(1.0, math.sqrt(room / (areal * sail * width)))
        sail, width, length = (math.floor(1e4 * value) / 1e4 for value in (shrink * sail, shrink * width, length))
        geometry = straight_tail("candidate", length, sail, width, areal, self._rod_density)
        mass = geometry.inertial.mass
        return law | {
            "tail.length": length,
            "tail.sail_length": sail,
            "tail.sail_width": width,
            "tail.mass": float(f"{mass:.6f}"),
            "tail.sail_mass_fraction": float(f"{geometry.sail_mass.mass / mass:.6f}"),
        }

    def shares(self, law: Mapping[str, float]) -> FloatArray:
        """As `LawFamily.shares`."""
        return super().shares({**law, AREAL: areal_mass(law)})

    @property
    def starts(self) -> Sequence[Mapping[str, float]]:
        """As `LawFamily.starts`."""
        designed, published = load_scenario("turn_designed").tail, SwingSettings.published()
        sizes = (*(name for name in self.ranges if name.startswith("tail.")), "tail.mass", "tail.sail_mass_fraction")
        tail = {name: float(getattr(designed, name.partition(".")[2])) for name in sizes}
        return [*self.first, tail | {name: float(getattr(published, name)) for name in TRAINED.ranges}]

    def settings(self, law: Mapping[str, float]) -> tuple[str, ...]:
        """As `LawFamily.settings`, without the mount's height, with which the gearbox moves (`contender`)."""
        return self._own_settings({name: value for name, value in law.items() if name != "tail.mount_height"})

    def contender(self, name: str, law: Mapping[str, float]) -> Contestant:
        """One tail with its law as a contestant."""
        raised = partial(raised_gearbox, mount_height=law["tail.mount_height"])
        return Contestant(name, self.settings(law), ballast=raised)

    def beyond(self, laws: Sequence[Mapping[str, float]], engine: RememberingEngine) -> FloatArray:
        """As `LawFamily.beyond`: a whole for each finding, and the share by which its motor works too hard."""
        items = [(self.scenario, self.settings(law), law["tail.mount_height"]) for law in laws]
        content = scenario_content(self.scenario)
        found = engine.call_once(_beyond, items, [content_key("tail limits", *item, content) for item in items])
        return np.array(found, float)


def family_of(name: str, scenario: str, budget: float = math.inf) -> TailFamily:
    """All tails of `SIZES` with all laws of `TRAINED`.

    Raises:
        SweepError: a budget below the lightest tail.
    """
    fixed = (*TRAINED.fixed, "tail.sail=facing", "tail.geometry=none", "tail.name=co-designed")
    return TailFamily(name, {**SIZES, **TRAINED.ranges}, fixed, scenario, budget)


def read_tails(folder: Path) -> list[dict[str, float]]:
    """Tails with their laws of `finalists.csv` in the folder of an earlier search.

    Raises:
        SweepError: there is none, or a number is missing.
    """
    path, names = folder / "finalists.csv", [*SIZES, *TRAINED.ranges, "tail.mass", "tail.sail_mass_fraction"]
    names.remove(AREAL)
    try:
        table = pd.read_csv(path)[names].astype(float)
    except (OSError, ValueError, KeyError) as error:
        raise SweepError(f"{path}: {error}; allowed: the folder of an earlier `aerodima optimise tail`") from None
    if not np.isfinite(table.to_numpy()).all():
        raise SweepError(f"{path}: a number is missing; allowed: the folder of an earlier `aerodima optimise tail`")
    return [{str(name): float(value) for name, value in row.items()} for row in table.to_dict("records")]


def areal_mass(law: Mapping[str, float]) -> float:
    """Of the sail, kg/m2 of its planform."""
    return law["tail.mass"] * law["tail.sail_mass_fraction"] / (law["tail.sail_length"] * law["tail.sail_width"])


def scenario_with(scenario: str, settings: Sequence[str], mount_height: float) -> Scenario:
    """A scenario with these settings, its gearbox moved with the mount."""
    plain = load_scenario(scenario, settings)
    return load_scenario(scenario, (*settings, *raised_gearbox(plain, mount_height)))


def limits_broken(scenario: Scenario) -> list[str]:
    """What forbids the tail of a scenario: findings about ground, motors and range of motion, torque over a cycle.

    Raises:
        ModelError: the car cannot be built.
    """
    demand, limits = swing_demand(scenario, tail_geometry(scenario.tail)), design_numbers()
    found = tail_findings(scenario)
    if demand.rms_torque > limits["rated_torque"]:
        found.append(f"over a cycle it asks {demand.rms_torque:.3g} N m, the motor bears {limits['rated_torque']:.3g}")
    if demand.overload > limits["overload"] * limits["overload_share"]:
        found.append(f"a swing overloads its motor: {demand.overload:.4g} of {limits['overload']:.4g} N2 m2 s")
    return found + overlap_findings(scenario)


def _beyond(item: tuple[str, tuple[str, ...], float]) -> float:
    try:
        scenario = scenario_with(*item)
        worked = swing_demand(scenario, tail_geometry(scenario.tail)).rms_torque / design_numbers()["rated_torque"]
        return len(limits_broken(scenario)) + max(worked - 1.0, 0.0)
    except ModelError:
        return NO_MODEL
