"""Candidates: a controller of the tail with its numbers, by name, from a list in a file, or a swing file.

A list (schema `aerodima/candidates/1`) names settings as `aerodima turn --set` takes them, of tail and controller
alone: a candidate may not bring another car, floor or driver.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from pydantic import Field, field_validator

from aerodima.workbench.atomic_write import write_atomically
from aerodima.workbench.config.checked_files import StrictModel, checked, nearest, read_yaml, shipped_names
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.controllers.law_of_scenario import find_swing, refuse_other_car
from aerodima.workbench.errors import SweepError, SwingFileError, UserError
from aerodima.workbench.plants.car_model import gearbox_height
from aerodima.workbench.plants.tail import tail_geometry

SCHEMA = "aerodima/candidates/1"
ALLOWED = ("tail.", "controller.", "feedback.")
"""A setting of a candidate begins with one of these."""


@dataclass(frozen=True)
class Candidate:
    """A controller that is judged.

    Attributes:
        name: in tables and pictures.
        settings: overrides of any turn.
        by_speed: further settings by speed of the turn, m/s; those of the nearest speed are taken.
        ballast: further settings of a car, from its scenario; None changes nothing.
    """

    name: str
    settings: tuple[str, ...]
    by_speed: Mapping[float, tuple[str, ...]] = field(default_factory=dict, hash=False)
    ballast: Callable[[Scenario], tuple[str, ...]] | None = None

    def at(self, speed: float) -> tuple[str, ...]:
        """Settings for a turn at a speed, m/s."""
        if not self.by_speed:
            return self.settings
        nearest_speed = min(self.by_speed, key=lambda other: (abs(other - speed), other))
        return (*self.settings, *self.by_speed[nearest_speed])


SWINGING = ("tail.mode=swing", "controller.swing_file=none")
LOW_PLACE = 0.07
"""Height at which a mass is low in the car, m: about that of the axles."""
LOW_CENTRE_HEIGHT = 0.20
"""m; of a car without tail, 4 cm lower than the nominal one."""


def low_ballast(scenario: Scenario) -> tuple[str, ...]:
    """The car without tail, its gearbox with both motors `LOW_PLACE` above the ground and the arm's mass with it."""
    car, tail = scenario.car, scenario.tail
    arm = tail_geometry(tail).inertial.mass + tail.hub_mass if tail.has_own_geometry else tail.mass + tail.hub_mass
    total = car.mass + arm
    lowered = LOW_PLACE - gearbox_height(car, tail)
    x = (car.mass * car.com_x + arm * car.gearbox_x) / total
    z = (car.mass * car.com_height + car.gearbox_mass * lowered + arm * LOW_PLACE) / total
    mount = tail.mount_height + lowered
    return (f"car.mass={total!r}", f"car.com_x={x!r}", f"car.com_height={z!r}", f"tail.mount_height={mount!r}")


NO_TAIL = Candidate("no tail", ("tail.mode=none",))
HELD = Candidate("held", ("tail.mode=held",))
THESIS = Candidate("thesis, 8 rad/s", (*SWINGING, "controller.swing_speed=8.0"))
LOW_BALLAST = Candidate("no tail, its mass low", NO_TAIL.settings, ballast=low_ballast)
LOW_CENTRE = Candidate("no tail, centre of mass at 0.2 m", (*NO_TAIL.settings, f"car.com_height={LOW_CENTRE_HEIGHT!r}"))
CANDIDATES = {
    "none": NO_TAIL,
    "low-ballast": LOW_BALLAST,
    "low-centre": LOW_CENTRE,
    "held": HELD,
    "published": THESIS,
}
"""By the name that asks for one; all of them are judged unless somebody asks for others."""


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
    def _of_the_controller(cls, value: list[str] | dict[float, list[str]]) -> list[str] | dict[float, list[str]]:
        lists = value.values() if isinstance(value, dict) else [value]
        for setting in (one for settings in lists for one in settings):
            if not setting.split("=")[0].strip().startswith(ALLOWED) or "=" not in setting:
                raise ValueError(
                    f"{setting!r} is no setting of a candidate; allowed: KEY=... of tail, controller, feedback"
                )
        return value


class CandidateList(StrictModel):
    """A file of candidates."""

    schema_: str = Field(alias="schema")
    candidates: list[ListedCandidate] = Field(min_length=1)


def read_candidates(names: Iterable[str], scenario: str, *, other_car: bool = False) -> list[Candidate]:
    """Candidates by name or file; the car without tail is always the first one.

    Args:
        names: of `CANDIDATES`, of the shipped list `models/short_turn/candidates.yaml`, of shipped swings, or paths of
            lists or swing files.
        scenario: that they are to drive.
        other_car: also a swing that was made for another car than the scenario's.

    Raises:
        UserError: no such file or name; malformed; a setting that a candidate may not bring, or that the scenario
            refuses; a swing for another car; two candidates of one name.
    """
    found = [NO_TAIL]
    for name in names:
        for one in [CANDIDATES[name]] if name in CANDIDATES else _of_file(name):
            if one is NO_TAIL:
                continue
            try:
                for settings in (one.settings, *((*one.settings, *own) for own in one.by_speed.values())):
                    turn = load_scenario(scenario, settings)
                if not other_car:
                    refuse_other_car(turn)
            except UserError as error:
                raise SweepError(f"{name}: candidate {one.name!r}: {error}") from None
            found.append(one)
    refuse_twice([one.name for one in found], "candidate")
    return found


def write_candidates(path: Path, candidates: Sequence[Candidate], chosen: str, *, force: bool = False) -> Path:
    """Writes a list; `chosen` says how its numbers were found. SweepError when it cannot be written."""
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
    place = str(Path(path_or_name).resolve()) if Path(path_or_name).exists() else path_or_name
    return Candidate(find_swing(path_or_name).name, ("tail.mode=swing", f"controller.swing_file={place}"))


def refuse_twice(names: Sequence[str], what: str) -> None:
    """Raises SweepError where one of these is named twice: the rows of both would be taken for one."""
    for index, name in enumerate(names):
        if name in names[:index]:
            raise SweepError(f"{what} {name!r}: named twice; allowed: once")


def _of_file(name: str) -> list[Candidate]:
    from aerodima.workbench.report import short_turn

    shipped = {one.name: Candidate(one.name, tuple(one.settings)) for one in short_turn.load_entries().candidates}
    path = Path(name)
    if name in shipped:
        return [shipped[name]]
    if not path.suffix and not path.exists() and name not in shipped_names("swings"):
        known = [*CANDIDATES, *shipped, *shipped_names("swings")]
        raise SweepError(f"candidate {name!r}: no such file, and none ships by this name; {nearest(name, known)}")
    if path.exists() and "candidates" in (data := read_yaml(path, SwingFileError)):
        if data.get("schema") == short_turn.SCHEMA:  # the list of the demo has more keys
            data = {"schema": SCHEMA, "candidates": data["candidates"]}
        listed = checked(CandidateList, data, str(path), SweepError, schema=SCHEMA).candidates
        return [
            Candidate(one.name, tuple(one.settings), {v: tuple(own) for v, own in one.by_speed.items()})
            for one in listed
        ]
    return [swing_player(name)]
