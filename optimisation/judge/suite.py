"""The suite of manoeuvres by name, the two tails, and the candidates, which are never mixed with
another tail's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from aerodima.optimisation.judge.candidate import (
    BEST_SWING,
    HELD,
    LOW_BALLAST,
    NO_TAIL,
    THESIS,
    Candidate,
    own_law,
    read_candidates,
    refuse_twice,
)
from aerodima.optimisation.judge.entry_speed import EntryFloor, Manoeuvre
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.scenario.ensemble import Member
from aerodima.workbench.scenario.scenario import load_scenario

DRIVERS = tuple(
    (
        f"manoeuvre.driver_preview={preview}",
        f"manoeuvre.driver_correction={correction}",
        f"manoeuvre.driver_lag={lag}",
    )
    for preview, correction, lag in (
        (0.28, 1.2, 0.1),
        (0.28, 2.4, 0.1),
        (0.28, 0.4, 0.15),
        (0.24, 0.8, 0.15),
    )
)
"""Four of 90 drivers that together serve six reduced training cars best on both paths (no tail, low
ballast, tail lying, feedback law)."""
MANOEUVRES = {
    "turn": Manoeuvre("turn", "entry_turn"),
    "held-turn": Manoeuvre("held turn", "entry_held_turn"),
    "twice": Manoeuvre("twice", "entry_twice"),
    "twice-late": Manoeuvre(
        "twice, 2 s apart", "entry_twice", ("manoeuvre.turn_gap=2.0", "manoeuvre.duration=6.5")
    ),
    "fishhook": Manoeuvre("fishhook", "entry_fishhook"),
    "lane-change": Manoeuvre("lane change", "entry_lane_change", rule="path", drivers=DRIVERS),
    "slalom": Manoeuvre("slalom", "entry_slalom"),
    "corner": Manoeuvre("corner", "entry_corner", rule="path", drivers=DRIVERS),
    "rising-steer": Manoeuvre("rising steer", "entry_rising_steer"),
}
"""By the name that asks for one."""
TRAINED_ON = ("turn", "held-turn", "fishhook", "lane-change")
"""Manoeuvres that a search of a law sees; all others, and the test cars, are never seen by one."""
FEEDBACK = Candidate("feedback", ("tail.mode=swing", "controller.law=feedback"))
_STILL = tuple(f"feedback.{gain}_gain=0" for gain in ("lean", "roll", "roll_rate", "yaw_rate"))
UPRIGHT = Candidate("upright and still", (*FEEDBACK.settings, *_STILL, "feedback.pitch_angle=0"))
LYING = Candidate("lying back and still", (*FEEDBACK.settings, *_STILL))
CANDIDATES = {
    "none": NO_TAIL,
    "low-ballast": LOW_BALLAST,
    "held": HELD,
    "upright": UPRIGHT,
    "lying": LYING,
    "published": THESIS,
    "feedback": FEEDBACK,
}
"""By the name that asks for one; all of them unless somebody asks for others."""
NAMED = {**CANDIDATES, "best_swing": BEST_SWING}
"""All that a name asks for."""
AT_ONCE = ("controller.delay=0.0",)
"""Laws are compared without the delay of the published one, which belongs to that law and not to
the car."""
TAILS = {"built": None, "designed": "turn_designed"}
"""Scenario that a tail is taken from; the built one is that of each car."""
OF_THE_MOUNT = ("mode", "roll_stop", "mount_height", "mount_x")
"""Numbers of a tail that stay those of the manoeuvre and the car."""


def manoeuvres(names: Sequence[str], tail: str) -> list[Manoeuvre]:
    """Manoeuvres by name with one of the `TAILS`.

    Raises:
        SweepError: no such manoeuvre or tail; one named twice.
    """
    if tail not in TAILS:
        raise SweepError(f"tail {tail!r}: {nearest(tail, list(TAILS))}")
    for name in names:
        if name not in MANOEUVRES:
            raise SweepError(f"manoeuvre {name!r}: {nearest(name, list(MANOEUVRES))}")
    refuse_twice(list(names), "manoeuvre")
    source = TAILS[tail]
    own: tuple[str, ...] = ()
    if source is not None:
        values = dict(load_scenario(source).tail)
        own = tuple(
            f"tail.{key}={value}" for key, value in values.items() if key not in OF_THE_MOUNT
        )
    found = [MANOEUVRES[name] for name in names]
    return [replace(one, settings=(*one.settings, *AT_ONCE, *own)) for one in found]


def candidates(names: Sequence[str], laws: Sequence[str] = ()) -> list[Candidate]:
    """Candidates of `read_candidates` and `own_law`; the car without tail is the first one."""
    scenario = MANOEUVRES["turn"].scenario
    found = [
        *read_candidates(names, NAMED, scenario),
        *(own_law(place, scenario) for place in laws),
    ]
    refuse_twice([one.name for one in found], "candidate")
    return found


def floors(cars: Sequence[Member], shares: Sequence[float]) -> list[tuple[Member, EntryFloor]]:
    """Cars on floors whose friction is a share of the car's own.

    Raises:
        SweepError: a share out of range, or one that is named twice.
    """
    refuse_twice([f"{share:g}" for share in shares], "floor")
    found = []
    for share in shares:
        if not 0.2 <= share <= 2.0:
            raise SweepError(f"floor {share:g}: allowed: 0.2 to 2 times the friction of the car")
        for car in cars:
            friction = load_scenario("turn_none", car.settings_on("turn_none")).car.tyre_friction
            found.append(
                (car, EntryFloor(f"x {share:g}", (f"car.tyre_friction={share * friction:.6g}",)))
            )
    return found
