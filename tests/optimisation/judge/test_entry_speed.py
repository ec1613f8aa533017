"""Climbs on made-up cars, whose failures are known; and one on a real car."""

import math
from dataclasses import replace

import pytest

from aerodima.optimisation import find_entry_speeds
from aerodima.optimisation.judge.candidate import HELD, LOW_BALLAST, NO_TAIL, Candidate
from aerodima.optimisation.judge.entry_rule import failed_rule
from aerodima.optimisation.judge.entry_search import MAX_STEP_BACKS, EntrySearch
from aerodima.optimisation.judge.entry_speed import NO_REFERENCE, Manoeuvre, Surface
from aerodima.optimisation.studies.rollover_threshold import SPEED
from aerodima.optimisation.studies.runs import CachedRunner
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.scenario.ensemble import Member
from tests.refusals import assert_refused

SEARCH = EntrySearch(start=2.0, ceiling=4.0)


def climbed(fails, search=SEARCH):
    """What failed at each speed of a climb, in the order in which they were run; none is run
    twice.
    """
    found = {}
    while speeds := search.next_speeds(found):
        (speed,) = speeds
        assert speed not in found
        found[speed] = fails(speed)
    return found


def above(limit, failure="two wheels"):
    return lambda speed: failure if speed > limit else ""


def passes(low, high, otherwise):
    """What fails beyond two speeds, and below them."""
    return lambda speed: "" if low < speed < high else otherwise(speed)


def lacking(limit):
    """Too little lateral acceleration up to a limit, two wheels beyond it."""
    return lambda speed: "two wheels" if speed > limit else "lateral"


@pytest.mark.parametrize(
    ("fails", "entry", "ended_by", "tried"),
    [
        (above(2.57), 2.55, "two wheels", None),
        (above(2.55), 2.55, "two wheels", None),
        (above(2.53), 2.5, "two wheels", None),
        (above(2.27), 2.25, "two wheels", [2.0, 2.1, 2.2, 2.3, 2.25]),
        (above(2.0), 2.0, "two wheels", [2.0, 2.1, 2.05]),
        (above(1.72, "flipped"), 1.7, "flipped", [2.0, 1.9, 1.8, 1.7, 1.75]),
        (above(0.9, "ground"), None, "ground", None),
        (above(9.0), 4.0, "", None),
        # The first failure ends a climb though the car survives beyond it.
        (lambda speed: "ground" if 2.28 < speed < 2.35 else "", 2.25, "ground", None),
        # A lack of lateral acceleration is passed on the way up, and ends a climb beyond.
        (passes(2.35, 2.72, lambda _: "lateral"), 2.7, "lateral", None),
        (passes(2.35, 2.42, lacking(2.42)), 2.4, "two wheels", None),
        (lacking(2.3), None, "lateral", None),
        (lacking(9.0), None, "lateral", None),
    ],
)
def test_a_climb_ends_below_its_first_failure(fails, entry, ended_by, tried):
    """In tenths to the failure, then in the middle of the last one, whose halves are twentieths."""
    found = climbed(fails)
    assert (SEARCH.entry_speed(found), SEARCH.ended_by(found)) == (entry, ended_by)
    assert tried in (None, list(found))
    assert min(found) >= 1.0
    assert max(found) <= 4.0


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"start": 2.03}, ("start", "2.03", "0.05")),
        ({"start": 2.0, "ceiling": 1.5}, ("start", "2", "1.5")),
        ({"step": 0.01}, ("step", "0.01", "0.05")),
    ],
)
def test_speeds_off_the_grid_or_out_of_order_are_refused(wrong, named):
    assert_refused(lambda: EntrySearch(**wrong), SweepError, *named)


def test_the_fine_step_lowers_the_speed_until_it_is_confirmed_but_not_for_ever():
    found = {}
    while speeds := SEARCH.next_confirmations(2.0, found):
        found[speeds[0]] = "" if speeds[0] < 1.87 else "ground"
    assert list(found) == [2.0, 1.95, 1.9, 1.85]
    lost = {}
    while speeds := SEARCH.next_confirmations(3.0, lost):
        lost[speeds[0]] = "ground"
    assert len(lost) == MAX_STEP_BACKS + 1
    assert min(lost) == pytest.approx(3.0 - MAX_STEP_BACKS * 0.05)
    assert SEARCH.next_confirmations(1.0, {1.0: "ground"}) == [], "below the lowest speed"
    assert SEARCH.next_confirmations(None, {}) == []


CLEAN = {"outcome": "survived", "error": "", "side_lift_m": 0.004, "touched_when_steered": ""}
KEPT = CLEAN | {"off_path_m": -0.01, "path_end_reached": True}


@pytest.mark.parametrize(
    ("row", "failure"),
    [
        ({}, ""),
        ({"side_lift_m": 0.006}, "two wheels"),
        ({"side_lift_m": math.nan}, "two wheels"),
        (
            {"side_lift_m": 0.006, "touched_when_steered": "board", "outcome": "flipped"},
            "two wheels",
        ),
        ({"touched_when_steered": "board"}, "ground: board"),
        ({"outcome": "flipped"}, "flipped"),
        ({"outcome": None, "error": "NaN"}, "error: NaN"),
        ({"side_lift_m": None}, "error: the row has no side_lift_m"),
    ],
)
@pytest.mark.parametrize("rule", ["lateral", "path"])
def test_each_rule_has_its_name(row, failure, rule):
    assert failed_rule(KEPT | row, rule, 5.0, 4.5) == failure


