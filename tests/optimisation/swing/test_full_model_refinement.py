"""The refinement on made-up cars: what it changes, how it ranks, that it finds, repeats itself and goes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from aerodima.optimisation.swing import full_car as full_car_module
from aerodima.optimisation.swing import swing_ranking as candidate_module
from aerodima.optimisation.swing.full_car import FINE_STEP, FRICTION_STEP, Car, DriveOutcome, Reference, shares
from aerodima.optimisation.swing.full_model_refinement import _comparable, refine, refined
from aerodima.optimisation.swing.search_state import SearchOptions
from aerodima.optimisation.swing.swing_construction import PITCH, PLACES, ROLL, changed, changes
from aerodima.optimisation.swing.swing_ranking import (
    Candidate,
    Score,
    between,
    choose,
    most_roll,
    score,
)
from aerodima.optimisation.swing.swing_screening import DRAWN, SwingScreen
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.swing_curve import swing_at
from aerodima.workbench.config.swing_file import SwingFile, read_swing, swing_from_dict
from aerodima.workbench.errors import SwingError, SwingFileError

REFERENCE = Reference(0.675, 0.767)

EARLIER = Path(__file__).parent / "data" / "roll_4_5.yaml"
"""A refined swing of version 0.1.0, for a car of its own."""


def car(reference: Reference = REFERENCE) -> Car:
    return Car(load_scenario("turn_swing").resolved(), reference)


def swing(direction: str = "left") -> SwingFile:
    left = read_swing(EARLIER)
    if direction == "left":
        return left
    data = left.model_dump(mode="json", by_alias=True, exclude_none=True) | {"direction": "right"}
    for name in ("roll_position_rad", "roll_velocity_rad_per_s"):
        data["knots"][name] = [-value for value in data["knots"][name]]
    return swing_from_dict(data)


def unit(place: int, size: float = 1.0, dof: int = 1) -> np.ndarray:
    return size * np.eye(changes(dof))[place]


def test_no_change_keeps_the_motion_and_drops_what_no_longer_fits() -> None:
    before, after = swing(), changed(swing(), np.zeros(changes(1)))
    assert after.trigger.threshold_rad_per_s == before.trigger.threshold_rad_per_s
    assert after.knots.time_s == pytest.approx(before.knots.time_s)
    time = np.linspace(0.0, 1.0, 300)
    assert np.allclose(swing_at(after, time).roll_position, swing_at(before, time).roll_position, atol=0.01)
    assert after.knots.roll_torque_n_m is None
    assert after.gains.feedback is None


def test_changes_do_what_they_say() -> None:
    plain = changed(swing(), np.zeros(changes(1)))
    later, slower = changed(swing(), unit(0)), changed(swing(), unit(1))
    threshold = plain.trigger.threshold_rad_per_s
    assert threshold is not None
    assert later.trigger.threshold_rad_per_s == pytest.approx(threshold * math.exp(0.15))
    assert slower.knots.time_s[-1] == pytest.approx(plain.knots.time_s[-1] * math.exp(0.15))
    moved = changed(swing(), unit(3))  # roll at the second place
    difference = np.array(moved.knots.roll_position_rad) - np.array(plain.knots.roll_position_rad)
    assert difference.max() == pytest.approx(ROLL, abs=0.01)
    assert abs(difference[0]) == abs(difference[-1]) == 0.0


def test_a_right_turn_is_changed_to_the_mirror_image() -> None:
    x = np.linspace(-0.5, 0.5, changes(1))
    left, right = changed(swing(), x), changed(swing("right"), x)
    assert right.knots.roll_position_rad == pytest.approx([-value for value in left.knots.roll_position_rad])


def test_pitch_moves_with_two_joints_from_its_start_on() -> None:
    moved = changed(swing(), unit(2 + len(PLACES), dof=2), dof=2)
    assert moved.knots.pitch_position_rad[0] == pytest.approx(PITCH)
    assert moved.knots.pitch_position_rad[-1] == pytest.approx(0.0)
    assert moved.knots.roll_position_rad == pytest.approx(
        changed(swing(), np.zeros(changes(1))).knots.roll_position_rad
    )


def test_a_change_beyond_the_limits_is_refused_and_ranks_last() -> None:
    with pytest.raises(SwingFileError, match="velocity"):
        changed(swing(), unit(1, -30.0))
    assert score(Candidate(None, (car(),), 0.7)).cost > 5.5


def test_a_swing_without_a_yaw_rate_is_refused() -> None:
    timed = swing().model_copy(update={"trigger": swing().trigger.model_copy(update={"kind": "time"})})
    timed = timed.model_copy(update={"trigger": timed.trigger.model_copy(update={"threshold_rad_per_s": None})})
    with pytest.raises(SwingError, match=r"trigger\.kind"):
        changed(timed, np.zeros(changes(1)))


def ranks(monkeypatch: pytest.MonkeyPatch, at: Callable[[float], DriveOutcome]) -> Score:
    """Score of a car whose outcome is a function of the friction; one that rolls over does so 1 s into the turn."""

    def drive(_scenario: Any, _swing: Any, friction: float, **_options: Any) -> Any:
        roll = np.array([0.0, 0.0, 0.0, 1.0])
        return SimpleNamespace(found=at(friction), time=np.array([0.0, 1.0, 2.0, 3.0]), signal=lambda _name: roll)

    monkeypatch.setattr(candidate_module, "drive", drive)
    monkeypatch.setattr(candidate_module, "outcome", lambda run: run.found)
    return score(Candidate(swing(), (car(),), 0.8))


def test_candidates_rank_by_feasibility_first(monkeypatch: pytest.MonkeyPatch) -> None:
    clean, lost = DriveOutcome(True, True, 0.2, 0.75, 2.1), DriveOutcome(False, False, 1.5, 0.75, 2.1)
    touched, leaning = DriveOutcome(False, True, 0.5, 0.75, 2.1), DriveOutcome(True, True, 0.3, 0.75, 2.1)
    short = DriveOutcome(True, True, 0.02, 0.70, 2.1)
    flat, wide = DriveOutcome(True, True, 0.1, 0.74, 2.1), DriveOutcome(True, True, 0.1, 0.80, 2.1)
    in_order = [
        ranks(monkeypatch, lambda _friction: flat),
        ranks(monkeypatch, lambda _friction: wide),
        ranks(monkeypatch, lambda _friction: clean),
        ranks(monkeypatch, lambda friction: clean if friction < 0.7 else leaning),
        ranks(monkeypatch, lambda friction: touched if 0.7 < friction < 0.8 else clean),
        ranks(monkeypatch, lambda friction: clean if friction < 0.7 else touched),
        ranks(monkeypatch, lambda friction: clean if friction < 0.7 else lost),
        ranks(monkeypatch, lambda _friction: short),
        ranks(monkeypatch, lambda _friction: lost),
    ]
    costs = [one.cost for one in in_order]
    assert costs == sorted(costs)
    assert len(set(costs)) == len(costs)
    assert [one.clean for one in in_order] == [True] * 3 + [False] * 6
    assert in_order[7].heading == pytest.approx(0.70 / 0.767)


def joint(monkeypatch: pytest.MonkeyPatch, *headings: float, lost: float = 2.0) -> tuple[Score, list[float]]:
    """Score on cars that turn so far; the last one rolls over above the friction `lost`. And the frictions driven."""
    driven: list[float] = []
    cars = tuple(
        Car(load_scenario("turn_swing", [f"car.mass={6.0 + place / 10}"]).resolved(), Reference(0.6 + place / 10, 1.0))
        for place in range(len(headings))
    )

    def drive(scenario: Any, _swing: Any, friction: float, **_options: Any) -> Any:
        driven.append(friction)
        place = round(10 * (scenario.car.mass - 6.0))
        clean = place + 1 < len(headings) or friction < lost
        found = DriveOutcome(clean, clean, 0.1, headings[place], 2.1)
        return SimpleNamespace(found=found, time=np.array([0.0, 3.0]), signal=lambda _name: np.array([0.0, 1.0]))

    monkeypatch.setattr(candidate_module, "drive", drive)
    monkeypatch.setattr(candidate_module, "outcome", lambda run: run.found)
    return score(Candidate(swing(), cars, 0.612)), driven


def test_with_several_cars_all_must_turn_and_survive_each_at_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    all_well, driven = joint(monkeypatch, 1.0, 1.1)
    assert all_well.clean
    assert (all_well.heading, all_well.headings) == (1.0, (1.0, 1.1))
    assert driven == pytest.approx([0.6, 0.7, 0.612, 0.714])  # 1.02 times what the published swing survives
    one_short, driven = joint(monkeypatch, 1.0, 0.9)
    assert driven == pytest.approx([0.6, 0.7])  # no target before all of them turn far enough
    both_short, _ = joint(monkeypatch, 0.9, 0.9)
    one_lost, _ = joint(monkeypatch, 1.0, 1.1, lost=0.71)
    assert not one_lost.clean
    assert all_well.cost < one_lost.cost < one_short.cost < both_short.cost
    assert joint(monkeypatch, 0.96)[0].clean
    assert not joint(monkeypatch, 0.96, 0.96)[0].clean  # several cars need a wider margin over 95 %


def test_shares_follow_what_the_published_swing_survives() -> None:
    assert shares([car(Reference(0.5, 1.0)), car(Reference(0.8, 1.0))], 0.6) == pytest.approx([0.6, 0.96])


def test_a_car_that_spins_is_left_out_and_said_so_but_never_the_own_one() -> None:
    lines: list[str] = []
    cars = [car(Reference(0.6, heading)) for heading in (2.0, 0.8, 2.0)]
    assert _comparable(cars, lines.append) == cars[:2]
    assert [("left out" in line) for line in lines] == [False, False, True]


def test_the_margin_of_the_roll_is_that_of_the_tail_on_the_ground_or_of_the_car_on_its_wheels() -> None:
    """A sail's edge at height h, on the side of the wheels: tan(roll) = h / (length - half track)."""
    scenario = load_scenario("turn_swing")
    tail, car = scenario.tail, scenario.car
    touching = math.atan((tail.mount_height - tail.sail_reach) / (tail.length - car.outer_half_track))
    assert most_roll(scenario) == pytest.approx(
        min(touching, math.atan(car.outer_half_track / car.com_height)), abs=0.005
    )
    stub = load_scenario("turn_swing", ["tail.length=0.3", "tail.sail_length=0.2"])
    assert most_roll(stub) == pytest.approx(math.atan(car.outer_half_track / car.com_height))


