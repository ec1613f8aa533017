"""Candidates: a controller of the tail with its numbers, from a list in a file, a swing file, or a
class of the user's.

A list (schema `aerodima/candidates/1`) holds settings as `aerodima run --set` takes them. They are
settings of tail and controller alone: a candidate may not bring another car, floor or driver.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated

import yaml
from pydantic import AfterValidator, Field

from aerodima.workbench.car.car_model import gearbox_height
from aerodima.workbench.car.tail_plant import tail_geometry
from aerodima.workbench.control.swing_library import find_swing
from aerodima.workbench.control.user_law import load_law
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import SweepError, SwingFileError, UserError
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml, shipped_names
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

SCHEMA = "aerodima/candidates/1"
TRIM = "manoeuvre.trim_angle="
"""Beginning of the setting of a trim."""
ALLOWED_SECTIONS = ("tail.", "controller.", "feedback.", "rollover_control.")
"""Sections of a candidate's settings; each setting begins with one of them."""
SWINGING = ("tail.mode=swing", "controller.swing_file=none")
SWERVE = "swerve"
"""Name of the scenario of a swerve."""
LOW_MASS_HEIGHT = 0.07
"""Height of a mass that is low in the car, m: about that of the axles."""
BALLAST_PLACES = (0.0, 0.01, 0.02, 0.03)
"""Distances by which low ballast moves the centre of mass of the car back, m."""


@dataclass(frozen=True)
class Candidate:
    """A controller of the tail that is compared with others.

    Attributes:
        name: name in tables and pictures.
        settings: overrides of the scenario in every turn.
        by_speed: further settings by speed of the turn, m/s; those of the nearest speed are taken.
        ballasts: functions of a car's scenario, each of which returns further settings; the best
            of them are taken. Empty if the car carries no ballast.
        law: `FILE:CLASS` of the law that drives the tail; empty for that of the scenario.
    """

    name: str
    settings: Settings
    by_speed: Mapping[float, Settings] = field(default_factory=dict, hash=False)
    ballasts: tuple[Callable[[Scenario], Settings], ...] = ()
    law: str = ""

    @property
    def is_at_full_lock(self) -> bool:
        """Whether its driver turns the wheels to the stop: it has a rollover control."""
        return any(setting.startswith("rollover_control.gain=") for setting in self.settings)

    def at(self, speed: float) -> Settings:
        """Returns the settings of a turn at a speed, m/s."""
        if not self.by_speed:
            return self.settings
        nearest_speed = min(self.by_speed, key=lambda other: (abs(other - speed), other))
        return (*self.settings, *self.by_speed[nearest_speed])


def low_ballast(scenario: Scenario, back: float = 0.0) -> Settings:
    """Returns the settings of the car without tail that carries its mass as low ballast.

    The gearbox with both motors and the mass of the arm are `LOW_MASS_HEIGHT` above the ground, so
    far back that the centre of mass of the car moves back by `back`, m.
    """
    car = scenario.car
    tail = scenario.tail
    arm = tail.hub_mass + tail.mass
    if tail.has_own_geometry:
        arm = tail_geometry(tail).inertial.mass + tail.hub_mass
    total = car.mass + arm
    lowered = LOW_MASS_HEIGHT - gearbox_height(car, tail)
    x = (car.mass * car.com_x + arm * car.gearbox_x) / total
    z = car.mass * car.com_height + car.gearbox_mass * lowered + arm * LOW_MASS_HEIGHT
    return (
        f"car.mass={total!r}",
        f"car.com_x={x - back!r}",
        f"car.com_height={z / total!r}",
        f"tail.mount_height={tail.mount_height + lowered!r}",
    )


NO_TAIL = Candidate("no tail", ("tail.mode=none",))
LOW_BALLAST = Candidate(
    "low ballast",
    NO_TAIL.settings,
    ballasts=tuple(partial(low_ballast, back=back) for back in BALLAST_PLACES),
)


def _check_section(setting: str) -> str:
    """Returns a setting; refuses one of car, floor or driver."""
    if not setting.strip().startswith(ALLOWED_SECTIONS) or "=" not in setting:
        raise ValueError(
            f"{setting!r} is no setting of a candidate; must be KEY=... of tail, controller, "
            "feedback, rollover_control"
        )
    return setting


