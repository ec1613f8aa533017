"""From a scenario to a swing: profile of the turn, collocation, full car, and again until nothing is gained.

Each round takes the profile of the turn from a run of the full car that survived with the present swing, solves the
programme within a trust region of friction (or speed) around that run, and drives the full car with the new swing. The
round is kept if the full car then survives more than before; the search ends when a round gains less than one step.
On demand a refinement on the full car follows (`full_model_refinement`), and gains of a tracker (`feedback_gains`).
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.optimisation.sweep.study_engine import Engine
from aerodima.optimisation.swing import planar_model as planar
from aerodima.optimisation.swing import spatial_model as spatial
from aerodima.optimisation.swing.feedback_gains import with_feedback
from aerodima.optimisation.swing.full_car import drive, frictions, profile_of, varied
from aerodima.optimisation.swing.full_model_refinement import polished
from aerodima.optimisation.swing.mesh_refinement import refine
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.search_state import Search, SearchOptions, Told, begin, keep, open_search, resumed, run
from aerodima.optimisation.swing.solver import Solution, best_of, multi_start
from aerodima.optimisation.swing.swing_construction import even_swing, swing_file
from aerodima.optimisation.swing.transcription import Member, Problem, SwingLimits, uniform_knots
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import Scenario, default_values
from aerodima.workbench.config.swing_file import Provenance, SwingFile
from aerodima.workbench.errors import SwingError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.plants.clearance import make_range_of_motion

__all__ = ["SearchOptions", "optimise_swing"]

_MODELS: dict[int, Any] = {1: planar, 2: spatial}
SOURCE = "aerodima optimise swing"
"""In the provenance of what comes from here."""
MAP_NODES = 25
"""Nodes of the range-of-motion map along each joint."""


def optimise_swing(
    scenario: Scenario,
    options: SearchOptions,
    *,
    name: str,
    scenario_name: str = "",
    settings: tuple[str, ...] = (),
    warm_start: SwingFile | None = None,
    checkpoint: Path | None = None,
    engine: Engine | None = None,
    told: Told = lambda _line: None,
) -> SwingFile:
    """The best swing of a search.

    Args:
        scenario: car and turn; its tyre friction and speed are where the search begins.
        options: what is wanted.
        name: of the swing.
        scenario_name, settings: for the provenance.
        warm_start: a swing to begin with instead of the scenario's controller.
        checkpoint: file that keeps the search between rounds; a search found there goes on. The candidates of a polish
            are kept beside it.
        engine: where a polish drives its cars.
        told: progress, line by line.

    Raises:
        SwingError: the turn needs no tail, nothing survives it, the swing is released after the turn, the limits leave
            no swing (names the violated constraints), the solver is missing, a warm start for another car.
        EnsembleError: the ensemble of `options.members` cannot be read.
    """
    deadline = time.perf_counter() + options.wall_time
    if options.dof not in _MODELS:
        raise SwingError(f"--dof: {options.dof}; allowed: {', '.join(map(str, _MODELS))}")
    if scenario.manoeuvre.kind not in ("turn", "auto_turn"):
        raise SwingError(f"manoeuvre.kind: {scenario.manoeuvre.kind!r}; allowed: turn, auto_turn")
    if scenario.tail.mode == "none":
        raise SwingError("tail.mode: 'none', the car has no tail to swing; allowed: held, swing")
    turn = scenario
    if options.threshold is not None:
        scenario = varied(scenario, controller={"trigger_yaw_rate": options.threshold})
    cars = _cars(varied(scenario, tail={"mode": "swing"}), options)
    limits = SwingLimits.of(ReducedCar.of(cars[0]), options.dof, options.torque)
    if not options.rounds and not options.polish and warm_start is None:
        raise SwingError("--rounds: 0; allowed: from 1 on, or 0 with --polish")
    if not options.rounds and warm_start is None:
        warm_start = even_swing(
            name, cars[0], length=options.length, knots=options.knots, provenance={"source": SOURCE}
        )
    with open_search(checkpoint, cars[0], options) as store:
        search = resumed(store) or begin(cars, options, warm_start, told)
        while not search.finished and search.rounds < options.rounds and time.perf_counter() < deadline:
            _round(search, cars, options, limits, name, scenario_name, settings, deadline, told)
            keep(store, search)
        if search.swing is None:
            raise SwingError(f"no swing found within {options.wall_time:g} s; allowed: a longer wall time")
        swing = search.swing
        if not options.rounds:
            swing = _as_it_was(swing, name, options, scenario_name, settings, search.speed)
        if options.polish:
            turns = _cars(varied(turn, manoeuvre={"speed": search.speed}), options)
            swing = polished(swing, turns, options, engine=engine, checkpoint=checkpoint, told=told)
        if options.feedback:
            swing = _with_gains(swing, cars[0], told)
        if store is not None:
            store.remove()
    return swing


def _as_it_was(
    warm: SwingFile, name: str, options: SearchOptions, scenario_name: str, settings: tuple[str, ...], speed: float
) -> SwingFile:
    """A warm start under a new name, with the provenance of this search."""
    kept = {key: value for key, value in warm.provenance.found.items() if key in ("collocation_error_rad", "knots")}
    provenance = Provenance(
        source=SOURCE, scenario=scenario_name or None, settings=settings, seed=options.seed, options=options.stored(),
        solver_log=None,
        found=kept | {"survived_speed_m_per_s": round(speed, 6)}, versions=software_versions(),
    )  # fmt: skip
    return warm.model_copy(update={"name": name, "provenance": provenance})


def _cars(scenario: Scenario, options: SearchOptions) -> tuple[Scenario, ...]:
    """The scenario with its own car, and with those of the ensemble at as many times their own friction."""
    cars = [scenario]
    if options.members:
        own = float(default_values()["car"]["tyre_friction"])
        for member in load_ensemble(options.ensemble).drawn(options.members):
            sections: dict[str, dict[str, Any]] = {"car": {}}
            for key, value in member.values_with(scenario.tail.name).items():
                section, _, entry = key.partition(".")
                sections.setdefault(section, {})[entry] = value
            friction = float(member.values.get(FRICTION, own)) * scenario.car.tyre_friction / own
            sections["car"]["tyre_friction"] = friction
            cars.append(varied(scenario, **sections))
    return tuple(cars)


def _with_gains(swing: SwingFile, scenario: Scenario, told: Told) -> SwingFile:
    """With feedback for the highest friction that the swing was seen to survive; without it where that fails."""
    found = swing.provenance.found
    sections: dict[str, dict[str, Any]] = {}
    if "survived_friction" in found:
        sections = {"car": {"tyre_friction": float(found["survived_friction"])}}
        sections["manoeuvre"] = {"speed": float(found["survived_speed_m_per_s"])}
    try:
        return with_feedback(swing, varied(scenario, **sections))
    except SwingError as error:
        told(f"no feedback: {error}")
        return swing


def _round(
    search: Search,
    cars: tuple[Scenario, ...],
    options: SearchOptions,
    limits: SwingLimits,
    name: str,
    scenario_name: str,
    settings: tuple[str, ...],
    deadline: float,
    told: Told,
) -> None:
    scenario = cars[0]
    problem = _problem(search, cars, options, limits)
    left = deadline - time.perf_counter()
    solutions = multi_start(
        problem, options.seed, options.starts, solver=options.solver, iterations=options.iterations,
        wall_time=max(left, 0.0), done=lambda k, s: told(f"  start {k + 1}: {_words(s, problem)}"),
    )  # fmt: skip
    best = best_of(solutions)
    if best.violations:
        search.finished = True
        if search.swing is None:
            raise SwingError("no swing keeps to the limits: " + "; ".join(map(str, best.violations)))
        return
    problem, best, error = refine(
        problem, best, options.bound, wall_time=max(deadline - time.perf_counter(), 1.0),
        solver=options.solver, iterations=options.iterations,
        told=lambda n, e: told(f"  {n} knots: collocation error {e:.4f} rad, finer mesh"),
    )  # fmt: skip
    costs = [solution.cost for solution in solutions if solution.success]
    found: dict[str, float | int | str] = {
        "collocation_error_rad": round(error, 6),
        "knots": len(problem.knots),
        "cost": round(best.cost, 6),
        "starts_converged": len(costs),
        "starts": len(solutions),
        "cost_spread": round(max(costs) - min(costs), 6) if costs else math.nan,
        "profile_friction": round(search.friction, 6),
        "profile_speed_m_per_s": round(search.speed, 6),
    }
    swing = swing_file(
        name, problem, best, scenario,
        threshold=scenario.controller.trigger_yaw_rate, pitch=scenario.controller.pitch_angle,
        provenance={
            "source": SOURCE, "scenario": scenario_name or None, "settings": settings,
            "seed": options.seed, "options": options.stored(), "found": found,
        },
    )  # fmt: skip
    search.rounds += 1
    _climb(search, cars, options, swing, found, told)


def _problem(search: Search, cars: tuple[Scenario, ...], options: SearchOptions, limits: SwingLimits) -> Problem:
    """The programme around the runs of all cars with the present swing."""
    members = []
    for car, friction in zip(cars, frictions(cars, search.friction), strict=True):
        here = varied(car, manoeuvre={"speed": search.speed})
        run = drive(here, search.swing, friction, all_signals=True)
        profile = profile_of(run, here, friction, here.manoeuvre.turn_start)
        members.append(Member(ReducedCar.of(here), profile))
    speed, controller = members[0].profile.speed, cars[0].controller
    ends = {"friction": (1.0 - options.trust, 1.0 + options.trust)}
    ends["speed"] = ((1.0 - options.trust) * speed, (1.0 + options.trust) * speed)
    return Problem(
        _MODELS[options.dof],
        tuple(members),
        uniform_knots(options.length, options.knots),
        (-controller.hold_angle, controller.pitch_angle)[: options.dof],
        limits,
        options.objective,
        ends.get(options.objective, (0.0, 1.0)),
        options.wait,
        free_of=make_range_of_motion(cars[0], MAP_NODES, MAP_NODES) if options.dof == 2 else None,
    )


def _climb(
    search: Search,
    cars: tuple[Scenario, ...],
    options: SearchOptions,
    swing: SwingFile,
    found: dict[str, float | int | str],
    told: Told,
) -> None:
    """Drives the full cars with the swing at higher and higher friction (or speed) up to the trust region."""
    steps = 1.0 + options.trust * np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    if options.objective not in ("friction", "speed"):
        steps = steps[:1]
    reached = None
    for step in steps:
        friction = search.friction * (step if options.objective == "friction" else 1.0)
        speed = search.speed * (step if options.objective == "speed" else 1.0)
        seen = run(cars, swing, friction, speed)
        end = "clean" if seen.clean else "survived" if seen.survived else "rolled over"
        told(f"  full car at {speed:.2f} m/s, friction {friction:.3f}: {end}, peak {seen.peak_roll:.3f} rad")
        if not seen.clean:
            break
        reached = (friction, speed, seen)
    if reached is None:
        search.finished = True
        if search.swing is None:
            raise SwingError(
                f"the full car rolls over with the swing at friction {search.friction:.3f}, {search.speed:.2f} m/s, "
                "where the reduced model does not; allowed: begin at less friction or speed"
            )
        told("  the new swing loses where the old one survived: kept the old one")
        return
    found |= {"peak_roll_rad": round(reached[2].peak_roll, 6), "heading_rad": round(reached[2].heading, 6)}
    found |= {"survived_friction": round(reached[0], 6), "survived_speed_m_per_s": round(reached[1], 6)}
    gained = reached[0] > search.friction * 1.0001 or reached[1] > search.speed * 1.0001
    search.stalled = 0 if gained else search.stalled + 1
    search.finished = search.stalled > 1
    search.friction, search.speed = reached[0], reached[1]
    search.found = found
    search.swing = swing.model_copy(
        update={"provenance": swing.provenance.model_copy(update={"found": found | {"rounds": search.rounds}})}
    )


def _words(solution: Solution, problem: Problem) -> str:
    if solution.violations:
        return "not feasible: " + "; ".join(map(str, solution.violations[:3]))
    end = "" if solution.success else ", stopped early"
    return f"cost {solution.cost:.4f} after {solution.evaluations} evaluations, {solution.wall_time:.1f} s{end}"