def test_frictions_between_leave_no_gap() -> None:
    assert between(0.7, 0.7) == between(0.7, 0.72) == []
    row = [0.8, *between(0.7, 0.8), 0.7]
    assert max(-np.diff(row)) <= 0.025 + 1e-9


def test_a_claim_is_an_unbroken_row_at_the_fine_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first swing survives 0.8 but not 0.75; the second up to 0.7625; the third turns too little."""
    first, second, third = (swing().model_copy(update={"name": str(n)}) for n in range(3))

    def drive(scenario: Any, played: Any, friction: float) -> DriveOutcome:
        assert scenario.simulation.step == FINE_STEP
        if played is None:
            return DriveOutcome(friction < 0.681, True, 0.2, 0.8, 2.1)
        clean = {"0": abs(friction - 0.75) > 0.01, "1": friction < 0.77, "2": True}[played.name]
        return DriveOutcome(clean, True, 0.1, 0.7 if played.name == "2" else 0.79, 2.1)

    for module in (candidate_module, full_car_module):
        monkeypatch.setattr(module, "drive", drive)
        monkeypatch.setattr(module, "outcome", lambda found: found)
    cars = [car(Reference(0.7, 0.85))]
    claim = choose((first, second, third), cars, 0.825)
    assert claim is not None
    assert (claim.place, claim.rows[0].friction) == (1, pytest.approx(0.7625))
    assert claim.references[0].friction == pytest.approx(0.675)
    assert claim.gains == (pytest.approx(0.7625 / 0.675),)
    assert claim.heading == pytest.approx(0.79 / 0.8)
    assert choose((third,), cars, 0.825) is None


def test_of_several_cars_the_least_gain_is_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first swing gains 30 % on one car and 2 % on the other, the second 6 % on both."""
    first, second = (swing().model_copy(update={"name": str(n)}) for n in range(2))
    cars = [Car(load_scenario("turn_swing", [f"car.mass={mass}"]).resolved(), Reference(0.5, 1.0)) for mass in (6, 7)]

    def drive(scenario: Any, played: Any, friction: float) -> DriveOutcome:
        light = scenario.car.mass < 6.5
        most = 0.505 if played is None else {"0": 0.66 if light else 0.515, "1": 0.54}[played.name]
        return DriveOutcome(friction < most, True, 0.1, 1.0, 2.1)

    for module in (candidate_module, full_car_module):
        monkeypatch.setattr(module, "drive", drive)
        monkeypatch.setattr(module, "outcome", lambda found: found)
    claim = choose((first, second), cars, 0.65)
    assert claim is not None
    assert claim.place == 1
    assert claim.gains == pytest.approx((1.075, 1.075))


