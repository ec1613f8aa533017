"""Inertia and air in one tail, over size and speed: the tail without air and the tail without mass are the two limits.

A tail swings by an angle Phi at a rate w while it moves through the air at U, its sail facing the wind. By inertia it
gives the body H = I w, and takes it back when it stops; by air it gives the impulse J of the moment about its hinge,
which stays. For an even strip with areal mass s and coefficient C the ratio J / H depends on three numbers alone: the
air that the tail meets over its own mass, rho C L / s; the speed ratio U / (w L); and Phi. Still air (U = 0) has
J / H = 3/8 Phi rho C L / s, fast air 1/2 Phi (rho C L / s) U / (w L).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.optimisation.studies.other_tail_systems import values_of
from aerodima.workbench.aero.laws import NormalForceLaw, facing_law
from aerodima.workbench.aero.sections import Air, SectionLayout
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.figures.figure_style import BLACK, GREY, VERMILION, new_figure, styled
from aerodima.workbench.report.report_page import Plot, Section, Table
from aerodima.workbench.resources import published_rows

SWING = math.pi / 2.0
"""Phi of the map, rad."""
RATE = 8.0
"""Rate of the tail on the left of the map, rad/s: that of the thesis' swing."""
LEVELS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Ratios J / H of the contours."""
SHARES = {"grey squirrel, 15 %": 0.15, "Minitaur's drag tail, 63 %": 0.63}
"""Published shares of the air: thesis 2.2.1 on [28]; what 37 % of the inertia leaves (Norby et al. 2021, abstract)."""
_SECTIONS, _STEPS, _GRID = 20, 12, 15


@dataclass(frozen=True)
class Tail:
    """A tail on the map.

    Attributes:
        name: whose it is.
        length: hinge to tip, m.
        start, width: of its broad part: distance from the hinge, m, and width, m.
        moment: of inertia about the hinge, kg m2.
        coefficient: C of the air's force.
        rate: of its swing, rad/s.
        airspeed: at which it moves, m/s.
        note: where the numbers are from.
    """

    name: str
    length: float
    start: float
    width: float
    moment: float
    coefficient: float
    rate: float
    airspeed: float
    note: str

    @property
    def areal_mass(self) -> float:
        """Of the even strip as long, with the same width and moment of inertia, kg/m2."""
        return 3.0 * self.moment / (self.width * self.length**3)

    @property
    def air_over_mass(self) -> float:
        """rho C L / s."""
        return Air().density * self.coefficient * self.length / self.areal_mass

    @property
    def speed_ratio(self) -> float:
        """U / (w L)."""
        return self.airspeed / (self.rate * self.length)

    @property
    def ratio(self) -> float:
        """Impulse of the air over the momentum of inertia."""
        return air_impulse(self, SWING) / (self.moment * self.rate)


def air_impulse(tail: Tail, angle: float) -> float:
    """Impulse of the air's moment about the hinge over a swing at constant rate, N m s.

    The tail points up and swings to the side (about +x) through air that comes from ahead; the force is that of the
    laws of the tail (`facing_law`), section by section.
    """
    layout = SectionLayout.strip(
        start=tail.start, length=tail.length - tail.start, width=tail.width, number=_SECTIONS, normal_B=(0.0, 1.0, 0.0)
    )
    law = facing_law(NormalForceLaw(tail.coefficient))
    total = 0.0
    for phi in (np.arange(_STEPS) + 0.5) * angle / _STEPS:
        c, s = math.cos(phi), math.sin(phi)
        pose = ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))
        a, n, u, k = layout.motion(pose, (tail.rate, 0.0, 0.0), (0.0, 0.0, 0.0), (-tail.airspeed, 0.0, 0.0))
        total -= float(law.line_force(u, k, a, n, layout.distances, layout.areas, Air().density)[3])
    return total * angle / _STEPS / tail.rate


def even_tail(length: float, airspeed: float, *, air_over_mass: float | None = None, rate: float = RATE) -> Tail:
    """An even strip: of the areal mass of the designed tail, or with a given rho C L / s."""
    like = designed_tail()
    areal = like.areal_mass if air_over_mass is None else Air().density * like.coefficient * length / air_over_mass
    width = length / 10.0
    moment = areal * width * length**3 / 3.0
    return Tail("", length, 0.0, width, moment, like.coefficient, rate, airspeed, "")


def designed_tail() -> Tail:
    """The tail of the scenario turn_designed, at its speed."""
    return _car_tail("turn_designed", "AeroDima, designed")


def known_tails() -> list[Tail]:
    """Tails whose length, width and inertia are known."""
    return [_car_tail("turn_swing", "AeroDima, as built"), designed_tail(), _cheetah(), _gecko(), _squirrel_robot()]


def _car_tail(scenario: str, name: str) -> Tail:
    found = load_scenario(scenario)
    tail = found.tail
    start = tail.length - tail.sail_length
    sail, rod = tail.sail_mass_fraction * tail.mass, (1.0 - tail.sail_mass_fraction) * tail.mass
    centre = start + tail.sail_length / 2.0
    moment = rod * tail.length**2 / 3.0 + sail * (centre**2 + tail.sail_length**2 / 12.0)
    speed = found.manoeuvre.speed
    coefficient = tail.normal_force_coefficient
    return Tail(name, tail.length, start, tail.sail_width, moment, coefficient, RATE, speed, f"scenario {scenario}")


def _cheetah() -> Tail:
    row = published_rows("tail_properties")[0]
    length, width = float(row["length_m"]), float(row["major_axis_m"])
    moment = float(row["inertia_kg_m2"])
    note = "thesis, Table 4.2, tail 1; hunting speed of section 1.1; rate as the robot's (assumed), C = 1.2 (round)"
    return Tail("cheetah", length, 0.0, width, moment, 1.2, RATE, 18.94, note)


def _gecko() -> Tail:
    v = values_of("gecko")
    length, mass = v["tail_factor"] * v["tail_length"], v["tail_factor"] * v["tail_mass"]
    rate = math.radians(v["tail_turn"]) / v["swing_time"]
    note = "models/other_tails/gecko.yaml; a cone of its mean width, in still air, C = 1.2 (round)"
    return Tail("gecko", length, 0.0, v["tail_diameter"] / 2.0, mass * length**2 / 10.0, 1.2, rate, 0.0, note)


def _squirrel_robot() -> Tail:
    v = values_of("squirrel_robot")
    length = v["tail_length"]
    moment = v["tail_rod_mass"] * length**2 / 3.0 + v["tail_tip_mass"] * length**2
    rate = abs(math.radians(v["swing_end"] - v["swing_start"])) / v["swing_time"]
    note = "models/other_tails/squirrel_robot.yaml; a rod with a tip mass, in still air, C = 1.2 (round)"
    return Tail("squirrel robot", length, 0.0, 2.0 * v["tail_radius"], moment, 1.2, rate, 0.0, note)


def map_section(tails: list[Tail]) -> Section:
    """The chapter: the map, and the numbers of the points."""
    caption = (
        "Impulse of the air over the momentum of inertia of a swing of 90 degrees. Left: even strips with the areal "
        f"mass of the designed tail, swung at {RATE:g} rad/s; the points have a mass and a rate of their own, so their "
        "numbers count and not the lines beside them. Right: every even strip at once; to the left inertia alone (no "
        "air), to the right air alone (no mass). Dashed: published shares of the air, of tails whose place on the map "
        "is not known."
    )
    plot = Plot(plot_map(tails), caption, "Ratio of air to inertia over size and speed of a tail", "other_tails_map")
    header = (
        "tail",
        "length, m",
        "airspeed, m/s",
        "rho C L / s",
        "U / (w L)",
        "air over inertia",
        "share of air",
        "from",
    )
    rows = [
        (
            tail.name,
            f"{tail.length:.3g}",
            f"{tail.airspeed:.3g}",
            f"{tail.air_over_mass:.2g}",
            f"{tail.speed_ratio:.2g}",
            f"{tail.ratio:.2g}",
            f"{100.0 * tail.ratio / (1.0 + tail.ratio):.0f} %",
            tail.note,
        )
        for tail in tails
    ]
    return Section("Inertia and air over size and speed", [plot, Table(header, rows)])


def plot_map(tails: list[Tail]) -> Figure:
    """Ratio of air to inertia: over length and airspeed, and over the two numbers on which it depends."""
    with styled():
        image, ((left, right),) = new_figure(11.0, 4.8, columns=2)
        lengths, speeds = np.geomspace(0.03, 6.0, _GRID), np.geomspace(0.3, 30.0, _GRID)
        ratios = np.array([[even_tail(size, speed).ratio for size in lengths] for speed in speeds])
        _contours(left, lengths, speeds, ratios, LEVELS)
        for tail in tails:
            label = f"{tail.name}: {tail.ratio:.2g}"
            _point(left, tail.length, max(tail.airspeed, 0.33), label)
        left.set(xlabel="length of the tail [m]", ylabel="airspeed [m/s] (still air at the lower edge)")
        numbers, relative = np.geomspace(1e-3, 30.0, _GRID), np.geomspace(0.03, 30.0, _GRID)
        ratios = np.array(
            [[even_tail(1.0, RATE * v, air_over_mass=number).ratio for number in numbers] for v in relative]
        )
        _contours(right, numbers, relative, ratios, LEVELS)
        for words, share in SHARES.items():
            level, row = share / (1.0 - share), _GRID - 3
            right.contour(numbers, relative, ratios, levels=[level], colors=VERMILION, linestyles="--")
            place = np.exp(np.interp(np.log(level), np.log(ratios[row]), np.log(numbers)))
            side, offset = ("right", -6) if level < 1.0 else ("left", 6)
            style = {"color": VERMILION, "fontsize": 8, "ha": side}
            right.annotate(words, (place, relative[row]), xytext=(offset, 3), textcoords="offset points", **style)
        for tail in tails:
            _point(right, tail.air_over_mass, max(tail.speed_ratio, 0.033), tail.name)
        right.set(xlabel="air met over own mass, ρ C L / s", ylabel="airspeed over speed of the tip, U / (ω L)")
    return image


def _contours(axes: Axes, x: np.ndarray, y: np.ndarray, ratios: np.ndarray, levels: tuple[float, ...]) -> None:
    axes.set(xscale="log", yscale="log", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    lines = axes.contour(x, y, ratios, levels=levels, colors=GREY, linewidths=1.0)
    axes.clabel(lines, fmt="%g", fontsize=8)


def _point(axes: Axes, x: float, y: float, label: str) -> None:
    axes.plot(x, y, "o", color=BLACK, markersize=5)
    axes.annotate(label, (x, y), xytext=(4, 5), textcoords="offset points", fontsize=8)
