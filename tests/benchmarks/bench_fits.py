"""Fits against `scipy.optimize.least_squares` on the same residual, from the same seeds; and a
batch of static logs.
"""

import math
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from aerodima.optimisation.identify.fit_batch import fit_logs
from aerodima.optimisation.identify.gauss_newton import solve
from aerodima.optimisation.identify.least_squares import Problem
from aerodima.optimisation.identify.static_fit import fit_static, fit_static_log, static_problem
from aerodima.optimisation.identify.static_log import StaticData, static_data
from aerodima.optimisation.identify.swing_coefficients import (
    added_mass_parameter,
    friction_law,
    friction_parameters,
    still_tail_law,
)
from aerodima.optimisation.identify.swing_fit import SwingModel
from aerodima.optimisation.identify.swing_log import swing_data
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.logs.schema import write_run_log
from aerodima.workbench.rig.rig_plant import Rig
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.scenario.rig_scenario import load_rig_scenario
from tests.benchmarks.rows import BenchRow

REPEATS = 5
LOGS = 108
"""Static logs in the batch: three tails, two axes, six angles, three speeds."""


def _scipy(problem: Problem) -> Any:
    """scipy with the same residual, bounds and seeds, at its default tolerances.

    `dogbox`, because `trf` takes 40 times longer on the static fits and stops far from the minimum.
    """
    parameters = problem.parameters
    return least_squares(
        problem.residual,
        parameters.initial,
        bounds=(parameters.lower, parameters.upper),
        method="dogbox",
        x_scale="jac",
    )


def _seconds(act: Callable[[], object]) -> float:
    start = time.process_time()
    act()
    return time.process_time() - start


def _in_turns(problems: Sequence[Problem]) -> tuple[float, float, float]:
    """Median CPU seconds of us and of scipy over the same problems, and the largest cost of ours
    over scipy's.
    """
    worst = max((solve(p).best.cost + 1e-9) / (float(_scipy(p).cost) + 1e-9) for p in problems)
    ours = []
    peer = []
    for _ in range(REPEATS):
        ours.append(_seconds(lambda: [solve(p) for p in problems]))
        peer.append(_seconds(lambda: [_scipy(p) for p in problems]))
    return statistics.median(ours), statistics.median(peer), worst


def _holds() -> list[StaticData]:
    """One exposed hold per tail, angle and speed, with 1 % of the accuracy as noise and no bias."""
    holds = []
    for number, (tail, degrees, speed) in enumerate(
        (tail, degrees, speed)
        for tail in (1, 2, 3)
        for degrees in (0, 15, 30, 45, 60)
        for speed in (10.0, 20.0, 30.0)
    ):
        scenario = load_rig_scenario("static").varied(
            experiment={
                "tail": tail,
                "angle": math.radians(degrees),
                "wind_speed": speed,
                "duration": 0.5,
            },
            tunnel={"psi3": 0.05},
            force_sensor={
                f"{axis}_accuracy": 0.01 for axis in ("fx", "fy", "fz", "tx", "ty", "tz")
            },
            seed=number,
        )
        holds.append(static_data(simulate_static_log(scenario)))
    return holds


def bench_static_fits() -> list[BenchRow]:
    """Solves alone, one core; scipy with its finite differences."""
    holds = _holds()
    problems = [static_problem(data) for data in holds]
    ours, peer, worst = _in_turns(problems)
    whole = statistics.median(
        [_seconds(lambda: [fit_static(data) for data in holds]) for _ in range(3)]
    )
    per = 540.0 / len(problems)
    return [
        BenchRow(
            "static_fit", ours / len(problems) * 1e3, "ms", "<= 1.0", peer / len(problems) * 1e3
        ),
        BenchRow("static_fit_worst_cost", worst, "1", "<= 1.001"),
        BenchRow("static_540_solves", ours * per, "s"),
        BenchRow("static_540_fits_with_intervals", whole * per, "s"),
    ]


def bench_static_batch() -> list[BenchRow]:
    """Reading, conditioning and fitting logs of 20 s at 1 kHz in one call with two workers, scaled
    to 540.
    """
    with tempfile.TemporaryDirectory() as folder:
        paths = []
        scenario = load_rig_scenario("static").varied(
            experiment={"angle": math.radians(15.0), "wind_speed": 20.0}
        )
        rig = Rig(scenario)
        for seed in range(LOGS):
            log = simulate_static_log(scenario.varied(seed=seed), rig)
            paths.append(write_run_log(log, Path(folder) / f"{seed}.parquet"))
        start = time.perf_counter()
        batch = fit_logs(fit_static_log, paths, Path(folder) / "fits", settings={}, workers=2)
        taken = time.perf_counter() - start
    if batch.failed:
        raise RuntimeError(f"{len(batch.failed)} logs failed: {next(iter(batch.failed.values()))}")
    return [BenchRow("static_540_logs", taken * 540.0 / LOGS, "s", "<= 60")]


def bench_rollout_fits() -> list[BenchRow]:
    """Bar friction and added mass on swings made by the rig's plant."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        bar = swing_data(
            simulate(
                load_rig_scenario("bar", ["experiment.duration=5"]), Path(folder) / "bar.parquet"
            ),
            "bar_swing",
        )
        flick_scenario = load_rig_scenario(
            "flick", ["aero.added_mass=0.02", "experiment.duration=2"]
        )
        flick = swing_data(simulate(flick_scenario, Path(folder) / "flick.parquet"), "swing")
    problems = {
        "bar_friction_fit": SwingModel(bar, friction_law).problem(friction_parameters()),
        "added_mass_fit": SwingModel(flick, still_tail_law).problem([added_mass_parameter(flick)]),
    }
    for name, problem in problems.items():
        ours, peer, worst = _in_turns([problem])
        rows.append(BenchRow(name, ours, "s", "<= 1.3", peer))
        rows.append(BenchRow(f"{name}_cost", worst, "1", "<= 1.001"))
    x = problems["added_mass_fit"].parameters.initial
    rollout = np.median(
        [_seconds(lambda: problems["added_mass_fit"].residual(x)) for _ in range(REPEATS)]
    )
    rows.append(BenchRow("flick_rollouts", 1.0 / float(rollout), "1/s"))
    return rows
