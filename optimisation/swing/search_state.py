"""What may be asked of a search for a swing, and the search between its rounds: begin, keep on the disk, resume."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from aerodima.optimisation.sweep.rollover_threshold import FRICTION
from aerodima.optimisation.sweep.study_engine import RunEngine
from aerodima.optimisation.swing.full_car import drive, drive_all, outcome, varied
from aerodima.optimisation.swing.reduced_car import ReducedCar, lift_roll
from aerodima.optimisation.swing.solver import SolverName
from aerodima.optimisation.swing.swing_problem import Objective
from aerodima.workbench.batch.engine import ProgressLine
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.config.ensemble import load_ensemble
from aerodima.workbench.config.scenario import Scenario, default_values
from aerodima.workbench.config.swing_file import SwingFile
from aerodima.workbench.controllers.law_of_scenario import refuse_other_car
from aerodima.workbench.errors import SwingError
from aerodima.workbench.logs.schema import software_versions

LATER = ("warm_start", "ensemble", "members", "polish", "feedback")
"""Options that do nothing by default; a swing that did without them does not name them."""


@dataclass(frozen=True)
class SearchOptions:
    """Options of a search; stored with the swing, so that it can be repeated.

    Attributes:
        dof: 1 roll, 2 roll and pitch.
        objective: see `swing_problem.SwingProblem`.
        seed, starts: of the random starts of the first round.
        knots: of the first mesh; `length` of the swing from its release, s.
        threshold: yaw rate that releases the swing, rad/s; None keeps the scenario's.
        wait: the tail rests this long after the release, s; 0 leaves it free.
        torque: limit of each motor, N m; None is the motor's.
        rounds: at most this many; 0 only refines: a warm start, or a swing at the
            scenario's constant rate and release.
        trust: how far friction or speed may go beyond those of the profile's run in one round, as a share.
        bound: largest collocation error, rad.
        solver: snopt or ipopt.
        iterations: of the solver; with the seed they make the search repeatable.
        warm_start: name or path of the swing that the search begins with, for the record.
        members: cars drawn from the `ensemble` that the swing must serve as well; 0 is the scenario's car alone.
        polish: candidates of the full-model refinement, under the name that swing files have; 0 is none.
        feedback: gains of a tracker are stored with the swing.
        wall_time: s, of the collocation; a refinement has its own limit, the number of candidates.
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
    warm_start: str = ""
    ensemble: str = "car"
    members: int = 0
    polish: int = 0
    feedback: bool = False
    wall_time: float = 600.0

    def stored(self) -> dict[str, float | int | str]:
        """For the provenance of a swing: everything but the wall time, which decides nothing unless it is over."""
        plain = {field.name: field.default for field in fields(self) if field.name in LATER}
        return {
            key: int(value) if isinstance(value, bool) else value
            for key, value in self.__dict__.items()
            if value is not None and key != "wall_time" and (key not in plain or value != plain[key])
        }


def cars_of(scenario: Scenario, options: SearchOptions) -> tuple[Scenario, ...]:
    """The scenario with its nominal car, and with those of the ensemble at as many times their own friction."""
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


LOWER, MOST_LOWER = 0.92, 8
"""A search that does not survive begins at less friction or speed by this factor, at most so many times."""


@dataclass
class SwingSearch:
    """State of a search between its rounds.

    Attributes:
        friction, speed: at which the profile's run survived.
        swing: of that run; None is the scenario's own controller.
        rounds: done; `stalled` of them, the last ones, gained nothing.
        finished: nothing more was gained.
    """

    friction: float
    speed: float
    swing: SwingFile | None = None
    rounds: int = 0
    stalled: int = 0
    finished: bool = False


