"""Paths that a driver follows: centre line, lane edges, and how far a car is outside of its lane.

No Drake.

Plane geometry in the world frame W, lengths in m, headings in rad, positive to the left. A path
begins along x at y = 0, where the car begins. Stations are lengths along it. Every function takes
numbers or arrays of one shape.
"""

import itertools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from aerodima.workbench.control.manoeuvre import side_of
from aerodima.workbench.core.array_types import ArrayPair, FloatArray
from aerodima.workbench.core.errors import UserError

SCALE = 0.1
"""Length of the model over that of the full-size car."""
LENGTHS = (12.0, 13.5, 11.0, 12.5, 12.0)
"""Lengths of the five sections of ISO 3888-2, m at full size: lane, change, lane, change, lane."""
OFFSET = 1.0
"""Lateral offset between the lanes of ISO 3888-2, edge to edge, m at full size."""
WIDTHS = ((1.1, 0.25, 0.0), (1.0, 1.0, 0.0), (1.3, 0.25, 3.0))
"""Widths of its three lanes at full size: share of the vehicle's width, m on top of it, least m."""
ENTRY = 1.2
"""Length of the straight lane before and after a corner, m: as the first lane of ISO 3888-2 at
1:10."""
OUTLINE = 41
"""Number of points along each edge of a car's footprint; they are 7 mm apart."""


class Lane(NamedTuple):
    """A straight lane between cones, m: `start` to `end` along x, `right` to `left` along y."""

    start: float
    end: float
    right: float
    left: float

    @property
    def centre(self) -> float:
        """Returns the y of the middle of the lane, m."""
        return 0.5 * (self.right + self.left)


@dataclass(frozen=True)
class LaneChange:
    """Severe lane change of ISO 3888-2:2011 (obstacle avoidance) at 1:10; there are no cones
    between the lanes.

    The centre line joins the middles of the lanes by half a wave of a cosine over the whole change.
    Stations are x.

    Args:
        vehicle_width: width of the car over the tyres, m.
        begin: x of the first cones, m.
        side: side to which the first change goes, +1 left, -1 right.
    """

    vehicle_width: float
    begin: float
    side: float

    @property
    def lanes(self) -> tuple[Lane, Lane, Lane]:
        """Returns the three lanes if the first change goes to the left; mirrored otherwise."""
        ends = [self.begin + SCALE * sum(LENGTHS[:count]) for count in range(len(LENGTHS) + 1)]
        first, middle, last = (
            np.maximum(share * self.vehicle_width + SCALE * more, SCALE * least)
            for share, more, least in WIDTHS
        )
        edge = 0.5 * first
        beyond = edge + SCALE * OFFSET
        return (
            Lane(ends[0], ends[1], -edge, edge),
            Lane(ends[2], ends[3], beyond, beyond + middle),
            Lane(ends[4], ends[5], edge - last, edge),
        )

    @property
    def end(self) -> float:
        """Returns the station at which the last lane ends; the centre line goes straight on."""
        return self.lanes[-1].end

    def station(self, x: Any, y: Any) -> Any:
        """Returns the station of the centre line beside a point."""
        del y
        return x

    def centre(self, station: Any) -> tuple[Any, Any]:
        """Returns the place (x, y) of the centre line."""
        y = 0.0
        lanes = self.lanes
        for before, after in itertools.pairwise(lanes):
            share = np.clip((station - before.end) / (after.start - before.end), 0.0, 1.0)
            y = y + (after.centre - before.centre) * 0.5 * (1.0 - np.cos(math.pi * share))
        return station, self.side * y

    def outside(self, x: Any, y: Any) -> Any:
        """Returns how far a point is beyond the nearer edge of the lane, negative inside, -inf
        where there are no cones.
        """
        y = self.side * y
        beyond: Any = -np.inf
        for lane in self.lanes:
            beside = (x >= lane.start) & (x <= lane.end)
            beyond = np.where(beside, np.maximum(y - lane.left, lane.right - y), beyond)
        return beyond

    def next_side(self, station: float) -> float:
        """Returns the side of the next change, +1 left, -1 right; from the middle lane on that is
        the second one.
        """
        return self.side if station < self.lanes[1].start else -self.side


