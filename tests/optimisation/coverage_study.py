"""How often intervals hold the truth when the constants are off, over logs of `other_lab`; not run by pytest.

Every constant, bias of an instrument and coefficient is drawn anew for each log, from what the scenario's section
`uncertainty` says of it; the fit knows nothing of the draw. Beside it the least width that an interval can have: that
of an estimator that knows noise and priors exactly (Cramer-Rao with priors), from derivatives of `other_lab` itself.

    python -m tests.optimisation.coverage_study static 100 out/coverage_static

Finished logs are kept in the folder, and a second call goes on with what is missing; take a new one for new code.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from aerodima.optimisation.identify.fit_batch import fit_logs
from aerodima.optimisation.identify.fit_pipeline import FitResult
from aerodima.optimisation.identify.log_rig import FitOptions
from aerodima.optimisation.identify.static_fit import fit_static
from aerodima.optimisation.identify.static_log import static_data
from aerodima.optimisation.identify.swing_coefficients import fit_added_mass, fit_friction
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.config.rig_scenario import load_rig_scenario
from aerodima.workbench.logs.schema import RunLog
from tests.optimisation.identify import other_lab as lab

_FIELDS = {
    "mount_mass": "mount_mass",
    "bar_mass": "bar_mass",
    "bar_com": "bar_com",
    "bar_inertia": "bar_inertia",
    "bar_width": "bar_width",
    "bar_drag": "bar_drag",
    "tail_mass": "tail_mass",
    "tail_com": "tail_com",
    "tail_gap": "gap",
    "tail_length": "tail_length",
    "tail_width": "tail_width",
    "rotor_inertia": "rotor_inertia",
    "torque_constant": "torque_constant",
    "jet_edge_depth": "jet_depth",
    "air_density": "air_density",
    "coulomb": "coulomb",
    "viscous": "viscous",
    "encoder_zero": "encoder_zero",
    "wind_speed": "wind_gain",
}
AIR = ("aero.source=constant", "aero.drag=0.9", "aero.lift=0.25")


def deviations() -> dict[str, float]:
    """Of every constant that the laboratory has, as the scenario states them."""
    stated = load_rig_scenario("static").uncertainty.model_dump()
    return {name: stated[name] for name in (*_FIELDS, "pivot_x", "pivot_y", "pivot_z") if stated[name] > 0.0}


def shifted(rig: lab.Lab, values: Mapping[str, float]) -> lab.Lab:
    """A laboratory whose constants are off."""
    pivot = tuple(p + values.get(f"pivot_{axis}", 0.0) for p, axis in zip(rig.pivot, "xyz", strict=True))
    fields = {_FIELDS[name]: getattr(rig, _FIELDS[name]) + shift for name, shift in values.items() if name in _FIELDS}
    return replace(rig, pivot=pivot, **fields)


def _quiet(rig: lab.Lab) -> lab.Lab:
    return replace(rig, force_noise=np.zeros(6), current_noise=0.0, count=1e-13)


Case = tuple[Callable[[lab.Lab, dict[str, float], int, bool], RunLog], Callable[[RunLog], FitResult], dict[str, float]]


def draw_static(rng: np.random.Generator) -> Case:
    """A hold at a random angle and wind, with rest."""
    angle, wind = rng.uniform(math.radians(5.0), math.radians(45.0)), float(rng.choice([10.0, 20.0, 30.0]))
    truth = {"cd": rng.uniform(0.6, 1.2), "cl": rng.uniform(0.05, 0.5), "psi3": rng.uniform(-0.1, 0.1)}
    bias, drift = rng.normal(size=6) * lab.ACCURACY, rng.normal(size=6) * 2e-4 * lab.ACCURACY

    def make(rig: lab.Lab, values: dict[str, float], seed: int, quiet: bool) -> RunLog:
        rig = replace(rig, force_bias=bias, force_drift=drift)
        rig = _quiet(rig) if quiet else rig
        rest = {"angle": angle, "wind": wind, "duration": 6.0, "seed": seed}
        return lab.hold(rig, cd=values["cd"], cl=values["cl"], psi=values["psi3"], **rest)

    return make, lambda log: fit_static(static_data(log)), truth


def draw_friction(rng: np.random.Generator) -> Case:
    """A free swing of the bar; what the scenario says of its friction is not used."""
    angle = rng.uniform(1.0, 1.5)
    truth = {"coulomb": rng.uniform(0.02, 0.08), "viscous": rng.uniform(0.02, 0.05)}

    def make(rig: lab.Lab, values: dict[str, float], seed: int, quiet: bool) -> RunLog:
        rig = _quiet(rig) if quiet else rig
        friction = {name: values[name] for name in truth}
        start = angle + values.get("start_angle", 0.0), values.get("start_rate", 0.0)
        return lab.bar_swing(replace(rig, **friction), angle=start[0], start_rate=start[1], duration=4.0)

    return make, lambda log: fit_friction(swing_data(log, "bar_swing")), truth


def draw_added_mass(rng: np.random.Generator) -> Case:
    """A driven swing in the wind with coefficients that are known."""
    angle, drive = rng.uniform(0.7, 1.3), int(rng.integers(1000))
    truth = {"added_mass": rng.uniform(0.0, 0.06)}
    options = FitOptions(settings=AIR)

    def make(rig: lab.Lab, values: dict[str, float], seed: int, quiet: bool) -> RunLog:
        rig = _quiet(rig) if quiet else rig
        start = {"angle": angle + values.get("start_angle", 0.0), "start_rate": values.get("start_rate", 0.0)}
        mass = values["added_mass"]
        return lab.flick(rig, added_mass=mass, wind=10.0, duration=1.2, rate=250.0, drive=drive, seed=seed, **start)

    def fit(log: RunLog) -> FitResult:
        return fit_added_mass(swing_data(log, "swing", options=options), options)

    return make, fit, truth


DRAWS = {"static": draw_static, "friction": draw_friction, "added_mass": draw_added_mass}


def draw(kind: str, number: int) -> tuple[Case, dict[str, float], lab.Lab]:
    """A log's case, the constants that are not exact, and the laboratory as it is."""
    rng = np.random.default_rng([1, number])
    case = DRAWS[kind](rng)
    known = deviations()
    if kind == "friction":
        known = {name: value for name, value in known.items() if name not in ("coulomb", "viscous")}
    return case, known, shifted(lab.LAB, {name: deviation * rng.normal() for name, deviation in known.items()})


