"""From a scenario to a swing: profile of the turn, collocation, full car, and again until nothing is gained.

Each round takes the profile of the turn from a run of the full car that survived with the present swing, solves the
programme within a trust region of friction (or speed) around that run, and drives the full car with the new swing. The
round is kept if the full car then survives more than before; the search ends when a round gains less than one step.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from optimisation.errors import SwingError
from optimisation.swing import planar, spatial
from optimisation.swing.full_car import Outcome, drive, outcome, profile_of, varied
from optimisation.swing.mesh import refine
from optimisation.swing.planar import lift_roll
from optimisation.swing.reduced_car import ReducedCar
from optimisation.swing.result import swing_file
from optimisation.swing.solve import Solution, SolverName, best_of, multi_start
from optimisation.swing.transcription import Member, Objective, Problem, SwingLimits, uniform_knots
from workbench.atomic_write import write_atomically
from workbench.scenario import Scenario
from workbench.swing_file import SwingFile, read_swing, write_swing

Told = Callable[[str], None]
_MODELS: dict[int, Any] = {1: planar, 2: spatial}


@dataclass(frozen=True)
class Options:
    """Options of a search; stored with the swing, so that it can be repeated.

    Attributes:
        dof: 1 roll, 2 roll and pitch.
        objective: see `transcription.Problem`.
        seed, starts: of the random starts of the first round.
        knots: of the first mesh; `length` of the swing from its release, s.
        threshold: yaw rate that releases the swing, rad/s; None keeps the scenario's.
        wait: the tail rests this long after the release, s; 0 leaves it free.
        torque: limit of each motor, N m; None is the motor's.
        rounds: at most this many.
        trust: how far friction or speed may go beyond those of the profile's run in one round, as a share.
        bound: largest collocation error, rad.
        solver: snopt or ipopt.
        iterations: of the solver; with the seed they make the search repeatable.
        wall_time: s, of the whole search.
    """

    dof: int = 1
    objective: Objective = "friction"
    seed: int = 1
    starts: int = 4
    knots: int = 41
    length: float = 1.0
    threshold: float | None = None
    wait: float = 0.0
    torque: float | None = None
    rounds: int = 4
    trust: float = 0.08
    bound: float = 5e-3
    solver: SolverName = "snopt"
    iterations: int = 300
    wall_time: float = 600.0

    def stored(self) -> dict[str, float | int | str]:
        """For the provenance of a swing: everything but the wall time, which decides nothing unless it is over."""
        return {key: value for key, value in self.__dict__.items() if value is not None and key != "wall_time"}


@dataclass
class Search:
    """State of a search between its rounds.

    Attributes:
        friction, speed: at which the profile's run survived.
        swing: of that run; None is the scenario's own controller.
        rounds: done; `stalled` of them, the last ones, gained nothing.
        found: figures for the provenance.
        finished: nothing more was gained.
    """

    friction: float
    speed: float
    swing: SwingFile | None = None
    rounds: int = 0
    found: dict[str, float] = field(default_factory=dict)
    stalled: int = 0
    finished: bool = False


def optimise_swing(
    scenario: Scenario,
    options: Options,
    *,
    name: str,
    scenario_name: str = "",
    settings: tuple[str, ...] = (),
    warm_start: SwingFile | None = None,
    checkpoint: Path | None = None,
    told: Told = lambda _line: None,
) -> SwingFile:
    """The best swing of a search.

    Args:
        scenario: car and turn; its tyre friction and speed are where the search begins.
        options: what is wanted.
        name: of the swing.
        scenario_name, settings: for the provenance.
        warm_start: a swing to begin with instead of the scenario's controller.
        checkpoint: file that keeps the search between rounds; a search found there goes on.
        told: progress, line by line.

    Raises:
        SwingError: the turn needs no tail, nothing survives it, the swing is released after the turn, the limits leave
            no swing (names the violated constraints), the solver is missing, a warm start for another car.
    """
    deadline = time.perf_counter() + options.wall_time
    if options.dof not in _MODELS:
        raise SwingError(f"--dof: {options.dof}; allowed: {', '.join(map(str, _MODELS))}")
    if scenario.manoeuvre.kind not in ("turn", "auto_turn"):
        raise SwingError(f"manoeuvre.kind: {scenario.manoeuvre.kind!r}; allowed: turn, auto_turn")
    if options.threshold is not None:
        scenario = varied(scenario, controller={"trigger_yaw_rate": options.threshold})
    scenario = varied(scenario, tail={"mode": "swing"})
    car = ReducedCar.of(scenario)
    limits = SwingLimits.of(car, options.dof, options.torque)
    search = _resumed(checkpoint, scenario, options) or _first(scenario, options, car, warm_start, told)
    while not search.finished and search.rounds < options.rounds and time.perf_counter() < deadline:
        _round(search, scenario, options, car, limits, name, scenario_name, settings, deadline, told)
        _keep(checkpoint, search, scenario, options)
    if search.swing is None:
        raise SwingError(f"no swing found within {options.wall_time:g} s; allowed: a longer wall time")
    if checkpoint is not None:
        checkpoint.unlink(missing_ok=True)
    return search.swing


def _first(scenario: Scenario, options: Options, car: ReducedCar, warm: SwingFile | None, told: Told) -> Search:
    """Where the search begins: the highest friction or speed not above the scenario's that survives."""
    if warm is not None:
        _refuse_other_car(warm, scenario)
    held = outcome(drive(varied(scenario, tail={"mode": "held"})))
    if options.objective in ("roll", "effort") and held.survived and held.peak_roll < lift_roll(car):
        raise SwingError(
            f"this turn needs no swing: with the tail held the car rolls {held.peak_roll:.3f} rad, its inner wheels "
            f"lift at {lift_roll(car):.3f} rad"
        )
    friction, speed = scenario.car.tyre_friction, scenario.manoeuvre.speed
    for _ in range(8):
        trial = _run(scenario, warm, friction, speed)
        if trial.survived:
            if trial.released is None:
                raise SwingError(
                    f"trigger: the yaw rate never passes {scenario.controller.trigger_yaw_rate:g} rad/s at "
                    f"{speed:g} m/s, friction {friction:g}, so nothing releases the swing; allowed: a lower --threshold"
                )
            end = scenario.manoeuvre.turn_start + scenario.manoeuvre.turn_hold
            if scenario.manoeuvre.kind == "turn" and trial.released + options.wait > end:
                raise SwingError(
                    f"trigger: the swing begins at {trial.released + options.wait:.3f} s, after the turn, which ends "
                    f"at {end:g} s; allowed: a lower --threshold or a shorter --wait"
                )
            told(f"begin at {speed:.2f} m/s, friction {friction:.3f}: peak roll {trial.peak_roll:.3f} rad")
            return Search(friction, speed, warm)
        if options.objective == "speed":
            speed *= 0.92
        elif options.objective == "friction":
            friction *= 0.92
        else:
            break
    lowest = f"{speed:.2f} m/s" if options.objective == "speed" else f"friction {friction:.3f}"
    raise SwingError(
        f"nothing survives this turn at {scenario.manoeuvre.speed:g} m/s, looked down to {lowest}; "
        "allowed: a slower turn"
    )


