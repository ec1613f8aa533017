"""Candidates: a controller of the tail with its numbers, from a list in a file, a swing file, or a
class of one's own.

A list (schema `aerodima/candidates/1`) names settings as `aerodima run --set` takes them, of tail
and controller alone: a candidate may not bring another car, floor or driver.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from pydantic import Field, field_validator

from aerodima.workbench.car.car_model import gearbox_height
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.control.law_of_scenario import find_swing, load_law
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import SweepError, SwingFileError, UserError
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml, shipped_names
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

SCHEMA = "aerodima/candidates/1"
SettingLists = list[str] | dict[float, list[str]]
"""Settings, or settings by speed, m/s."""
ALLOWED = ("tail.", "controller.", "feedback.")
"""A setting of a candidate begins with one of these."""
SWINGING = ("tail.mode=swing", "controller.swing_file=none")
LOW_PLACE = 0.07
"""Height at which a mass is low in the car, m: about that of the axles."""


@dataclass(frozen=True)
class Candidate:
    """A controller that is judged.

    Attributes:
        name: in tables and pictures.
        settings: overrides of any turn.
        by_speed: further settings by speed of the turn, m/s; those of the nearest speed are taken.
        ballast: further settings of a car, from its scenario; None changes nothing.
        law: `FILE:CLASS` of the law that drives the tail instead of the scenario's; empty for that.
    """

    name: str
    settings: tuple[str, ...]
    by_speed: Mapping[float, tuple[str, ...]] = field(default_factory=dict, hash=False)
    ballast: Callable[[Scenario], tuple[str, ...]] | None = None
    law: str = ""

    def at(self, speed: float) -> tuple[str, ...]:
        """Settings for a turn at a speed, m/s."""
        if not self.by_speed:
            return self.settings
        nearest_speed = min(self.by_speed, key=lambda other: (abs(other - speed), other))
        return (*self.settings, *self.by_speed[nearest_speed])


def low_ballast(scenario: Scenario) -> tuple[str, ...]:
    """The car without tail, its gearbox with both motors `LOW_PLACE` above the ground and the arm's
    mass with it.
    """
    car = scenario.car
    tail = scenario.tail
    if tail.has_own_geometry:
        arm = tail_geometry(tail).inertial.mass + tail.hub_mass
    else:
        arm = tail.mass + tail.hub_mass
    total = car.mass + arm
    lowered = LOW_PLACE - gearbox_height(car, tail)
    x = (car.mass * car.com_x + arm * car.gearbox_x) / total
    z = (car.mass * car.com_height + car.gearbox_mass * lowered + arm * LOW_PLACE) / total
    mount = tail.mount_height + lowered
    return (
        f"car.mass={total!r}",
        f"car.com_x={x!r}",
        f"car.com_height={z!r}",
        f"tail.mount_height={mount!r}",
    )


NO_TAIL = Candidate("no tail", ("tail.mode=none",))
HELD = Candidate("held", ("tail.mode=held",))
THESIS = Candidate("thesis, 8 rad/s", (*SWINGING, "controller.swing_speed=8.0"))
LOW_BALLAST = Candidate("no tail, its mass low", NO_TAIL.settings, ballast=low_ballast)
BEST_SWING = Candidate(
    "best_swing",
    (
        *SWINGING,
        "controller.trigger=steering",
        "controller.trigger_steering_angle=0.03",
        "controller.delay=0.489",
        "controller.swing_speed=13.68",
        "controller.swing_kd=3.415",
        "controller.travel=2.259",
        "controller.settle_kp=18.19",
        "controller.settle_kd=0.6648",
        "controller.hold_angle=1.566",
        "controller.pitch_angle=0.593",
    ),
)
"""Trained once to turn cars with rigid tyres by a pulse of steering of 0.5 s."""


class ListedCandidate(StrictModel):
    """A candidate in a file.

    Attributes:
        name: in tables.
        settings: of a scenario, such as `controller.swing_speed=9.0`; none but those `ALLOWED`.
        by_speed: further settings by speed of the turn, m/s.
        words: what it does.
        chosen: how its numbers were found.
    """

    name: str = Field(min_length=1, max_length=80)
    settings: list[str]
    by_speed: dict[float, list[str]] = Field(default_factory=dict)
    words: str = ""
    chosen: str = ""

    @field_validator("settings", "by_speed")
    @classmethod
    def _of_the_controller(cls, value: SettingLists) -> SettingLists:
        lists = value.values() if isinstance(value, dict) else [value]
        for setting in (one for settings in lists for one in settings):
            if not setting.split("=")[0].strip().startswith(ALLOWED) or "=" not in setting:
                raise ValueError(
                    f"{setting!r} is no setting of a candidate; allowed: KEY=... of tail, "
                    "controller, feedback"
                )
        return value


class CandidateList(StrictModel):
    """A file of candidates."""

    schema_: str = Field(alias="schema")
    candidates: list[ListedCandidate] = Field(min_length=1)


def read_candidates(
    names: Iterable[str], known: Mapping[str, Candidate], scenario: str
) -> list[Candidate]:
    """Candidates by name or file; the car without tail is always the first one.

    Args:
        names: of `known`, of shipped swings, or paths of lists or swing files. A swing plays on
            whatever car is judged.
        known: by the name that asks for one.
        scenario: that they are to drive.

    Raises:
        UserError: no such file or name; malformed; a setting that a candidate may not bring, or
            that the scenario refuses; two candidates of one name.
    """
    found = [NO_TAIL]
    for name in names:
        for one in [known[name]] if name in known else _of_file(name, known):
            try:
                for settings in (
                    one.settings,
                    *((*one.settings, *own) for own in one.by_speed.values()),
                ):
                    load_scenario(scenario, settings)
            except UserError as error:
                raise SweepError(f"{name}: candidate {one.name!r}: {error}") from None
            found += [] if one is NO_TAIL else [one]
    refuse_twice([one.name for one in found], "candidate")
    return found


def own_law(place: str, scenario: str) -> Candidate:
    """A tail law of the reader's, `my_law.py:MyLaw`, named after its class.

    Raises:
        UserError: no such file or class, the file fails, or what it holds is no tail law.
    """
    path, _, name = place.rpartition(":")
    load_law(place, load_scenario(scenario, SWINGING))
    return Candidate(name, SWINGING, law=f"{Path(path).resolve()}:{name}")


def write_candidates(
    path: Path, candidates: Sequence[Candidate], chosen: str, *, force: bool = False
) -> Path:
    """Writes a list; `chosen` says how its numbers were found.

    SweepError when it cannot be written.
    """
    entries = [
        {
            "name": one.name,
            "settings": list(one.settings),
            "by_speed": {speed: list(settings) for speed, settings in one.by_speed.items()},
            "chosen": chosen,
        }
        for one in candidates
    ]
    text = yaml.safe_dump({"schema": SCHEMA, "candidates": entries}, sort_keys=False, width=110)
    return write_atomically(path, text, force, SweepError)


def swing_player(path_or_name: str) -> Candidate:
    """Plays a swing file. Raises `UserError` where it is missing or malformed."""
    if Path(path_or_name).exists():
        place = str(Path(path_or_name).resolve())
    else:
        place = path_or_name
    return Candidate(
        find_swing(path_or_name).name, ("tail.mode=swing", f"controller.swing_file={place}")
    )


def refuse_twice(names: Sequence[str], what: str) -> None:
    """Raises SweepError where one of these is named twice: its rows would be taken for one."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise SweepError(f"{what} {name!r}: named twice; allowed: once")


def _of_file(name: str, known: Iterable[str]) -> list[Candidate]:
    path = Path(name)
    if ".py:" in name:
        raise SweepError(
            f"candidate {name}: a class; allowed here: a name or a YAML file. Use --law {name}"
        )
    if not path.suffix and not path.exists() and name not in shipped_names("swings"):
        close = nearest(name, [*known, *shipped_names("swings")])
        raise SweepError(f"candidate {name!r}: no such file, and none ships by this name; {close}")
    if path.exists() and "candidates" in read_yaml(path, SwingFileError):
        listed = checked(
            CandidateList, read_yaml(path, SwingFileError), str(path), SweepError, schema=SCHEMA
        )
        return [
            Candidate(
                one.name, tuple(one.settings), {v: tuple(own) for v, own in one.by_speed.items()}
            )
            for one in listed.candidates
        ]
    return [swing_player(name)]