def begin(
    cars: tuple[Scenario, ...],
    options: SearchOptions,
    warm: SwingFile | None,
    engine: RunEngine,
    progress: ProgressLine,
) -> SwingSearch:
    """Where the search begins: the highest friction or speed not above the scenario's that all cars survive.

    Args:
        cars: scenarios of the same turn, that of the nominal car first.
        options: of the search.
        warm: swing to begin with.
        engine: where the cars are driven.
        progress: takes lines of text.

    Raises:
        SwingError: the turn needs no tail, nothing survives it, the swing is never released or only after the turn.
        SwingFileError: a warm start for another car.
    """
    scenario = cars[0]
    if warm is not None:
        refuse_other_car(scenario, warm, way_out="")
    car = ReducedCar.of(scenario)
    if options.objective in ("roll", "effort"):
        held = outcome(drive(varied(scenario, tail={"mode": "held"})))
        if held.survived and held.peak_roll < lift_roll(car):
            raise SwingError(
                f"this turn needs no swing: with the tail held the car rolls {held.peak_roll:.3f} rad, its inner "
                f"wheels lift at {lift_roll(car):.3f} rad"
            )
    places = [(scenario.car.tyre_friction, scenario.manoeuvre.speed)]
    lower = {"friction": (LOWER, 1.0), "speed": (1.0, LOWER)}.get(options.objective)
    while lower and len(places) < MOST_LOWER:
        places.append((places[-1][0] * lower[0], places[-1][1] * lower[1]))
    for (friction, speed), trial in zip(places, drive_all(cars, warm, places, engine), strict=True):
        if trial.survived:
            _refuse_late_release(scenario, options, trial.released, friction, speed)
            progress(f"begin at {speed:.2f} m/s, friction {friction:.3f}: peak roll {trial.peak_roll:.3f} rad")
            return SwingSearch(friction, speed, warm)
    lowest = f"{places[-1][1]:.2f} m/s" if options.objective == "speed" else f"friction {places[-1][0]:.3f}"
    raise SwingError(
        f"nothing survives this turn at {scenario.manoeuvre.speed:g} m/s, looked down to {lowest}; "
        "allowed: a slower turn"
    )


def _refuse_late_release(
    scenario: Scenario, options: SearchOptions, released: float | None, friction: float, speed: float
) -> None:
    manoeuvre = scenario.manoeuvre
    if released is None:
        raise SwingError(
            f"trigger: the yaw rate never passes {scenario.controller.trigger_yaw_rate:g} rad/s at "
            f"{speed:g} m/s, friction {friction:g}, so nothing releases the swing; allowed: a lower --threshold"
        )
    end = manoeuvre.turn_start + manoeuvre.turn_hold
    if manoeuvre.kind == "turn" and released + options.wait > end:
        raise SwingError(
            f"trigger: the swing begins at {released + options.wait:.3f} s, after the turn, which ends "
            f"at {end:g} s; allowed: a lower --threshold or a shorter --wait"
        )


def open_rows(
    checkpoint: Path | None, schema: str, identity: dict[str, Any]
) -> AbstractContextManager[RowStore | None]:
    """What a search keeps on the disk, for this process alone; None without a file. SwingError as `RowStore`."""
    if checkpoint is None:
        return nullcontext()
    return RowStore(checkpoint, {"schema": schema, "versions": software_versions(), **identity}, error=SwingError)


def open_search(
    checkpoint: Path | None, scenario: Scenario, options: SearchOptions
) -> AbstractContextManager[RowStore | None]:
    """The rounds of a search, as `open_rows`."""
    identity = {"scenario": scenario.resolved(), "options": options.stored()}
    return open_rows(checkpoint, "aerodima/swing-search/2", identity)


LIMIT_REACHED = "stopped_while_gaining"
"""Under `provenance.found` of a swing: which limit ended a search that still gained."""


def saying_the_limit(swing: SwingFile, limit: str) -> SwingFile:
    """The swing with the limit that ended its search in its provenance; no limit, none."""
    found = {key: value for key, value in swing.provenance.found.items() if key != LIMIT_REACHED}
    found |= {LIMIT_REACHED: limit} if limit else {}
    return swing.model_copy(update={"provenance": swing.provenance.model_copy(update={"found": found})})


def swing_of_rounds(search: SwingSearch, options: SearchOptions) -> SwingFile:
    """What the rounds came to, with the limit that stopped them if they still gained; SwingError without a swing."""
    if search.swing is None:
        raise SwingError(f"no swing found within {options.wall_time:g} s; allowed: a longer wall time")
    if not search.rounds or search.finished or search.stalled:
        return saying_the_limit(search.swing, "")
    limit = f"{search.rounds} rounds" if search.rounds >= options.rounds else f"wall time of {options.wall_time:g} s"
    return saying_the_limit(search.swing, limit)


def keep(store: RowStore | None, search: SwingSearch) -> None:
    """Writes the search to its file; nothing without a file or before the first swing."""
    if store is not None and search.swing is not None:
        row = {name: getattr(search, name) for name in ("friction", "speed", "rounds", "stalled", "finished")}
        store.add(str(search.rounds), row | {"swing": search.swing.model_dump(mode="json", by_alias=True)})


def resumed(store: RowStore | None) -> SwingSearch | None:
    """The search that was interrupted, after its last round; None without one."""
    if store is None or not store.rows:
        return None
    row = list(store.rows.values())[-1]
    swing = SwingFile.model_validate(row["swing"])
    return SwingSearch(**(row | {"swing": swing}))
