"""From a scenario to a swing: profile of the turn, collocation, full car, and again until nothing is gained.

Each round takes the profile of the turn from a run of the full car that survived with the present swing, solves the
programme within a trust region of friction (or speed) around that run, and drives the full car with the new swing. The
round is kept if the full car then survives more than before; the search ends when a round gains less than one step.
Trials of a search over friction share their straight (`study_engine.nearest_start`); what it found is driven from rest.
On demand a refinement on the full car follows (`full_model_refinement`), and gains of a tracker (`feedback_gains`).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aerodima.optimisation.sweep.study_engine import RunEngine, SerialRunEngine
from aerodima.optimisation.swing.feedback_gains import with_gains
from aerodima.optimisation.swing.full_car import drive_all, frictions, profile_of, varied
from aerodima.optimisation.swing.full_model_refinement import refined
from aerodima.optimisation.swing.mesh_refinement import refine
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.search_state import (
    SearchOptions,
    SwingSearch,
    begin,
    cars_of,
    keep,
    open_search,
    resumed,
    swing_of_rounds,
)
from aerodima.optimisation.swing.solver import SwingSolution, best_of, multi_start
from aerodima.optimisation.swing.swing_construction import constant_rate_swing, swing_file
from aerodima.optimisation.swing.swing_problem import ReducedMember, SwingLimits, SwingProblem
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import Provenance, SwingFile
from aerodima.workbench.errors import SwingError
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.plants.clearance import make_range_of_motion

DOFS = (1, 2)
SOURCE = "aerodima optimise swing"
"""In the provenance of what comes from here."""
GRID = 4
"""Steps of a round's trust region in which the full car is driven further."""
MOST_LOWER = 8
"""Steps downwards in which a swing is looked for clean from rest."""
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
    checkpoint: str | Path | None = None,
    engine: RunEngine | None = None,
    progress: ProgressLine = silent,
) -> SwingFile:
    """The best swing of a search.

    Args:
        scenario: car and turn; its tyre friction and speed are where the search begins.
        options: what is wanted.
        name: of the swing.
        scenario_name, settings: for the provenance.
        warm_start: a swing to begin with instead of the scenario's controller.
        checkpoint: file that keeps the search between rounds; a search found there goes on. The candidates of a
            refinement are kept beside it.
        engine: where cars are driven and programmes solved; None is this process.
        progress: takes lines of text.

    Raises:
        SwingError: the turn needs no tail, nothing survives it, the swing is released after the turn, the limits leave
            no swing (names the violated constraints), the solver is missing, a warm start for another car.
        EnsembleError: the ensemble of `options.members` cannot be read.
    """
    engine = engine or SerialRunEngine()
    work = _Work.of(scenario, options, name, scenario_name, settings, engine, progress)
    checkpoint = None if checkpoint is None else Path(checkpoint)
    if not options.rounds and not options.polish and warm_start is None:
        raise SwingError("--rounds: 0; allowed: from 1 on, or 0 with --refine")
    if not options.rounds and warm_start is None:
        warm_start = constant_rate_swing(
            name, work.cars[0], length=options.length, knots=options.knots, provenance={"source": SOURCE}
        )
    with open_search(checkpoint, work.cars[0], options) as store:
        search = resumed(store) or begin(work.cars, options, warm_start, engine, progress)
        while not search.finished and search.rounds < options.rounds and work.left() > 0.0:
            work.round(search)
            keep(store, search)
        swing = swing_of_rounds(search, options)
        if options.rounds and (warm_start is None or swing.knots != warm_start.knots):
            swing = work.proved(search, swing)
        if not options.rounds:
            swing = work.renamed(swing, search.speed)
        if options.polish:
            turns = cars_of(varied(scenario, manoeuvre={"speed": search.speed}), options)
            swing = refined(swing, turns, options, engine=engine, checkpoint=checkpoint, progress=progress)
        if options.feedback:
            swing = with_gains(swing, work.cars[0], progress)
        if store is not None:
            store.remove()
    return swing