ListedSettings = tuple[Annotated[str, AfterValidator(_check_section)], ...]
"""Settings of a candidate in a file, all of them in `ALLOWED_SECTIONS`."""


class ListedCandidate(StrictModel):
    """A candidate in a file.

    Attributes:
        name: name in tables.
        settings: overrides of a scenario, such as `controller.swing_speed=9.0`.
        by_speed: further settings by speed of the turn, m/s.
        words: description of what the candidate does.
        chosen: description of how its numbers were found.
    """

    name: str = Field(min_length=1, max_length=80)
    settings: ListedSettings
    by_speed: dict[float, ListedSettings] = Field(default_factory=dict)
    words: str = ""
    chosen: str = ""

    def candidate(self) -> Candidate:
        """Returns the candidate that the file describes."""
        return Candidate(self.name, self.settings, self.by_speed)


class CandidateList(StrictModel):
    """A file of candidates."""

    schema_: str = Field(alias="schema")
    candidates: list[ListedCandidate] = Field(min_length=1)


def read_candidates(names: Iterable[str], known: Mapping[str, Candidate]) -> list[Candidate]:
    """Reads candidates by name or file; the car without tail is always the first one.

    Args:
        names: names in `known`, names of shipped swings, or paths of lists or swing files. A swing
            plays on whatever car is driven.
        known: candidates by the name that asks for them.

    Raises:
        UserError: no such file or name; a malformed file; a setting that a candidate may not bring,
            or that the scenario `swerve` refuses.
    """
    candidates = [NO_TAIL]
    for name in names:
        for candidate in _find(name, known):
            try:
                for settings in ((), *candidate.by_speed.values()):
                    load_scenario(SWERVE, (*candidate.settings, *settings))
            except UserError as error:
                raise SweepError(f"{name}: candidate {candidate.name!r}: {error}") from None
            if candidate is not NO_TAIL:
                candidates.append(candidate)
    return candidates


def user_law(path_and_class: str) -> Candidate:
    """Makes the candidate of a user's tail law, `my_law.py:MyLaw`, named after its class; the tail
    waits where that of the feedback law does.

    Raises:
        UserError: no such file or class, the file fails, or what it holds is no tail law.
    """
    path, _, name = path_and_class.rpartition(":")
    load_law(path_and_class, load_scenario(SWERVE, SWINGING))
    waiting = (*SWINGING, "controller.law=feedback")
    return Candidate(name, waiting, law=f"{Path(path).resolve()}:{name}")


def write_candidate(path: Path, candidate: Candidate, chosen: str, *, force: bool = False) -> Path:
    """Writes a list of one candidate; `chosen` says how its numbers were found.

    Raises SweepError if the file cannot be written, or exists and `force` is not set.
    """
    listed = ListedCandidate(
        name=candidate.name,
        settings=candidate.settings,
        by_speed=dict(candidate.by_speed),
        chosen=chosen,
    )
    entry = listed.model_dump(mode="json", exclude={"words"})
    text = yaml.safe_dump({"schema": SCHEMA, "candidates": [entry]}, sort_keys=False, width=110)
    return write_atomically(path, text, force, SweepError)


def swing_player(path_or_name: str) -> Candidate:
    """Makes the candidate that plays a swing file, with the trim of its driver; raises UserError if
    the file is missing or malformed.
    """
    path = Path(path_or_name)
    place = str(path.resolve()) if path.exists() else path_or_name
    swing = find_swing(path_or_name)
    trim = [one for one in swing.provenance.settings if one.startswith(TRIM)]
    return Candidate(swing.name, ("tail.mode=swing", f"controller.swing_file={place}", *trim))


def _find(name: str, known: Mapping[str, Candidate]) -> Iterator[Candidate]:
    path = Path(name)
    swings = shipped_names("swings")
    if name in known:
        yield known[name]
    elif ".py:" in name:
        raise SweepError(
            f"candidate {name}: a class; must be a name or a YAML file. Use --law {name}"
        )
    elif not path.suffix and not path.exists() and name not in swings:
        close = nearest(name, [*known, *swings])
        raise SweepError(f"candidate {name!r}: no such file, and none ships by this name; {close}")
    elif path.exists() and "candidates" in (content := read_yaml(path, SwingFileError)):
        listed = checked(CandidateList, content, name, SweepError, schema=SCHEMA)
        for one in listed.candidates:
            yield one.candidate()
    else:
        yield swing_player(name)