@pytest.mark.parametrize(
    ("last", "failure"), [(0.11, "exit"), (-0.11, "exit"), (-0.09, ""), (None, "")]
)
def test_a_car_goes_straight_again_unless_it_is_steered_to_the_end(last, failure):
    row = KEPT | {"last_yaw_rate_rad_per_s": last}
    assert failed_rule(row, "lateral", 5.0, 4.5) == failure
    assert failed_rule(row, "path", 5.0, 4.5) == ""


def test_lateral_acceleration_counts_beside_paths_alone():
    assert failed_rule(CLEAN, "lateral", 4.51, 4.5) == ""
    assert failed_rule(CLEAN, "lateral", 4.49, 4.5) == "lateral"
    assert failed_rule(CLEAN, "lateral", math.nan, 4.5) == "lateral"
    assert failed_rule(KEPT | {"off_path_m": 0.0}, "path", 0.0, 4.5) == ""


@pytest.mark.parametrize(
    ("off", "end"), [(0.01, True), (0.01, False), (-0.01, False), (None, True), (math.nan, True)]
)
def test_a_path_is_kept_to_its_end(off, end):
    expected = "end of the path" if off == -0.01 else "path"
    row = CLEAN | {"off_path_m": off, "path_end_reached": end}
    assert failed_rule(row, "path", 0.0, 0.0) == expected
    assert "no off_path_m" in failed_rule(CLEAN, "path", 0.0, 0.0)


LIMIT = {"none": 2.3, "held": 2.83, "swing": 2.62}
"""Speed above which two wheels lift, m/s."""
LOWERED = {"none": 0.0, "held": 0.1, "swing": 0.0}
"""How much lower it is at the fine step, m/s."""
TURNS = {"none": 1.0, "held": 1.0, "swing": 0.82}
"""Lateral acceleration over speed, 1/s."""
PEAKS = {}
"""Lateral acceleration of the car without tail at some speeds, m/s2."""
SWING = Candidate("swings", ("tail.mode=swing", "controller.swing_file=none"))
BROKEN = Candidate(
    "broken", ("tail.mode=swing", "controller.swing_file=none", "controller.swing_speed=7.0")
)
TURN = Manoeuvre("turn", "turn_none")
CASE = (Member("light", 1.0, {"car.mass": 6.5}), Surface("own"))


class MadeUp(Engine):
    """Survival and lateral acceleration by tail and speed; the heavy car lifts its wheels at any
    speed.
    """

    def __init__(self):
        self.tasks = []

    def map(self, work, tasks, done=None, lost=None):
        rows = []
        for index, task in enumerate(tasks):
            self.tasks.append(task)
            settings = dict(setting.partition("=")[::2] for setting in task.settings)
            speed = float(settings[SPEED])
            mode = settings["tail.mode"]
            limit = 0.0 if settings["car.mass"] == "7.5" else LIMIT[mode]
            limit -= LOWERED[mode] * (settings["simulation.step"] == "0.0005")
            row = CLEAN | {"side_lift_m": 0.02 if speed > limit else -0.001}
            figure = PEAKS.get(speed) if mode == "none" else None
            row |= {"lateral_acceleration_m_per_s2": figure or speed * TURNS[mode]}
            if "controller.swing_speed" in settings and speed > 2.35:
                row = {"outcome": None, "error": "it broke"}
            rows.append(row)
            if done is not None:
                done(index, row)
        return rows


def entries(candidates, cases=(CASE,), manoeuvres=(TURN,)):
    engine = MadeUp()
    table = find_entry_speeds(manoeuvres, candidates, cases, CachedRunner(engine), SEARCH)
    names = [(task.scenario, task.settings) for task in engine.tasks]
    assert len(names) == len(set(names)), "a run is made once"
    return table.set_index("candidate"), engine


def test_entry_speeds_are_those_that_the_fine_step_confirms():
    table, _ = entries([NO_TAIL, HELD])
    assert list(table.index) == ["no tail", "held"]
    assert table.loc["no tail", "entry_speed_m_per_s"] == 2.3
    assert table.loc["no tail", "figure_m_per_s2"] == pytest.approx(2.3)
    held = table.loc["held"]
    assert (held["found_m_per_s"], held["entry_speed_m_per_s"]) == (2.8, 2.7)
    assert (held["ended_by"], held["proved"], held["at_ceiling"]) == ("two wheels", True, False)
    assert (held["car"], held["floor"], held["manoeuvre"]) == ("light", "own", "turn")


