"""How often the intervals of fits at their defaults hold the truth, over logs of `other_lab` whose
constants are off.

Every constant, bias of an instrument and coefficient is drawn anew for each log, the constants from
the priors that the scenario's section `uncertainty` states; the fit knows nothing of the draw.

    python -m tests.optimisation.coverage_study [LOGS [FOLDER]]

fits that many logs of each kind (200 take 15 s of static ones, 100 s of friction and half an hour
of added mass, on one core) and ends with status 1 where a parameter is held by less than 90 or more
than 98 % of its intervals. Finished logs are kept in the folder, if one is named, and a second call
goes on with what is missing; take a new one for new code. A test of the suite runs a few logs of
each kind.
"""

from __future__ import annotations

import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

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
    return {
        name: stated[name]
        for name in (*_FIELDS, "pivot_x", "pivot_y", "pivot_z")
        if stated[name] > 0.0
    }


def shifted(rig: lab.Lab, values: Mapping[str, float]) -> lab.Lab:
    """A laboratory whose constants are off."""
    pivot = tuple(
        p + values.get(f"pivot_{axis}", 0.0) for p, axis in zip(rig.pivot, "xyz", strict=True)
    )
    fields = {
        _FIELDS[name]: getattr(rig, _FIELDS[name]) + shift
        for name, shift in values.items()
        if name in _FIELDS
    }
    return replace(rig, pivot=pivot, **fields)


Case = tuple[Callable[[lab.Lab], RunLog], Callable[[RunLog], FitResult]]
"""Makes the log of a laboratory, and fits it."""


def draw_static(rng: np.random.Generator) -> Case:
    """A hold at a random angle and wind, with rest."""
    angle = rng.uniform(math.radians(5.0), math.radians(45.0))
    wind = float(rng.choice([10.0, 20.0, 30.0]))
    truth = {
        "cd": rng.uniform(0.6, 1.2),
        "cl": rng.uniform(0.05, 0.5),
        "psi": rng.uniform(-0.1, 0.1),
    }
    bias = rng.normal(size=6) * lab.ACCURACY
    drift = rng.normal(size=6) * 2e-4 * lab.ACCURACY
    seed = int(rng.integers(1 << 30))

    def make(rig: lab.Lab) -> RunLog:
        rig = replace(rig, force_bias=bias, force_drift=drift)
        return lab.hold(rig, **truth, angle=angle, wind=wind, duration=6.0, seed=seed)

    return make, lambda log: fit_static(static_data(log))


def draw_friction(rng: np.random.Generator) -> Case:
    """A free swing of the bar; what the scenario says of its friction is not used."""
    angle = rng.uniform(1.0, 1.5)
    friction = {"coulomb": rng.uniform(0.02, 0.08), "viscous": rng.uniform(0.02, 0.05)}

    def make(rig: lab.Lab) -> RunLog:
        return lab.bar_swing(replace(rig, **friction), angle=angle, duration=4.0)

    return make, lambda log: fit_friction(swing_data(log, "bar_swing"))


def draw_added_mass(rng: np.random.Generator) -> Case:
    """A driven swing in the wind with coefficients that are known."""
    angle = rng.uniform(0.7, 1.3)
    seed = int(rng.integers(1 << 30))
    mass = rng.uniform(0.0, 0.06)
    options = FitOptions(settings=AIR)

    def make(rig: lab.Lab) -> RunLog:
        return lab.flick(
            rig, added_mass=mass, wind=10.0, angle=angle, duration=1.2, rate=250.0, seed=seed
        )

    return make, lambda log: fit_added_mass(swing_data(log, "swing", options=options), options)


DRAWS = {"static": draw_static, "friction": draw_friction, "added_mass": draw_added_mass}


def fit_drawn(kind: str, name: str) -> FitResult:
    """The fit of a log by its number, with the truth in its facts."""
    rng = np.random.default_rng([1, int(name)])
    make, fit = DRAWS[kind](rng)
    log = make(
        shifted(lab.LAB, {constant: size * rng.normal() for constant, size in deviations().items()})
    )
    return replace(fit(log), facts={"truth": log.extra["truth"]})


def study(kind: str, count: int, out: Path) -> pd.DataFrame:
    """The fits of the first logs of a kind, those that `out` has already among them.

    Returns:
        A row per parameter: kind, parameter, logs, determined, held (by how many of those intervals
            the truth is),
        percent of the determined, and score_deviation: of (value - truth) / standard deviation, 1
            for intervals of the
        right width.
    """
    found = fit_logs(
        partial(fit_drawn, kind),
        [str(number) for number in range(count)],
        out,
        settings={"study": kind},
    )
    assert not found.failed, found.failed
    rows = []
    for name in found.results[0].facts["truth"]:
        pairs = [(r[name], r.facts["truth"][name]) for r in found.results if r[name].identifiable]
        held = sum(e.holds(truth) for e, truth in pairs)
        scores = [(e.value - truth) / e.standard_deviation for e, truth in pairs]
        rows.append(
            (kind, name, count, len(pairs), held, 100.0 * held / len(pairs), np.std(scores))
        )
    names = ["kind", "parameter", "logs", "determined", "held", "percent", "score_deviation"]
    return pd.DataFrame(rows, columns=names)


def main() -> None:
    """Runs all kinds and prints their tables."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    folder = Path(sys.argv[2] if len(sys.argv) > 2 else tempfile.mkdtemp())
    out_of_range = False
    for kind in DRAWS:
        begin = time.perf_counter()
        table = study(kind, count, folder / kind)
        out_of_range |= not table.percent.between(90.0, 98.0).all()
        print(
            table.to_string(index=False, float_format="%.2f"),
            f"\n{time.perf_counter() - begin:.0f} s",
            flush=True,
        )
    sys.exit(int(out_of_range))


if __name__ == "__main__":
    main()
