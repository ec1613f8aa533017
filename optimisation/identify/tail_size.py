"""The size of the robot's sail from its swings in the tunnel: thesis section 6.3, Tables 6.3 and 11.3-11.7.

The tables print, per wind and gain, the relative speeds (in steps of 1 m/s) at which drag coefficients were set: the
range that the tail passed through. Possible tails are drawn from a prior, swung (`tail_swings`) and weighted by how
well their extreme speeds and their rest fit (importance sampling). All five swings of a table share one range, so they
count once; Table 11.3 repeats 11.6 and does not count (ERRATA E24): five ranges of 25 swings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.special import ndtr
from scipy.stats import qmc

from aerodima.optimisation.identify.published_tables import robot_tail_rows
from aerodima.optimisation.identify.tail_swings import SwingExtremes, Tails, cover, lever, swing_extremes
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import RigScenario, load_rig_scenario
from aerodima.workbench.config.scenario_file import ParameterEntry, load_parameter_file
from aerodima.workbench.errors import FitError
from aerodima.workbench.resources import model_path

PRIOR_FILE = "identification/tail_size.yaml"
SETTINGS = ("least_cover", "speed_scatter", "rest_scatter")
"""Keys of the file that belong to the likelihood; the others are drawn."""
READINGS = {"nodes": (0.0, -1.0), "nearest": (-0.5, -0.5), "floor": (0.0, 0.0)}
"""How a row of speed B may be meant: where the intervals of 1 m/s of the lowest and of the highest row start, from B.