class MadeUpCars:
    """Heading grows with the threshold of the release, the friction survived is highest at a duration of 1.2 s."""

    workers, startup = 1, 0.0

    def __init__(self) -> None:
        self.driven = 0

    def call(self, _function: Any, items: Sequence[Candidate]) -> list[Score]:
        self.driven += len(items)
        return [self._score(item) for item in items]

    @staticmethod
    def _score(item: Candidate) -> Score:
        if item.swing is None:
            return Score(6.0)
        heading = 0.6 + 0.5 * (item.swing.trigger.threshold_rad_per_s or 0.0)
        if heading < 0.955:
            return Score(4.955 - heading, heading)
        survived = 0.9 - abs(item.swing.knots.time_s[-1] - 1.2)
        clean = item.target <= survived
        roll = 0.3 * item.target / survived
        return Score(roll if clean else 2.0 + roll, heading, clean, roll)


def run_refinement(cars: Any, **changes_: Any) -> Any:
    options: dict[str, Any] = {"evaluations": 250, "seed": 4, "engine": cars} | changes_
    return refine(swing(), [car()], **options)


def test_it_finds_most_friction_that_turns_far_enough() -> None:
    assert any(run_refinement(MadeUpCars(), evaluations=count).gaining for count in range(10, 80, 10))
    found = run_refinement(MadeUpCars())
    assert not found.gaining
    best = changed(swing(), found.x)
    assert found.heading >= 0.955
    assert 0.9 - 2 * FRICTION_STEP <= found.friction <= 0.9
    assert best.knots.time_s[-1] == pytest.approx(1.2, abs=0.05)