def _run(scenario: Scenario, swing: SwingFile | None, friction: float, speed: float) -> Outcome:
    return outcome(drive(varied(scenario, manoeuvre={"speed": speed}), swing, friction))


def _round(
    search: Search,
    scenario: Scenario,
    options: Options,
    car: ReducedCar,
    limits: SwingLimits,
    name: str,
    scenario_name: str,
    settings: tuple[str, ...],
    deadline: float,
    told: Told,
) -> None:
    here = varied(scenario, manoeuvre={"speed": search.speed})
    trial = drive(here, search.swing, search.friction, all_signals=True)
    profile = profile_of(trial, here, search.friction, scenario.manoeuvre.turn_start)
    ends = {"friction": (1.0 - options.trust, 1.0 + options.trust)}
    ends["speed"] = ((1.0 - options.trust) * profile.speed, (1.0 + options.trust) * profile.speed)
    start = (-scenario.controller.hold_angle, scenario.controller.pitch_angle)[: options.dof]
    problem = Problem(
        _MODELS[options.dof],
        (Member(car, profile),),
        uniform_knots(options.length, options.knots),
        start,
        limits,
        options.objective,
        ends.get(options.objective, (0.0, 1.0)),
        options.wait,
    )
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
    found = {
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
            "source": "aerodima optimise swing", "scenario": scenario_name or None, "settings": settings,
            "seed": options.seed, "options": options.stored(), "found": found,
        },
    )  # fmt: skip
    search.rounds += 1
    _climb(search, scenario, options, swing, found, told)


