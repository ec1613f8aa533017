"""What a held reading is beyond the drift of its sensor, and what is added to it without a rest phase.

Drift, and a step where the wind begins, go through all samples of rest and hold together, because the hold helps to
find the drift too. Without a rest the offset is what the log or the scenario states, with how far wrong it may be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydrake.math import cos, sin

from aerodima.optimisation.identify.least_squares import LIMIT, spread
from aerodima.optimisation.identify.residual_noise import (
    CHANCE,
    FAR_OFF,
    FEW_FAR_OFF,
    ResidualCheck,
    chance_of,
    check_residual,
    correlation_time,
)
from aerodima.workbench.aero.laws import float_of
from aerodima.workbench.aero.polar_law import PolarLaw
from aerodima.workbench.aero.sections import Jet, SectionLayout
from aerodima.workbench.config.rig_scenario import RigScenario
from aerodima.workbench.errors import FitError
from aerodima.workbench.logs.conditioning import OFFSETS
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.plants.rig_model import bar_layout, pivot_position, tail_layout

Vector3 = tuple[float, float, float]
REACTIONS = ("fx", "fy", "fz", "tx", "ty", "tz")
UPRIGHT_MARGIN = math.radians(0.5)
"""A tail that hangs straight within this has its lift to the root, on whichever side of 0 an encoder reads it."""

_DRAG = PolarLaw(1.0, 0.0)
_LIFT = PolarLaw(0.0, 1.0, lift_blend=0.0)


@dataclass(frozen=True)
class StaticBalance:
    """A held rig.

    Attributes:
        scenario: masses, places, air.
        pivot: p_WP (3), m.
        tail, bar: sections, each in its own frame with the axis hanging down.
    """

    scenario: RigScenario
    pivot: Vector3
    tail: SectionLayout
    bar: SectionLayout

    @classmethod
    def of(cls, scenario: RigScenario) -> StaticBalance:
        """The balance of a scenario with a cheetah tail."""
        if not scenario.has_cheetah_tail:
            raise FitError(f"static fit: experiment {scenario.experiment.kind!r} has no cheetah tail on the rig")
        x, y, z = pivot_position(scenario.mount).tolist()
        return cls(scenario, (x, y, z), tail_layout(scenario), bar_layout(scenario))

    @property
    def torque_constant(self) -> float:
        """Of the motor at the bar, N m/A."""
        return self.scenario.maxon.torque_constant

    @property
    def creep_resistance(self) -> float:
        """Torque per speed at rest, N m s/rad: viscous friction + tanh gain x Coulomb friction."""
        friction = self.scenario.friction
        return friction.viscous + friction.tanh_gain * friction.coulomb

    @property
    def root_distance(self) -> float:
        """From the pivot to the root of the tail, m."""
        return self.scenario.bar.tail_distance + self.scenario.cheetah_tail.gap

    def tail_axis(self, angle: float) -> Vector3:
        """Unit vector from root to tip in W (3): that of the bar and the misalignment."""
        return hanging_axis(angle + self.scenario.tunnel.misalignment)

    def jet(self, psi: float) -> Jet:
        """The jet below the pivot, turned by psi (rad) about z."""
        tunnel = self.scenario.tunnel
        return Jet.below_pivot(self.pivot, tunnel.jet_edge_depth, psi, tunnel.jet_slope)

    def hanging(self, angle: float) -> tuple[np.ndarray, float]:
        """Reactions (6: N, N m) and the torque about the motor axis (positive downstream, N m) of the weight alone."""
        a = np.array(hanging_axis(angle))
        root, pivot = self.root_distance * a, np.asarray(self.pivot)
        mount, bar, tail = self.scenario.mount, self.scenario.bar, self.scenario.cheetah_tail
        bodies = [
            (mount.mass, np.array([mount.com_x, mount.com_y, mount.com_z])),
            (bar.mass, pivot + bar.com_distance * a),
            (tail.mass, pivot + root + tail.com_distance * np.array(self.tail_axis(angle))),
        ]
        mass = sum(m for m, _ in bodies)
        first = np.sum([m * p for m, p in bodies], axis=0)
        g = self.scenario.environment.gravity
        swinging = sum(m * (p[1] - pivot[1]) for m, p in bodies[1:])
        return np.array([0.0, 0.0, mass * g, g * first[1], -g * first[0], 0.0]), float(g * swinging)

    def wind_effect(self, angle: float, wind_speed: float, psi: Any) -> list[list[Any]]:
        """What the wind adds: rows bar, unit C_D and unit C_L of the tail; columns reactions (6) and axis torque.

        Args:
            angle: rad; a tail that hangs within half a degree of straight down has its lift to the root.
            wind_speed: m/s.
            psi: rad, float or AutoDiffXd.
        """
        s, c = (math.sin(psi), math.cos(psi)) if isinstance(psi, float) else (sin(psi), cos(psi))
        wind = (wind_speed * s, -wind_speed * c, 0.0 * s)
        jet, misalignment = self.jet(float_of(psi)), self.scenario.tunnel.misalignment
        a, b = hanging_axis(angle), self.tail_axis(angle)
        bar = self._forces((_DRAG,), self.bar, 0.0, a, a, wind, jet)[0]
        tail = self._forces((_DRAG, _LIFT), self.tail, self.root_distance, a, b, wind, jet)
        if -UPRIGHT_MARGIN < angle < 0.0 <= misalignment and angle + misalignment < 0.0:
            tail[1] = [-value for value in tail[1]]
        return [[self.scenario.bar.drag_coefficient * value for value in bar], *tail]

    def _forces(
        self, laws: Sequence[PolarLaw], layout: SectionLayout, root: float, a: Vector3, b: Vector3, wind: Any, jet: Jet
    ) -> list[list[Any]]:
        """Rows of reactions and axis torque per law, for sections along b that begin at the distance `root` along a."""
        p_WR = tuple(p + root * d for p, d in zip(self.pivot, a, strict=True))
        interval = jet.exposed_interval(layout, p_WR, b)
        if interval is None:
            return [[0.0 * wind[2]] * 7] * len(laws)
        area, middle = (interval[1] - interval[0]) * layout.chord, 0.5 * (interval[0] + interval[1])
        x, y, z = (p + middle * d for p, d in zip(p_WR, b, strict=True))
        arm_y, arm_z = y - self.pivot[1], z - self.pivot[2]
        rows = []
        for law in laws:
            f, g, h = law.section_force(wind, b, layout.normal_B, area, self.scenario.environment.air_density)
            moment = (z * g - y * h, x * h - z * f, y * f - x * g)
            rows.append([-f, -g, -h, *moment, arm_z * g - arm_y * h])
        return rows

    def exposed_length(self, angle: float, psi: float = 0.0) -> float:
        """How much of the tail is in the jet, m."""
        root = np.asarray(self.pivot) + self.root_distance * np.array(hanging_axis(angle))
        interval = self.jet(psi).exposed_interval(self.tail, root.tolist(), self.tail_axis(angle))
        return 0.0 if interval is None else float(interval[1] - interval[0])

    def holding_current(self, angle: float, wind_speed: float, cd: float, cl: float, psi: float) -> float:
        """The current that holds the tail still, A."""
        effect = np.array(self.wind_effect(angle, wind_speed, float(psi)))
        torque = self.hanging(angle)[1] + float(np.array([1.0, cd, cl]) @ effect[:, 6])
        return torque / self.torque_constant


def hanging_axis(angle: float) -> Vector3:
    """Unit vector from the pivot to the tip in W (3): down at 0, downstream (-y) at 90 degrees."""
    return (0.0, -math.sin(angle), -math.cos(angle))


Drift = Literal["linear", "quadratic", "exponential"]
DRIFTS: tuple[Drift, ...] = ("linear", "quadratic", "exponential")
HoldLoss = Literal["squares", "huber", "bisquare"]
HOLD_LOSSES: tuple[HoldLoss, ...] = ("squares", "huber", "bisquare")
_BISQUARE = 4.685
"""Standard deviations beyond which a sample has no weight at all: 95 % efficient on normal data."""
_ROUNDS, _SETTLED = 40, 1e-4
_MOST_CORRELATED = 8192
"""Samples that the correlation time of the noise is taken from."""
_TIMES = np.geomspace(0.04, 1.0, 15)
"""Time constants that are tried for the exponential, as parts of the length of the log."""


@dataclass(frozen=True)
class HoldMean:
    """Of some readings (k).

    Attributes:
        value: their step at the end of the rest; without a rest their mean (k).
        variance: of its error from noise (k).
        lags: samples that count as one (k).
        checks: of what is left of each (k).
    """

    value: np.ndarray
    variance: np.ndarray
    lags: np.ndarray
    checks: tuple[ResidualCheck, ...]


def hold_mean(
    time: np.ndarray, values: np.ndarray, step: np.ndarray | None, drift: Drift = "linear", loss: HoldLoss = "squares"
) -> HoldMean:
    """Fits drift and step.

    Args:
        time: s (n).
        values: readings (k x n).
        step: 0 in the rest and 1 in the hold (n); None without a rest.
        drift: a line of time; a parabola; or a line and an exponential that dies out, its time constant common to all.
        loss: squares; `huber` holds samples back that lie far off; `bisquare` leaves them out, for bursts.
    """
    shapes = [_design(time, step, shape) for shape in _shapes(time, drift)]
    left = [
        float(np.sum(np.var(values - _fitted(values, design), axis=1) / np.var(values, axis=1))) for design in shapes
    ]
    design = shapes[int(np.argmin(left))]
    place = 0 if step is None else len(design) - 1
    value, variance, lags, checks = [], [], [], []
    for row in values:
        found, scatter, spoilt = _robust(row, design, loss)
        lag = correlation_time(scatter[:_MOST_CORRELATED])
        inverse = np.linalg.inv(design @ design.T)
        noise = float(scatter @ scatter) / max(len(row) / lag - len(design), 1.0) * spoilt
        value.append(found[place])
        variance.append(noise * inverse[place, place])
        lags.append(lag)
        check = check_residual(scatter, len(design))
        if loss == "squares" and (check.far_off or chance_of([check]) < CHANCE):
            # What lies far off has bent the fit: how far shows against one that it has not bent.
            check = check_residual(row - _robust(row, design, "bisquare")[0] @ design, len(design))
        checks.append(check)
    return HoldMean(np.array(value), np.array(variance), np.array(lags), tuple(checks))


def residual_warnings(mean: HoldMean, channels: list[str], time: np.ndarray) -> list[str]:
    """What the readings do that noise does not."""
    far = {name: check for name, check in zip(channels, mean.checks, strict=True) if check.far_off >= FEW_FAR_OFF}
    warnings = []
    if far:
        worst = max(far.values(), key=lambda check: check.far_off)
        warnings.append(
            f"{', '.join(far)}: up to {worst.far_off} samples lie more than {FAR_OFF:g} standard deviations off, the "
            f"first at {time[worst.first]:g} s: no noise does that (try --loss bisquare)"
        )
    if chance_of(mean.checks) < CHANCE:
        name, check = max(zip(channels, mean.checks, strict=True), key=lambda pair: pair[1].wander)
        warnings.append(
            f"the readings wander about the fitted drift as noise does not ({name}: by up to {check.swing:.2g}, slow "
            f"power {check.wander:.3g} times that of its noise): the intervals are too narrow (try another --drift)"
        )
    return warnings


def _shapes(time: np.ndarray, drift: Drift) -> list[list[np.ndarray]]:
    """The columns of the drift beside the constant; several of which the best is taken."""
    t = time - time.mean()
    if drift == "linear":
        return [[t]]
    if drift == "quadratic":
        return [[t, np.square(t) - np.mean(np.square(t))]]
    length = time[-1] - time[0]
    dying = [np.exp(-(time - time[0]) / (part * length)) for part in _TIMES]
    return [[t, curve - curve.mean()] for curve in dying]


def _design(time: np.ndarray, step: np.ndarray | None, shape: list[np.ndarray]) -> np.ndarray:
    return np.stack([np.ones_like(time), *shape, *([] if step is None else [step])])


def _fitted(values: np.ndarray, design: np.ndarray) -> np.ndarray:
    return values @ design.T @ np.linalg.inv(design @ design.T) @ design


def _robust(row: np.ndarray, design: np.ndarray, loss: HoldLoss) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients; the residual, clipped or without what lies far off; by how much that widens the variance."""
    found = row @ design.T @ np.linalg.inv(design @ design.T)
    residual = row - found @ design
    if loss == "squares":
        return found, residual, 1.0
    for kind in ("huber",) if loss == "huber" else ("huber", "bisquare"):
        for _ in range(_ROUNDS):
            scale = spread(residual)
            if scale == 0.0:
                return found, residual, 1.0
            weight = _weight(residual / scale, kind)
            before, found = found, (row * weight) @ design.T @ np.linalg.inv((design * weight) @ design.T)
            residual = row - found @ design
            if np.max(np.abs((found - before) @ design)) < _SETTLED * scale:
                break
    size = np.abs(residual / scale)
    if loss == "huber":
        within = float(np.mean(size <= LIMIT))
    else:
        inside = size < _BISQUARE
        ratio = np.square(size / _BISQUARE)
        within = float(np.mean(np.where(inside, (1.0 - ratio) * (1.0 - 5.0 * ratio), 0.0)))
    return found, residual * _weight(residual / scale, loss), 1.0 / within**2