class Foreseen:
    """A screen that ranks as the cars will."""

    def __init__(self) -> None:
        self.seen = 0

    def costs(self, swings: Sequence[SwingFile], target: float) -> list[float]:
        self.seen += len(swings)
        return [MadeUpCars._score(Candidate(one, (car(),), target)).cost for one in swings]


def test_only_the_best_tenth_of_what_is_screened_is_driven_and_ends_no_worse() -> None:
    alone, screened, screen = MadeUpCars(), MadeUpCars(), Foreseen()
    without = run_refinement(alone, evaluations=60)
    found = run_refinement(screened, evaluations=60, screen=screen)
    generations = math.ceil(screen.seen / (DRAWN * 9))  # nine points to seven changes
    assert screened.driven <= 9 * generations + round((found.friction - REFERENCE.friction) / FRICTION_STEP) + 1
    assert screen.seen > 4 * screened.driven
    assert found.friction > without.friction


def test_it_repeats_itself_and_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    cars, stopped, rest = MadeUpCars(), MadeUpCars(), MadeUpCars()
    whole = run_refinement(cars, evaluations=60)
    with RowStore(tmp_path / "scores.jsonl", {}) as store:
        run_refinement(stopped, evaluations=25, store=store)
    with RowStore(tmp_path / "scores.jsonl", {}) as store:
        again = run_refinement(rest, evaluations=60, store=store)
    assert np.array_equal(whole.x, again.x)
    assert whole.friction == again.friction
    assert (stopped.driven > 20, rest.driven) == (True, cars.driven - stopped.driven)


def test_it_is_told_that_nothing_turns_far_enough() -> None:
    class Straight(MadeUpCars):
        @staticmethod
        def _score(item: Candidate) -> Score:
            return Score(4.5, 0.5)

    found = run_refinement(Straight(), evaluations=20)
    assert found.friction == 0.0


def test_an_interrupted_refinement_goes_on_with_its_own_candidates_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Car, "of", lambda scenario: Car(scenario.resolved(), REFERENCE))
    monkeypatch.setattr(SwingScreen, "of", lambda *_arguments: None)
    monkeypatch.setattr(
        "aerodima.optimisation.swing.full_model_refinement.choose", lambda *_arguments, **_options: None
    )
    checkpoint, cars = tmp_path / "swing.search.json", [load_scenario("turn_swing")]
    kept = tmp_path / "swing.search.polish.json"

    class Interrupted(MadeUpCars):
        def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
            if function is Car.of:
                return [function(item) for item in items]
            if self.driven > 20:
                raise KeyboardInterrupt
            return super().call(function, items)

    class Steady(Interrupted):
        def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
            return [function(i) for i in items] if function is Car.of else MadeUpCars.call(self, function, items)

    options = SearchOptions(polish=40, seed=4, rounds=0)
    with pytest.raises(KeyboardInterrupt):
        refined(swing(), cars, options, engine=Interrupted(), checkpoint=checkpoint)
    driven = len(kept.read_text().splitlines()) - 1
    assert driven > 20
    for other in (replace(options, seed=5), replace(options, dof=2)):
        with pytest.raises(SwingError, match=r"polish\.json: holds results of other parameters, settings or versions"):
            refined(swing(), cars, other, engine=Steady(), checkpoint=checkpoint)
    with pytest.raises(SwingError, match="swing"):
        refined(swing("right"), cars, options, engine=Steady(), checkpoint=checkpoint)
    again, whole = Steady(), Steady()
    refined(swing(), cars, options, engine=again, checkpoint=checkpoint)
    refined(swing(), cars, options, engine=whole)
    assert again.driven == whole.driven - driven
    assert not kept.exists()
    kept.write_text("{}", encoding="utf-8")
    with pytest.raises(SwingError, match="holds results of other"):
        refined(swing(), cars, options, engine=Steady(), checkpoint=checkpoint)
