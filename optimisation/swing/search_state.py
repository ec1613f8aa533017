"""A search for a swing between its rounds: where it begins, what it keeps on the disk, and how it goes on."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aerodima.optimisation.fit.fit_errors import SwingError
from aerodima.optimisation.swing.full_car import Outcome, drive, drive_all, outcome, varied
from aerodima.optimisation.swing.planar_model import lift_roll
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.search_options import SearchOptions, Told
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SwingFile, car_mismatches
from aerodima.workbench.logs.schema import software_versions

LOWER, MOST_LOWER = 0.92, 8
"""A search that does not survive begins at less friction or speed by this factor, at most so many times."""


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
    found: dict[str, float | int | str] = field(default_factory=dict)
    stalled: int = 0
    finished: bool = False


def begin(cars: tuple[Scenario, ...], options: SearchOptions, warm: SwingFile | None, told: Told) -> Search:
    """Where the search begins: the highest friction or speed not above the scenario's that all cars survive.

    Args:
        cars: scenarios of the same turn, that of the swing's own car first.
        options: of the search.
        warm: swing to begin with.
        told: progress, line by line.

    Raises:
        SwingError: the turn needs no tail, nothing survives it, the swing is never released or only after the turn, a
            warm start for another car.
    """
    scenario = cars[0]
    if warm is not None:
        _refuse_other_car(warm, scenario)
    car = ReducedCar.of(scenario)
    if options.objective in ("roll", "effort"):
        held = outcome(drive(varied(scenario, tail={"mode": "held"})))
        if held.survived and held.peak_roll < lift_roll(car):
            raise SwingError(
                f"this turn needs no swing: with the tail held the car rolls {held.peak_roll:.3f} rad, its inner "
                f"wheels lift at {lift_roll(car):.3f} rad"
            )
    friction, speed = scenario.car.tyre_friction, scenario.manoeuvre.speed
    for _ in range(MOST_LOWER):
        trial = run(cars, warm, friction, speed)
        if trial.survived:
            _refuse_late_release(scenario, options, trial.released, friction, speed)
            told(f"begin at {speed:.2f} m/s, friction {friction:.3f}: peak roll {trial.peak_roll:.3f} rad")
            return Search(friction, speed, warm)
        if options.objective == "speed":
            speed *= LOWER
        elif options.objective == "friction":
            friction *= LOWER
        else:
            break
    lowest = f"{speed:.2f} m/s" if options.objective == "speed" else f"friction {friction:.3f}"
    raise SwingError(
        f"nothing survives this turn at {scenario.manoeuvre.speed:g} m/s, looked down to {lowest}; "
        "allowed: a slower turn"
    )


def run(cars: tuple[Scenario, ...], swing: SwingFile | None, friction: float, speed: float) -> Outcome:
    """The worst of all cars at a friction and a speed (m/s)."""
    return drive_all([varied(car, manoeuvre={"speed": speed}) for car in cars], swing, friction)


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


def _refuse_other_car(warm: SwingFile, scenario: Scenario) -> None:
    lines = car_mismatches(warm, scenario.resolved())
    if lines:
        raise SwingError(f"warm start {warm.name}: for another car: {'; '.join(lines)}")


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


def keep(store: RowStore | None, search: Search) -> None:
    """Writes the search to its file; nothing without a file or before the first swing."""
    if store is not None and search.swing is not None:
        row = {name: getattr(search, name) for name in ("friction", "speed", "rounds", "stalled", "finished")}
        store.add(str(search.rounds), row | {"swing": search.swing.model_dump(mode="json", by_alias=True)})


def resumed(store: RowStore | None) -> Search | None:
    """The search that was interrupted, after its last round; None without one."""
    if store is None or not store.rows:
        return None
    row = list(store.rows.values())[-1]
    swing = SwingFile.model_validate(row["swing"])
    return Search(**(row | {"swing": swing, "found": dict(swing.provenance.found)}))