def test_a_speed_is_completed_where_one_of_several_drivers_completes_it():
    """Heavy steering lifts at any speed: the first driver serves no candidate, the second one all
    of them.
    """
    poor = ("car.mass=7.5",)
    good = ("car.mass=6.5",)
    table, engine = entries([HELD], manoeuvres=[replace(TURN, drivers=(poor, good))])
    assert list(table["entry_speed_m_per_s"]) == [2.3, 2.7]
    assert list(table["driver"]) == list(good) * 2
    climbs = [
        task
        for task in engine.tasks
        if task.name.startswith("turn no tail") and "0.002" in str(task.settings)
    ]
    speeds = [
        (float(task.settings[-1].partition("=")[2]), poor[0] in task.settings) for task in climbs
    ]
    assert speeds[:3] == [(2.0, True), (2.0, False), (2.1, False)], (
        "the one that completed a speed is the first"
    )
    assert speeds[-2:] == [(2.35, False), (2.35, True)], "a speed fails where all drivers fail"


@pytest.mark.parametrize(("turns", "entry"), [(0.82, 2.6), (0.80, 2.6), (0.79, None), (0.5, None)])
def test_a_tail_must_turn_as_much_as_nine_tenths_of_the_car_without(monkeypatch, turns, entry):
    """0.9 of the 2.3 m/s2 of the car without tail: at 0.80 from 2.59 m/s on, at 0.79 from 2.62 on,
    where the wheels lift.
    """
    monkeypatch.setitem(TURNS, "swing", turns)
    table, _ = entries([SWING])
    row = table.loc["swings"]
    if entry is None:
        assert math.isnan(row["entry_speed_m_per_s"])
        assert (row["ended_by"], row["proved"]) == ("lateral", False)
    else:
        assert row["entry_speed_m_per_s"] == entry


@pytest.mark.parametrize(("peak", "entry"), [(2.99, 2.7), (3.02, None)])
def test_the_reference_is_the_most_that_the_car_without_tail_reaches(monkeypatch, peak, entry):
    """It slides beyond 2.1 m/s; a held tail, 2.7 m/s2 at its entry speed, is measured by the peak
    at that slower speed.
    """
    monkeypatch.setitem(PEAKS, 2.1, peak)
    found = entries([HELD])[0].loc["held", "entry_speed_m_per_s"]
    assert (None if math.isnan(found) else found) == entry


def test_what_the_car_without_tail_reaches_beyond_its_entry_speed_does_not_count(monkeypatch):
    """The fine step lowers its entry speed to 2.2 m/s; at 2.3 m/s the ordinary step had 9 m/s2."""
    monkeypatch.setitem(LOWERED, "none", 0.09)
    monkeypatch.setitem(PEAKS, 2.3, 9.0)
    table, _ = entries([HELD])
    assert table.loc["no tail", "entry_speed_m_per_s"] == 2.2
    assert table.loc["held", "entry_speed_m_per_s"] == 2.7


def test_a_run_that_comes_to_nothing_is_named_and_stops_no_other_climb():
    table, _ = entries([BROKEN, HELD])
    assert table.loc["held", "entry_speed_m_per_s"] == 2.7
    assert table.loc["broken", "ended_by"] == "error: it broke"


def test_without_an_entry_speed_of_the_car_without_tail_there_is_no_reference():
    heavy = (Member("heavy", 1.0, {"car.mass": 7.5}), Surface("own"))
    table, engine = entries([HELD], [heavy, CASE])
    assert list(table[table["car"] == "heavy"]["ended_by"]) == ["two wheels", NO_REFERENCE]
    assert not [task for task in engine.tasks if "held heavy" in task.name]
    assert table[table["car"] == "light"].loc["held", "entry_speed_m_per_s"] == 2.7


def test_the_ceiling_is_no_higher_than_the_drive_gets():
    slow = (CASE[0], Surface("own", ("drive.throttle_gain=4.37",)))
    row = entries([], [slow])[0].loc["no tail"]
    assert (row["entry_speed_m_per_s"], row["at_ceiling"], row["ended_by"]) == (2.15, True, "")


def test_ballast_is_that_of_the_car_and_comes_after_its_settings():
    _, engine = entries([LOW_BALLAST])
    task = next(task for task in engine.tasks if LOW_BALLAST.name in task.name)
    masses = [setting for setting in task.settings if setting.startswith("car.mass=")]
    assert masses[0] == "car.mass=6.5"
    assert float(masses[-1].partition("=")[2]) > 6.5


@pytest.mark.slow
def test_a_slow_real_car_completes_its_turn_and_yaws_into_it():
    short = ("speed_ramp=0.4", "turn_start=0.6", "turn_hold=0.1", "duration=1.3", "direction=right")
    turn = Manoeuvre("turn", "turn_none", tuple(f"manoeuvre.{setting}" for setting in short))
    search = EntrySearch(start=1.0, lowest=1.0, ceiling=1.0)
    table = find_entry_speeds(
        [turn], [], [(Member("own", 1.0, {}), Surface("own"))], CachedRunner(), search
    )
    row = table.iloc[0]
    assert (row["entry_speed_m_per_s"], row["at_ceiling"], row["runs"]) == (1.0, True, 2)
    assert 0.2 < row["figure_m_per_s2"] < 2.5, (
        "v2 / R of 0.28 m wheelbase at 30 degrees, on the way to it, is 2"
    )
