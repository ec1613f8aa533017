"""A search for a swing between its rounds: where it begins, what it keeps on the disk, and how it goes on."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from aerodima.optimisation.fit.fit_errors import SwingError
from aerodima.optimisation.swing.full_car import Outcome, drive, drive_all, outcome, varied
from aerodima.optimisation.swing.planar_model import lift_roll
from aerodima.optimisation.swing.reduced_car import ReducedCar
from aerodima.optimisation.swing.search_options import SearchOptions, Told
from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.swing_file import SwingFile, car_mismatches, read_swing, write_swing

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


def _key(scenario: Scenario, options: SearchOptions) -> str:
    return json.dumps([scenario.resolved(), options.stored()], sort_keys=True)


def keep(checkpoint: Path | None, search: Search, scenario: Scenario, options: SearchOptions) -> None:
    """Writes the search to its file; nothing without a file or before the first swing."""
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


def resumed(checkpoint: Path | None, scenario: Scenario, options: SearchOptions) -> Search | None:
    """The search that was interrupted; None without one. SwingError for a file that holds something else."""
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
        data["friction"], data["speed"], swing, data["rounds"], dict(swing.provenance.found), data["stalled"],
        data["finished"],
    )  # fmt: skip
