"""Logs of `other_lab` whose constants are off, and their fits at their defaults.

Every constant, bias of an instrument and coefficient is drawn anew for each log, the constants from
the priors that the scenario's section `uncertainty` states; the fit knows nothing of the draw.
"""

import math
from dataclasses import fields, replace
from functools import partial

import numpy as np

from aerodima.optimisation.identify.fit_options import FREE, FitOptions
from aerodima.optimisation.identify.static_fit import fit_static
from aerodima.optimisation.identify.static_log import static_data
from aerodima.optimisation.identify.swing_coefficients import fit_added_mass, fit_friction
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.optimisation.identify import other_lab as lab

AIR = ("aero.source=constant", "aero.drag=0.9", "aero.lift=0.25")


def shifted(rig, rng):
    """A laboratory whose constants are off, as the scenario states them."""
    stated = load_rig_scenario("static").uncertainty.model_dump()
    off = {name: deviation * rng.normal() for name, deviation in stated.items()}
    known = {field.name for field in fields(rig)}
    changes = {name: getattr(rig, name) + off[name] for name in off if name in known}
    pivot = np.array(rig.pivot) + [off[f"pivot_{axis}"] for axis in "xyz"]
    return replace(rig, pivot=tuple(pivot), wind_gain=1.0 + off["wind_speed"], **changes)


def static(rig, rng, axes=lab.READINGS, degrees=(5.0, 45.0), options=FREE):
    """A hold at a random angle and wind, with rest, of a sensor with some axes."""
    rig = replace(
        rig,
        force_bias=rng.normal(size=6) * lab.ACCURACY,
        force_drift=rng.normal(size=6) * 2e-4 * lab.ACCURACY,
    )
    cd, cl, psi = rng.uniform([0.6, 0.05, -0.1], [1.2, 0.5, 0.1])
    angle = math.radians(rng.uniform(*degrees))
    wind = float(rng.choice([10.0, 20.0, 30.0]))
    seed = int(rng.integers(1 << 30))
    log = lab.hold(rig, cd=cd, cl=cl, psi=psi, angle=angle, wind=wind, duration=6.0, seed=seed)
    table = log.table.drop(columns=[name for name in lab.READINGS if name not in axes])
    return log, fit_static(static_data(replace(log, table=table), options=options))


OPEN = {
    "drag and lift": partial(static, axes=("force_y_n", "force_z_n")),
    "drag": partial(static, axes=("force_y_n",)),
    "side and torque": partial(static, axes=("force_x_n", "torque_x_n_m")),
    "out of the jet": partial(static, degrees=(76.0, 85.0)),
}
"""Draws of holds that leave unknowns open."""


def friction(rig, rng, options=FREE):
    """A free swing of the bar; what the scenario says of its friction is not used."""
    coulomb, viscous, angle = rng.uniform([0.02, 0.02, 1.0], [0.08, 0.05, 1.5])
    rig = replace(rig, coulomb=coulomb, viscous=viscous)
    log = lab.bar_swing(rig, angle=angle, duration=4.0)
    return log, fit_friction(swing_data(log, "bar_swing", options=options))


def exact(draw):
    """Draws of a laboratory whose constants are right, in fits that take them as exact."""
    return lambda rig, rng: draw(lab.LAB, rng, options=FitOptions(constants="exact"))


def added_mass(rig, rng):
    """A driven swing in the wind with coefficients that are known."""
    angle, mass = rng.uniform([0.7, 0.0], [1.3, 0.06])
    seed = int(rng.integers(1 << 30))
    log = lab.flick(rig, added_mass=mass, angle=angle, duration=1.2, rate=250.0, seed=seed)
    options = FitOptions(settings=AIR)
    return log, fit_added_mass(swing_data(log, "swing", options=options), options)


def results(draw, logs, seed):
    """Parameter, truth and fit of each unknown of the first logs."""
    for number in range(logs):
        rng = np.random.default_rng([seed, number])
        log, result = draw(shifted(lab.LAB, rng), rng)
        for name, truth in log.extra["truth"].items():
            yield name, truth, result


def held(draw, logs):
    """Whether the finite intervals of the first logs hold their truth, and the number of infinite
    ones.
    """
    finite = []
    infinite = 0
    for name, truth, result in results(draw, logs, 2):
        one = result[name]
        assert one.identifiable == math.isfinite(one.upper - one.lower)
        if one.identifiable:
            finite.append(one.holds(truth))
        else:
            infinite += 1
            assert any(name in text for text in result.unidentifiable)
    return finite, infinite


def scores(draw, logs):
    """Errors over standard deviations of what the first logs determine, by parameter."""
    found = {}
    for name, truth, result in results(draw, logs, 1):
        one = result[name]
        if one.identifiable:
            score = (one.value - truth) / one.standard_deviation
            found.setdefault(name, []).append(score)
    return found
