"""Search of steering and motion on the full car itself, from where the reduced car's best counts.

It is an evolution strategy with the same number of runs for every candidate: each round drives
mutations of the best point, and the spread shrinks while nothing better is found. A point is the
steering and, for a motion of the tail, three more numbers: the share of its roll, the stretch of
its times, and how far its pitch is moved, rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np

from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.optimisation.swerve.aims import FAILED
from aerodima.optimisation.swerve.steering import (
    TRIMS,
    possible_steering,
    scaled_steering,
    steering_settings,
)
from aerodima.optimisation.swing.full_runs import (
    Descent,
    FullRun,
    drive_items,
    full_swerve,
    run_key,
)
from aerodima.optimisation.swing.solution import AIM, KNOT_ROUNDING, with_tail
from aerodima.optimisation.swing.swerve_shooting import tail_at_knots
from aerodima.workbench.car.reduced.swerves import LEVELS, STEERING
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.scenario.swing_file import (
    SwingFile,
    read_swing,
    swing_at,
    swing_from_dict,
    write_swing,
)

ROUND = 8
"""Number of mutations in a round."""
MUTATED_SHARE = 0.5
"""Probability that a number is mutated."""
SHRINK = 0.85
"""Factor on the spread after a round without anything better."""
TRIM_SPREAD = 1e-3
"""First spread of a trim, rad."""
LEVEL_SPREAD = 0.2
"""First spread of an angle, as a share of the largest of the three."""
END_SPREAD = 0.05
"""First spread of the end of a level, s."""
TAIL_SPREADS = (0.15, 0.15, 0.1)
"""First spreads of roll and times, as shares, and of the pitch, rad."""
TAIL_RANGES = ((0.0, 0.5, -0.5), (1.5, 2.0, 0.5))
"""Least and largest changes of roll and times, as shares, and of the pitch, rad."""
CURVE_SAMPLES = 1000
"""Number of instants at which the range of a motion is checked."""
NO_CHANGE = (1.0, 1.0, 0.0)
"""Change that leaves a motion as it is: all of its roll, its own times, its own pitch."""


@dataclass
class FullSearch:
    """Search of one candidate on its full car.

    Attributes:
        descent: descent that the search starts from; better runs replace its best one.
        swing: motion that is varied; None for steering alone.
        point: best point so far: steering, then the numbers of the motion if there is one.
        spread: standard deviation of the mutations of each number.
    """

    descent: Descent
    swing: SwingFile | None
    point: FloatArray
    spread: FloatArray

    @classmethod
    def from_descent(cls, descent: Descent, share: float) -> FullSearch:
        """Makes the search that starts at a descent's steering, its angles times a share."""
        found = np.array(descent.result["steering"])
        steering = scaled_steering(found, share, descent.max_angle)
        largest = np.max(np.abs(steering[:LEVELS]))
        spreads = [LEVEL_SPREAD * largest] * LEVELS + [END_SPREAD] * (STEERING - LEVELS)
        spread = np.array([*spreads, TRIM_SPREAD][: len(steering)])
        if descent.motion is None:
            return cls(descent, None, steering, spread)
        point = np.concatenate([steering, NO_CHANGE])
        return cls(descent, read_swing(descent.motion), point, np.append(spread, TAIL_SPREADS))

    @property
    def steering_size(self) -> int:
        """Number of a point's entries that are the steering, with the trim if there is one."""
        return len(self.descent.result["steering"])

    def mutations(self, generator: np.random.Generator, limit: float) -> FloatArray:
        """Draws possible points (`ROUND`, numbers) with angles up to a limit, rad."""
        shape = (ROUND, self.point.size)
        drawn = generator.standard_normal(shape) * (generator.random(shape) < MUTATED_SHARE)
        points = possible_steering(self.point + self.spread * drawn, limit)
        _, trim, tail = np.split(points, [STEERING, self.steering_size], axis=1)
        np.clip(trim, *TRIMS, out=trim)
        if self.swing is not None:
            np.clip(tail, *TAIL_RANGES, out=tail)
        return points

    def run(self, point: FloatArray, path: Path) -> FullRun:
        """Returns the full run of a point; a varied motion is written to `path`. A trim is scaled
        with the share of the roll, since it counters the roll at which the tail waits.
        """
        settings = self.descent.settings
        steering, change = np.split(point, [self.steering_size])
        if self.swing is None:
            return self.descent.run_with((*settings, *steering_settings(steering)))
        driver = steering_settings(
            np.append(steering[:STEERING], np.clip(change[0] * steering[STEERING:], *TRIMS))
        )
        write_swing(varied_swing(self.swing, change, driver), path, force=True)
        return self.descent.run_with((*settings, f"controller.swing_file={path}", *driver))