@dataclass(frozen=True)
class Corner:
    """A right-angled corner of constant width between two straight lanes.

    Args:
        radius: radius of the centre line, m, above half of the width.
        width: width of the lane, m.
        begin: x of the first cones, `ENTRY` before the bend, m.
        side: side of the corner, +1 left, -1 right.
    """

    radius: float
    width: float
    begin: float
    side: float

    @property
    def bend(self) -> float:
        """Returns the station at which the bend begins."""
        return self.begin + ENTRY

    @property
    def end(self) -> float:
        """Returns the station at which the last lane ends; the centre line goes straight on."""
        return self.bend + 0.5 * math.pi * self.radius + ENTRY

    def station(self, x: Any, y: Any) -> Any:
        """Returns the station of the centre line beside a point."""
        along = x - self.bend
        left = self.radius - self.side * y
        angle = np.arctan(np.maximum(along, 0.0) / np.maximum(left, 1e-9))
        straight = np.minimum(along, 0.0) + np.where(along > 0.0, np.maximum(-left, 0.0), 0.0)
        return self.bend + self.radius * angle + straight

    def centre(self, station: Any) -> tuple[Any, Any]:
        """Returns the place (x, y) of the centre line."""
        length = 0.5 * math.pi * self.radius
        angle = np.clip(station - self.bend, 0.0, length) / self.radius
        after = np.maximum(station - self.bend - length, 0.0)
        x = np.minimum(station, self.bend) + self.radius * np.sin(angle)
        return x, self.side * (self.radius * (1.0 - np.cos(angle)) + after)

    def outside(self, x: Any, y: Any) -> Any:
        """Returns how far a point is beyond the nearer edge of the lane, negative inside, -inf
        before the first and beyond the last cones.
        """
        station = self.station(x, y)
        x_centre, y_centre = self.centre(station)
        beyond = np.sqrt((x - x_centre) ** 2 + (y - y_centre) ** 2) - 0.5 * self.width
        return np.where((station >= self.begin) & (station <= self.end), beyond, -np.inf)

    def next_side(self, station: float) -> float:
        """Returns the side of the corner: +1 left, -1 right."""
        del station
        return self.side


Path = LaneChange | Corner
"""A lane to follow."""


def path_of(scenario: Any) -> Path:
    """Returns the path of `scenario.manoeuvre`; its first cones stand where the car is at
    `turn_start` (design section 10).
    """
    manoeuvre = scenario.manoeuvre
    car = scenario.car
    side = side_of(manoeuvre)
    ramped = 0.0 if manoeuvre.rolling_start else 0.5 * manoeuvre.speed_ramp
    begin = manoeuvre.speed * (manoeuvre.turn_start - ramped)
    if manoeuvre.path == "corner":
        return Corner(manoeuvre.corner_radius, manoeuvre.corner_width, begin, side)
    return LaneChange(car.track + car.tyre_width, begin, side)


def place_outline(
    outline: FloatArray, x: float | FloatArray, y: float | FloatArray, heading: float | FloatArray
) -> ArrayPair:
    """Returns x and y in W of corners in B (2, corners, ...), m, of a car whose origin of B is at x
    and y, m, with a heading, rad.
    """
    ahead, left = outline
    cosine = np.cos(heading)
    sine = np.sin(heading)
    return x + cosine * ahead - sine * left, y + sine * ahead + cosine * left


def off_path(
    path: Path,
    x: FloatArray,
    y: FloatArray,
    heading: FloatArray,
    half_width: float,
    wheelbase: float,
) -> FloatArray:
    """Returns how far the car is outside of its lane, m; negative inside, -inf where no part of it
    is beside cones.

    The car's footprint is a rectangle from the rear to the front axle. Points along its whole
    outline count, not the corners alone: a car that leaves a lane at an angle meets the last cone
    with its side.

    Args:
        path: path that the car follows.
        x, y: point on the ground under the middle of the rear axle, shape (n,), m.
        heading: heading of the car, shape (n,), rad.
        half_width: half the width over the tyres, (track + tyre width) / 2, m.
        wheelbase: wheelbase of the car, m.

    Returns:
        The distance outside of the lane, shape (n,).

    Raises:
        UserError: a place or heading is not finite, or their shapes differ.
    """
    for name, values in {"x": x, "y": y, "heading": heading}.items():
        if values.shape != x.shape or not np.isfinite(values).all():
            raise UserError(
                f"off_path: {name}: shape {values.shape}; must be finite numbers of the shape "
                f"{x.shape} of x"
            )
    share = np.linspace(0.0, 1.0, OUTLINE)
    one = np.ones(OUTLINE)
    ahead = wheelbase * np.concatenate([share, share, 0.0 * one, one])[:, None]
    across = half_width * np.concatenate([one, -one, 2.0 * share - 1.0, 2.0 * share - 1.0])[:, None]
    placed = place_outline(np.array([ahead, across]), x, y, heading)
    return np.maximum.reduce(path.outside(*placed))