def _climb(
    search: Search, scenario: Scenario, options: Options, swing: SwingFile, found: dict[str, Any], told: Told
) -> None:
    """Drives the full car with the swing at higher and higher friction (or speed) up to the trust region."""
    steps = 1.0 + options.trust * np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    if options.objective not in ("friction", "speed"):
        steps = steps[:1]
    reached = None
    for step in steps:
        friction = search.friction * (step if options.objective == "friction" else 1.0)
        speed = search.speed * (step if options.objective == "speed" else 1.0)
        run = _run(scenario, swing, friction, speed)
        told(
            f"  full car at {speed:.2f} m/s, friction {friction:.3f}: "
            f"{'clean' if run.clean else 'survived' if run.survived else 'rolled over'}, peak {run.peak_roll:.3f} rad"
        )
        if not run.clean:
            break
        reached = (friction, speed, run)
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


def _refuse_other_car(warm: SwingFile, scenario: Scenario) -> None:
    from workbench.swing_file import car_mismatches

    lines = car_mismatches(warm, scenario.resolved())
    if lines:
        raise SwingError(f"warm start {warm.name}: for another car: {'; '.join(lines)}")


def _key(scenario: Scenario, options: Options) -> str:
    return json.dumps([scenario.resolved(), options.stored()], sort_keys=True)


def _keep(checkpoint: Path | None, search: Search, scenario: Scenario, options: Options) -> None:
    if checkpoint is None or search.swing is None:
        return
    swing_path = checkpoint.with_suffix(".swing.yaml")
    write_swing(search.swing, swing_path, force=True)
    data = {
        "key": _key(scenario, options), "friction": search.friction, "speed": search.speed,
        "rounds": search.rounds, "stalled": search.stalled, "finished": search.finished,
        "swing": swing_path.read_text(encoding="utf-8"),
    }  # fmt: skip
    swing_path.unlink()

    def write(path: Path) -> None:
        path.write_text(json.dumps(data), encoding="utf-8")

    write_atomically(checkpoint, write, True, SwingError)


def _resumed(checkpoint: Path | None, scenario: Scenario, options: Options) -> Search | None:
    """The search that was interrupted; None without one. Another search in the file is an error."""
    if checkpoint is None or not checkpoint.exists():
        return None
    try:
        data = json.loads(checkpoint.read_text(encoding="utf-8"))
        key = data["key"]
    except (ValueError, KeyError, TypeError):
        raise SwingError(f"{checkpoint}: is no interrupted search; allowed: remove it, or another --out") from None
    if key != _key(scenario, options):
        raise SwingError(f"{checkpoint}: holds a search with other settings; allowed: remove it, or another --out")
    path = checkpoint.with_suffix(".swing.yaml")
    path.write_text(data["swing"], encoding="utf-8")
    swing = read_swing(path)
    path.unlink()
    return Search(
        data["friction"], data["speed"], swing, data["rounds"], stalled=data["stalled"], finished=data["finished"]
    )