def _weight(size: np.ndarray, loss: str) -> np.ndarray:
    if loss == "huber":
        return np.minimum(1.0, LIMIT / np.maximum(np.abs(size), LIMIT))
    return np.where(np.abs(size) < _BISQUARE, np.square(1.0 - np.square(size / _BISQUARE)), 0.0)


OFFSETS_UNCERTAINTY = "offsets_uncertainty"
"""Key in a log's `extra`: standard deviation of what is left of the readings' offsets (6), N and N m."""
TARED = "tared_angle_rad"
"""Key in a log's `extra`: angle at which the sensor was zeroed without wind just before, rad."""


@dataclass(frozen=True)
class HoldOffset:
    """What is added to readings (6), the standard deviation of what is then left (6), and `StaticData.tare`."""

    added: np.ndarray
    deviation: np.ndarray
    tare: float | None


def stated_offset(log: RunLog, scenario: RigScenario, warnings: list[str]) -> HoldOffset:
    """Of a hold without rest: as the log states it, else as the scenario does; LogError and FitError for nonsense."""
    accuracy = np.asarray(scenario.force_sensor.accuracies)
    tared, stated = log.extra.get(TARED), log.stated(OFFSETS_UNCERTAINTY, len(REACTIONS))
    if tared is not None and (isinstance(tared, bool) or not isinstance(tared, int | float)):
        raise FitError(f"metadata {TARED!r} is {tared!r}; an angle in rad is needed")
    if stated is not None and min(stated) < 0.0:
        raise FitError(f"metadata {OFFSETS_UNCERTAINTY!r} is {list(stated)}; six numbers of at least 0 are needed")
    if stated is not None:
        deviation = np.asarray(stated)
    elif tared is not None:
        deviation = accuracy * scenario.force_sensor.drift_fraction * float(log.time[-1] - min(log.time[0], 0.0))
    else:
        deviation = accuracy
        warnings.append(
            "no rest phase: bias and drift stay in the readings; the sensor's accuracy is taken as their standard "
            f"deviation (state {OFFSETS_UNCERTAINTY} or {TARED} in the log if it was tared or calibrated)"
        )
    if tared is not None:
        return HoldOffset(np.zeros(6), deviation, float(tared))
    offsets = log.stated(OFFSETS, len(REACTIONS)) or scenario.cheetah_tail.offsets
    return HoldOffset(np.asarray(offsets, float), deviation, None)
