"""Candidates: a controller of the tail with its numbers, from a list in a file, a swing file, or a
class of the user's.

A list (schema `aerodima/candidates/1`) names settings as `aerodima run --set` takes them, of tail
and controller alone: a candidate may not bring another car, floor or driver.
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
from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.yaml_files import StrictModel, checked, read_yaml, shipped_names
from aerodima.workbench.scenario.scenario import Scenario, load_scenario

SCHEMA = "aerodima/candidates/1"
Settings = tuple[str, ...]
TRIM = "manoeuvre.trim_angle="
"""Beginning of the setting of a trim."""
ALLOWED_SECTIONS = ("tail.", "controller.", "feedback.", "rollover_control.")
"""A setting of a candidate begins with one of these."""
SWINGING = ("tail.mode=swing", "controller.swing_file=none")
SWERVE = "swerve"
"""Scenario of a swerve."""
LOW_MASS_HEIGHT = 0.07
"""Height at which a mass is low in the car, m: about that of the axles."""
BALLAST_PLACES = (0.0, 0.01, 0.02, 0.03)
"""How far low ballast moves the centre of mass of the car back, m."""


@dataclass(frozen=True)
class Candidate:
    """A controller of the tail that is compared with others.

    Attributes:
        name: in tables and pictures.
        settings: overrides of any turn.
        by_speed: further settings by speed of the turn, m/s; those of the nearest speed are taken.
        ballasts: further settings of a car, from its scenario, of which the best are taken; none
            changes nothing.
        law: `FILE:CLASS` of the law that drives the tail instead of the scenario's; empty for that.
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
    """Returns the settings of the car without tail, its gearbox with both motors `LOW_MASS_HEIGHT`
    above the ground and the arm's mass with it, both so far back that the centre of mass of the car
    moves back by `back`, m.
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
    """Refuses a setting of car, floor or driver."""
    if not setting.strip().startswith(ALLOWED_SECTIONS) or "=" not in setting:
        raise ValueError(
            f"{setting!r} is no setting of a candidate; must be KEY=... of tail, controller, "
            "feedback, rollover_control"
        )
    return setting


ListedSettings = tuple[Annotated[str, AfterValidator(_check_section)], ...]
"""Settings in a file, of `ALLOWED_SECTIONS` alone."""


class ListedCandidate(StrictModel):
    """A candidate in a file.

    Attributes:
        name: in tables.
        settings: of a scenario, such as `controller.swing_speed=9.0`.
        by_speed: further settings by speed of the turn, m/s.
        words: what it does.
        chosen: how its numbers were found.
    """

    name: str = Field(min_length=1, max_length=80)
    settings: ListedSettings
    by_speed: dict[float, ListedSettings] = Field(default_factory=dict)
    words: str = ""
    chosen: str = ""

    def candidate(self) -> Candidate:
        """Returns the candidate."""
        return Candidate(self.name, self.settings, self.by_speed)


class CandidateList(StrictModel):
    """A file of candidates."""

    schema_: str = Field(alias="schema")
    candidates: list[ListedCandidate] = Field(min_length=1)


def read_candidates(names: Iterable[str], known: Mapping[str, Candidate]) -> list[Candidate]:
    """Reads candidates by name or file; the car without tail is always the first one.

    Args:
        names: of `known`, of shipped swings, or paths of lists or swing files. A swing plays on
            whatever car is driven.
        known: by the name that asks for one.

    Raises:
        UserError: no such file or name; malformed; a setting that a candidate may not bring, or
            that `swerve` refuses.
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
    """Makes the candidate of a tail law of the reader's, `my_law.py:MyLaw`, named after its class;
    the tail waits where that of the feedback law does.

    Raises:
        UserError: no such file or class, the file fails, or what it holds is no tail law.
    """
    path, _, name = path_and_class.rpartition(":")
    load_law(path_and_class, load_scenario(SWERVE, SWINGING))
    waiting = (*SWINGING, "controller.law=feedback")
    return Candidate(name, waiting, law=f"{Path(path).resolve()}:{name}")


def write_candidate(path: Path, candidate: Candidate, chosen: str, *, force: bool = False) -> Path:
    """Writes a list of one candidate; `chosen` says how its numbers were found.

    SweepError when it cannot be written.
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
    """Makes the candidate that plays a swing file, with the trim of its driver; UserError where it
    is missing or malformed.
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