def fit_drawn(kind: str, bounds: int, name: str) -> FitResult:
    """The fit of a log by its number; in its facts the truth, and of the first `bounds` logs the least deviations."""
    number = int(name)
    (make, fit, truth), known, rig = draw(kind, number)
    result = fit(make(rig, truth, number, False))
    least = least_deviations(kind, make, truth, known) if number < bounds else {}
    return replace(result, facts={**result.facts, "truth": truth, "least": least})


def study(kind: str, count: int, out: Path, bounds: int) -> list[FitResult]:
    """The fits of the first logs of a kind, those that `out` has already among them."""

    def say(line: str) -> None:
        print(f"{kind}: {line}", file=sys.stderr, flush=True)

    settings = {"study": kind, "bounds": bounds}
    names = [str(number) for number in range(count)]
    found = fit_logs(partial(fit_drawn, kind, bounds), names, out, settings=settings, progress=say)
    for name, reason in found.failed.items():
        print(f"{kind} {name}: {reason}", file=sys.stderr)
    return found.results


def least_deviations(kind: str, make: Callable, truth: dict[str, float], known: dict[str, float]) -> dict[str, float]:
    """Cramer-Rao with priors: (J' S^-1 J + P^-1)^-1, J by differences of quiet logs, S the noise as it is made."""
    unknown = dict(truth) if kind == "static" else {**truth, "start_angle": 0.0, "start_rate": 0.0}
    sizes = dict.fromkeys(unknown, 0.001) | {name: 0.1 * deviation for name, deviation in known.items()}

    def signal(shifts: dict[str, float]) -> np.ndarray:
        values = {name: value + shifts.get(name, 0.0) for name, value in unknown.items()}
        return _signal(kind, make(shifted(lab.LAB, shifts), values, 0, True))

    columns = [(signal({n: h}) - signal({n: -h})) / (2.0 * h) for n, h in sizes.items()]
    J = np.column_stack(columns)
    information = J.T @ np.linalg.solve(_noise(kind, make, truth), J)
    prior = [0.0] * len(unknown) + [1.0 / deviation**2 for deviation in known.values()]
    size = np.sqrt(np.diag(information) + prior)
    covariance = np.linalg.inv((information + np.diag(prior)) / np.outer(size, size)) / np.outer(size, size)
    return {name: math.sqrt(covariance[i, i]) for i, name in enumerate(unknown) if name in truth}