def follow_leaders(searches: Sequence[FullSearch], runs: CachedRunner) -> None:
    """Moves the start of a motion to the best full run with a tail in its case, if that is another:
    to its steering and to what its tail did. The search of a bound thus goes on where the best law
    ends. A search whose turn is announced neither leads nor follows.
    """
    runs.stage = "motions of full runs"
    tailed = [one for one in searches if one.descent.has_tail and one.steering_size == STEERING]
    best = {one.descent.stem: one for one in sorted(tailed, key=lambda one: one.descent.value)}
    led = [one for one in tailed if one.swing and best[one.descent.stem] is not one]
    leaders = [best[one.descent.stem] for one in led]
    driven = [one.run(one.point, Path()) for one in leaders]
    tails = runs.map(driven_tail, driven, [f"tail of {run_key(run)}" for run in driven])
    for one, leader, tail in zip(led, leaders, tails, strict=True):
        assert one.swing is not None
        one.swing = with_tail(one.swing, np.array(tail))
        one.point = np.concatenate([leader.point, NO_CHANGE])


def driven_tail(run: FullRun) -> list[float]:
    """Returns pitch and rolls of the tail of a full run, see `tail_at_knots`."""
    return [*map(float, tail_at_knots(full_swerve(run)))]


def varied_swing(swing: SwingFile, change: FloatArray, steering: Sequence[str]) -> SwingFile:
    """Returns a solution with a change (3,): its roll times a share, as far as its range allows,
    its times stretched, and its pitch moved. Another steering replaces that at the end of its
    settings, and of what was found only the aim is kept.
    """
    share, stretch, pitch = map(float, change)
    times = np.linspace(0.0, swing.knots.time_s[-1], CURVE_SAMPLES)
    reach = float(np.max(np.abs(swing_at(swing, times).roll_position)))
    most = swing.limits.roll_position_rad - KNOT_ROUNDING
    share = min(share, max(1.0, most / max(reach, 1e-9)))
    data = swing.plain()
    knots = data["knots"]
    limits = data["limits"]
    provenance = data["provenance"]
    found = provenance["found"]
    provenance["found"] = {key: found[key] for key in found if key == AIM}
    provenance["settings"][-len(steering) :] = steering
    rates = np.array(knots["roll_velocity_rad_per_s"]) * share / stretch
    knots["time_s"] = [stretch * time for time in knots["time_s"]]
    knots["roll_position_rad"] = [share * roll for roll in knots["roll_position_rad"]]
    knots["roll_velocity_rad_per_s"] = rates.tolist()
    knots["pitch_position_rad"] = [pitch + angle for angle in knots["pitch_position_rad"]]
    limits["velocity_rad_per_s"] = max(limits["velocity_rad_per_s"], float(np.max(np.abs(rates))))
    return swing_from_dict(data, swing.name)


def search_full(
    descents: Sequence[Descent], number: int, runs: CachedRunner, folder: Path, seed: int
) -> None:
    """Searches on the full cars of descents; a better run becomes the best run of its descent.

    Args:
        descents: descents with their full runs; one whose reduced car has no swerve that counts is
            left out.
        number: number of full runs for each descent, rounded down to whole rounds of `ROUND`.
        runs: runner of the full runs.
        folder: folder of the varied motions.
        seed: seed of the mutations; each case, speed and aim has its own random stream, which its
            candidates share.
    """
    folder.mkdir(parents=True, exist_ok=True)
    searches = []
    for descent in descents:
        if descent.result["score"] > FAILED:
            share = descent.best[0] if descent.best else 1.0
            searches.append(FullSearch.from_descent(descent, share))
    follow_leaders(searches, runs)
    runs.stage = "search on full cars"
    for index in range(number // ROUND):
        items = []
        points = []
        for search in searches:
            generator = np.random.default_rng([seed, index, crc32(search.descent.stem.encode())])
            drawn = search.mutations(generator, search.descent.max_angle)
            if index == 0 and search.swing:
                drawn[0] = search.point
            points += [*drawn]
            for member, point in enumerate(drawn):
                name = search.descent.motion.stem if search.descent.motion else ""
                path = folder.resolve() / f"{name}_{index}_{member}.yaml"
                items.append(search.run(point, path))
        rows = drive_items(items, runs)
        for place, search in enumerate(searches):
            of_round = slice(ROUND * place, ROUND * (place + 1))
            better = search.descent.improve(items[of_round], rows[of_round])
            if better is None:
                search.spread = SHRINK * search.spread
            else:
                search.point = points[of_round][better]