`nodes` of a lookup table that just hold the range, the `nearest` whole number, or whole numbers cut off.
"""
_LOGARITHMIC = 4.0
_CHUNK = 4096
LOWEST_CHANCE = 1e-12
"""Of a range under a tail: what no tail can explain must not rule all out."""


@dataclass(frozen=True)
class SwingRange:
    """Extreme relative speeds of the swings of one table.

    Attributes:
        wind: m/s.
        kp: as printed.
        lowest, highest: lowest and highest row, m/s.
        rest: angle at which the tail came to rest, rad; None where nothing is held to it.
        table: where it is printed.
    """

    wind: float
    kp: float
    lowest: float
    highest: float
    rest: float | None = None
    table: str = ""


def published_ranges() -> list[SwingRange]:
    """The five distinct ranges; the commanded rest (0) is held where most wind meets the least gain."""
    rows = robot_tail_rows()
    columns = ["wind_speed_m_per_s", "kp", "source_table"]
    cells = rows.groupby(columns, sort=False, as_index=False).relative_velocity_m_per_s.agg(["min", "max"])
    found = [
        SwingRange(float(wind), float(kp), float(low), float(high), table=str(table))
        for wind, kp, table, low, high in cells.to_numpy(object)
    ]
    hardest = max(found, key=lambda one: (one.wind, -one.kp))
    return [replace(one, rest=0.0) if one is hardest else one for one in found]


@cache
def prior() -> dict[str, ParameterEntry]:
    """The prior of a tail in the tunnel, and the settings of the likelihood."""
    return load_parameter_file(model_path(PRIOR_FILE))


def drawn_names() -> list[str]:
    """What is drawn: the parameters of the prior but its settings."""
    return [name for name in prior() if name not in SETTINGS]


def scaled(name: str, values: FloatArray) -> FloatArray:
    """Values of a parameter as the part of its prior below them, 0 to 1."""
    low, high = _ends(name)
    if _is_logarithmic(low, high):
        return np.asarray(np.log(values / low) / np.log(high / low))
    return np.asarray((values - low) / (high - low))


def draw_tails(number: int, seed: int, scenario: RigScenario) -> dict[str, FloatArray]:
    """Tails from the prior: a scrambled Sobol sequence, without those that the jet hardly covers at the start.

    Args:
        number: of points, a power of two.
        seed: of the scrambling.
        scenario: of the rig; its jet's slope counts.

    Returns:
        Column -> value (n): what is drawn, `law` (0, 1; see `Tails`) and `reading` (number in `READINGS`).
    """
    names = drawn_names()
    points = qmc.Sobol(len(names) + 2, seed=seed).random_base2(max(number - 1, 1).bit_length())
    tails = {}
    for name, u in zip(names, points.T, strict=False):
        low, high = _ends(name)
        tails[name] = low * (high / low) ** u if _is_logarithmic(low, high) else low + (high - low) * u
    tails["law"] = np.floor(2 * points[:, -2])
    tails["reading"] = np.floor(len(READINGS) * points[:, -1])
    kept = tails["sail_length"] < tails["length"]
    kept &= cover(tails, tails["start_angle"], scenario.tunnel.jet_slope) >= float(prior()["least_cover"].value)
    return {name: values[kept] for name, values in tails.items()}


@dataclass(frozen=True)
class TailPosterior:
    """Tails with their weights.

    Attributes:
        ranges: what they are held to.
        tails: column -> value (n).
        extremes: per range, of each tail.
        log_likelihood: of each tail (n).
    """

    ranges: tuple[SwingRange, ...]
    tails: Tails
    extremes: tuple[SwingExtremes, ...]
    log_likelihood: FloatArray

    @property
    def weights(self) -> FloatArray:
        """Of the tails (n), with the sum 1."""
        weights: FloatArray = np.exp(self.log_likelihood - self.log_likelihood.max())
        return weights / weights.sum()

    @property
    def effective_samples(self) -> float:
        """Effective sample size of the weights."""
        return float(1.0 / np.sum(self.weights**2))

    def moment(self, power: int) -> FloatArray:
        """C_D A L_cor^power with C_D 2 (n): m^(2 + power)."""
        return np.asarray(2.0 * self.tails["area"] * lever(self.tails) ** power)

    def quantiles(self, values: FloatArray, parts: Sequence[float], kept: FloatArray | None = None) -> FloatArray:
        """Of values of the tails (n); `kept` multiplies the weights."""
        weights = self.weights if kept is None else self.weights * kept
        order = np.argsort(values)
        below = np.cumsum(weights[order])
        return np.asarray(values[order][np.searchsorted(below, np.asarray(parts) * below[-1])])

    def area_likelihood(self, area: float, kept: FloatArray | None = None) -> float:
        """Likelihood of an area, the rest of the tail drawn from the prior, over that of the most likely area.

        Areas within a quarter octave count as the same; `kept` weighs the tails of the prior.
        """
        octaves = np.log2(self.tails["area"])
        centres = np.append(np.log2(area), np.arange(octaves.min() + 0.25, octaves.max(), 0.5))
        share = np.ones_like(octaves) if kept is None else kept
        weights = self.weights * share
        cells = [np.abs(octaves - centre) < 0.25 for centre in centres]
        chances = [np.sum(weights[cell]) / np.sum(share[cell]) for cell in cells]
        return float(chances[0] / max(chances))


def find_tails(
    ranges: Sequence[SwingRange],
    number: int = 2**16,
    seed: int = 1,
    *,
    lowest: bool = False,
    rest: bool = True,
    scenario: RigScenario | None = None,
    progress: Callable[[int], None] | None = None,
) -> TailPosterior:
    """Posterior of the tail.

    Args:
        ranges: what was measured.
        number: tails drawn, a power of two.
        seed: of the draw.
        lowest: hold the lowest speeds too. They come from the rebound, or from the way to the start, which is not told.
        rest: hold the rest angles.
        scenario: of the rig; `robot` by default.
        progress: called with how many tails more were swung.

    Raises:
        FitError: no range.
    """
    if not ranges:
        raise FitError("tail size: no ranges of speeds were given")
    scenario = scenario or load_rig_scenario("robot")
    tails = draw_tails(number, seed, scenario)
    parts: list[list[SwingExtremes]] = [[] for _ in ranges]
    for start in range(0, len(tails["area"]), _CHUNK):
        chunk = {name: values[start : start + _CHUNK] for name, values in tails.items()}
        for one, found in zip(ranges, parts, strict=True):
            found.append(swing_extremes(chunk, one.wind, one.kp, scenario))
        if progress is not None:
            progress(len(chunk["area"]))
    extremes = tuple(SwingExtremes.joined(found) for found in parts)
    return weigh(ranges, tails, extremes, lowest=lowest, rest=rest)


def weigh(
    ranges: Sequence[SwingRange],
    tails: Tails,
    extremes: Sequence[SwingExtremes],
    *,
    lowest: bool = False,
    rest: bool = True,
) -> TailPosterior:
    """The posterior of tails that were swung already; see `find_tails`."""
    starts = np.array(list(READINGS.values()))[tails["reading"].astype(int)]
    scatter, still = (float(prior()[name].value) for name in ("speed_scatter", "rest_scatter"))
    total = np.zeros(len(tails["area"]))
    for one, found in zip(ranges, extremes, strict=True):
        total += _log_chance(found.highest, one.highest + starts[:, 1], scatter)
        if lowest:
            total += _log_chance(found.lowest, one.lowest + starts[:, 0], scatter)
        if rest and one.rest is not None:
            total += -0.5 * ((found.rest - one.rest) / still) ** 2
    return TailPosterior(tuple(ranges), tails, tuple(extremes), total)


def _log_chance(speed: FloatArray, start: FloatArray, scatter: float) -> FloatArray:
    """That a speed with a normal scatter lies in the interval of 1 m/s from `start`."""
    below, above = (start - speed) / scatter, (start + 1.0 - speed) / scatter
    return np.asarray(np.log(np.maximum(ndtr(above) - ndtr(below), LOWEST_CHANCE)))


def _ends(name: str) -> tuple[float, float]:
    ends = prior()[name].prior
    assert ends is not None
    return ends


def _is_logarithmic(low: float, high: float) -> bool:
    return low > 0.0 and high / low >= _LOGARITHMIC