def _signal(kind: str, log: RunLog) -> np.ndarray:
    """What the fit sees: the angle, or the steps of the readings after the rest."""
    if kind != "static":
        return log.signal("angle_rad")
    readings = np.array([log.signal(name) for name in lab.READINGS])
    design = _design(log.time)
    return (readings @ design.T @ np.linalg.inv(design @ design.T))[:, 2]


def _design(time: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(time), time, (time > 2.0).astype(float)])


def _noise(kind: str, make: Callable, truth: dict[str, float]) -> np.ndarray:
    """Covariance of that signal; of the noisy current as the linear response of the angle to it."""
    log = make(lab.LAB, truth, 0, True)
    if kind == "static":
        design = _design(log.time)
        return np.diag(np.square(0.01 * lab.ACCURACY) * np.linalg.inv(design @ design.T)[2, 2])
    rounding = lab.COUNT**2 / 12.0 * np.eye(len(log.time))
    if kind == "friction":
        return rounding
    pushed = _pushed(make, truth, log) * lab.LAB.current_noise
    return rounding + pushed @ pushed.T


def _pushed(make: Callable, truth: dict[str, float], log: RunLog) -> np.ndarray:
    """Change of the angle (n) per ampere that flows beyond each sample of the current (n x n), linearised.

    A push changes the rate; what that does to the angle later is a sum of what a change of the first angle and of the
    first rate do. A sample stands for the time to its neighbours, half a step to either side.
    """
    step = float(log.time[1] - log.time[0])
    ways = []
    for name, size in (("start_angle", 1e-4), ("start_rate", 1e-3)):
        ends = [make(lab.LAB, {**truth, name: sign * size}, 0, True).signal("angle_rad") for sign in (1.0, -1.0)]
        ways.append((ends[0] - ends[1]) / (2.0 * size))
    angle = np.array(ways)  # (2 x n)
    rate = np.gradient(angle, step, axis=1, edge_order=2)
    state = np.stack([angle, rate])  # (2 x 2 x n), from the first state to that of a sample
    kick = np.linalg.solve(np.moveaxis(state, 2, 0), np.array([0.0, 1.0]))  # (n x 2), first state that is as a kick
    kick *= -lab.LAB.torque_constant / lab.swinging_inertia(lab.LAB, truth["added_mass"]) * step
    return np.tril(angle.T @ kick.T)


def main() -> None:
    """Runs one study and prints a line per parameter, and one for all."""
    kind, count, out = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    bounds = int(sys.argv[4]) if len(sys.argv) > 4 else 5
    results = study(kind, count, out, bounds)
    held = []
    for name in results[0].facts["truth"]:
        found = [(r[name], r.facts["truth"][name], r.facts["least"].get(name, math.nan)) for r in results]
        scores = [(e.value - truth) / e.standard_deviation for e, truth, _ in found]
        inside = [e.holds(truth) for e, truth, _ in found]
        # By the deviations: both intervals are 1.96 of theirs to either side.
        ratio = np.array([e.standard_deviation / least for e, _, least in found])
        held += inside
        print(
            f"{name:12s} {sum(inside):4d} of {len(inside)} = {100.0 * np.mean(inside):5.1f} %, scores "
            f"{np.std(scores):.2f}, median width over the least {np.nanmedian(ratio):.3f} "
            f"(of {np.sum(np.isfinite(ratio))})"
        )
    print(f"{'all':12s} {sum(held):4d} of {len(held)} = {100.0 * np.mean(held):5.1f} %")


if __name__ == "__main__":
    main()