@dataclass(frozen=True)
class _Work:
    """What all rounds of a search have in common.

    Attributes:
        cars: the scenario with its nominal car, and those of the ensemble.
        origin: fields of the provenance that are known before anything is found.
        deadline: on the clock of `time.perf_counter`, s.
    """

    cars: tuple[Scenario, ...]
    options: SearchOptions
    limits: SwingLimits
    name: str
    origin: dict[str, Any]
    deadline: float
    engine: RunEngine
    progress: ProgressLine

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        options: SearchOptions,
        name: str,
        scenario_name: str,
        settings: tuple[str, ...],
        engine: RunEngine,
        progress: ProgressLine,
    ) -> _Work:
        """As `optimise_swing`."""
        if options.dof not in DOFS:
            raise SwingError(f"--dof: {options.dof}; allowed: {', '.join(map(str, DOFS))}")
        if scenario.manoeuvre.kind not in ("turn", "auto_turn"):
            raise SwingError(f"manoeuvre.kind: {scenario.manoeuvre.kind!r}; allowed: turn, auto_turn")
        if scenario.tail.mode == "none":
            raise SwingError("tail.mode: 'none', the car has no tail to swing; allowed: held, swing")
        release = {} if options.threshold is None else {"trigger_yaw_rate": options.threshold}
        cars = cars_of(varied(scenario, tail={"mode": "swing"}, controller=release), options)
        limits = SwingLimits.of(ReducedCar.of(cars[0]), options.dof, options.torque)
        origin: dict[str, Any] = {
            "source": SOURCE,
            "scenario": scenario_name or None,
            "settings": settings,
            "seed": options.seed,
        }
        origin["options"] = options.stored()
        return cls(cars, options, limits, name, origin, time.perf_counter() + options.wall_time, engine, progress)

    @property
    def rolling(self) -> bool:
        """Whether trials of rounds begin just before the turn: they share a straight where they differ in friction."""
        return self.options.objective == "friction"

    def left(self) -> float:
        """Time until the deadline, s."""
        return self.deadline - time.perf_counter()

    def renamed(self, warm: SwingFile, speed: float) -> SwingFile:
        """A warm start under the name and with the provenance of this search."""
        kept = {key: value for key, value in warm.provenance.found.items() if key in ("collocation_error_rad", "knots")}
        found = kept | {"survived_speed_m_per_s": round(speed, 6)}
        provenance = Provenance(**self.origin, found=found, versions=software_versions())
        return warm.model_copy(update={"name": self.name, "provenance": provenance})

    def round(self, search: SwingSearch) -> None:
        """Solves the programme around the present swing and drives the full car with what is found."""
        options, progress, problem = self.options, self.progress, self._problem(search)
        solutions = multi_start(
            problem, options.seed, options.starts, solver=options.solver, iterations=options.iterations,
            wall_time=max(self.left(), 0.0), engine=self.engine,
            done=lambda k, s: progress(f"  start {k + 1}: {_words(s)}"),
        )  # fmt: skip
        best = best_of(solutions)
        if best.violations:
            search.finished = True
            if search.swing is None:
                raise SwingError("no swing keeps to the limits: " + "; ".join(map(str, best.violations)))
            return
        problem, best, error = refine(
            problem, best, options.bound, wall_time=max(self.left(), 1.0),
            solver=options.solver, iterations=options.iterations,
            progress=lambda n, e: progress(f"  {n} knots: collocation error {e:.4f} rad, finer mesh"),
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
        search.rounds += 1
        swing = swing_file(self.name, problem, best, self.cars[0], provenance=self.origin)
        self._drive(search, swing, found)

    def proved(self, search: SwingSearch, swing: SwingFile) -> SwingFile:
        """The swing with what the full cars survive from rest, if its runs began just before the turn.

        Where they are not clean at the friction of the search, the highest below it, on the grid of a round.
        """
        found = swing.provenance.found
        if not self.rolling:
            return swing
        places = self._places(search, range(0, -MOST_LOWER, -1))
        driven = drive_all(self.cars, swing, places, self.engine)
        for (friction, speed), seen in zip(places, driven, strict=True):
            self.progress(f"  from rest {seen.words(friction, speed)}")
            if seen.clean:
                facts = {"peak_roll_rad": round(seen.peak_roll, 6), "heading_rad": round(seen.heading, 6)}
                facts |= {"survived_friction": round(friction, 6), "survived_speed_m_per_s": round(speed, 6)}
                provenance = swing.provenance.model_copy(update={"found": found | facts})
                return swing.model_copy(update={"provenance": provenance})
        raise SwingError(
            f"no run from rest is clean with the swing found, at frictions from {places[0][0]:.3f} down to "
            f"{places[-1][0]:.3f}; allowed: another --seed, or begin at less friction"
        )

    def _problem(self, search: SwingSearch) -> SwingProblem:
        """The programme around the runs of all cars with the present swing."""
        options, controller = self.options, self.cars[0].controller
        here = [varied(car, manoeuvre={"speed": search.speed}) for car in self.cars]
        rides = [(car, search.swing, grip) for car, grip in zip(here, frictions(here, search.friction), strict=True)]
        profiles = self.engine.call(profile_of, rides)
        members = [ReducedMember(ReducedCar.of(car), one) for car, one in zip(here, profiles, strict=True)]
        centre = {"friction": 1.0, "speed": members[0].profile.speed}.get(options.objective)
        return SwingProblem(
            tuple(members),
            np.linspace(0.0, options.length, options.knots),
            (-controller.hold_angle, controller.pitch_angle)[: options.dof],
            self.limits,
            options.objective,
            (0.0, 1.0) if centre is None else ((1.0 - options.trust) * centre, (1.0 + options.trust) * centre),
            options.wait,
            free_of=make_range_of_motion(self.cars[0], MAP_NODES, MAP_NODES) if options.dof == 2 else None,
        )

    def _places(self, search: SwingSearch, steps: range) -> list[tuple[float, float]]:
        """Frictions and speeds so many steps of the trust region from where the search is, if it is for more."""
        objective = self.options.objective
        grips, paces = objective == "friction", objective == "speed"
        factors = [1.0 + self.options.trust * step / GRID for step in (steps if grips or paces else range(1))]
        return [(search.friction * (f if grips else 1.0), search.speed * (f if paces else 1.0)) for f in factors]

    def _drive(self, search: SwingSearch, swing: SwingFile, found: dict[str, float | int | str]) -> None:
        """Drives the full cars with the swing at higher and higher friction (or speed) up to the trust region."""
        reached, places = None, self._places(search, range(GRID + 1))
        driven = drive_all(self.cars, swing, places, self.engine, rolling=self.rolling)
        for (friction, speed), seen in zip(places, driven, strict=True):
            self.progress(f"  full car {seen.words(friction, speed)}")
            if not seen.clean:
                break
            reached = (friction, speed, seen)
        if reached is None:
            search.finished = True
            if search.swing is None:
                raise SwingError(
                    f"the full car rolls over with the swing at friction {search.friction:.3f}, {search.speed:.2f} "
                    "m/s, where the reduced model does not; allowed: begin at less friction or speed"
                )
            self.progress("  the new swing loses where the old one survived: kept the old one")
            return
        friction, speed, seen = reached
        found |= {"peak_roll_rad": round(seen.peak_roll, 6), "heading_rad": round(seen.heading, 6)}
        found |= {"survived_friction": round(friction, 6), "survived_speed_m_per_s": round(speed, 6)}
        gained = friction > search.friction * 1.0001 or speed > search.speed * 1.0001
        search.stalled = 0 if gained else search.stalled + 1
        search.finished = search.stalled > 1
        search.friction, search.speed = friction, speed
        search.swing = swing.model_copy(
            update={"provenance": swing.provenance.model_copy(update={"found": found | {"rounds": search.rounds}})}
        )


def _words(solution: SwingSolution) -> str:
    if solution.violations:
        return "not feasible: " + "; ".join(map(str, solution.violations[:3]))
    end = "" if solution.success else ", stopped early"
    return f"cost {solution.cost:.4f} after {solution.evaluations} evaluations, {solution.wall_time:.1f} s{end}"
