"""Laws of the tail that others bring: a swing file, or a list of settings of the controller, by path or by name.

A list (schema `aerodima/laws/1`) names settings as `aerodima turn --set` takes them, of the controller alone: a law may
not bring another car, floor, driver or tail. It is plain YAML, and needs no file of this program.
"""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator

from aerodima.optimisation.studies.candidates import Candidate, refuse_twice, swing_player
from aerodima.workbench.config.checked_files import StrictModel, checked, nearest, read_yaml, shipped_names
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.controllers.law_of_scenario import refuse_other_car
from aerodima.workbench.errors import SweepError, SwingFileError, UserError
from aerodima.workbench.report import short_turn

SCHEMA = "aerodima/laws/1"
ALLOWED = ("tail.mode", "controller.")
"""A setting of a law is the first, or begins with the second."""


class Law(StrictModel):
    """A law as settings.

    Attributes:
        name: in tables.
        settings: of a scenario, such as `controller.swing_speed=9.0`; none but those `ALLOWED`.
        words: what it does.
        chosen: how its numbers were come by.
    """

    name: str = Field(min_length=1, max_length=80)
    settings: list[str] = Field(min_length=1)
    words: str = ""
    chosen: str = ""

    @field_validator("settings")
    @classmethod
    def _of_the_controller(cls, settings: list[str]) -> list[str]:
        for setting in settings:
            if not setting.split("=")[0].strip().startswith(ALLOWED) or "=" not in setting:
                raise ValueError(f"{setting!r} is no setting of a law; allowed: tail.mode=..., controller.KEY=...")
        return settings


class LawList(StrictModel):
    """A file of laws."""

    schema_: str = Field(alias="schema")
    candidates: list[Law] = Field(min_length=1)


def read_laws(name_or_path: str, scenario: str, *, other_car: bool = False) -> list[Candidate]:
    """The laws of a list, one of the shipped list `models/short_turn/candidates.yaml` by its name, or a swing file.

    Args:
        name_or_path: path of a list or of a swing file, name of a shipped law or of a shipped swing.
        scenario: that they are to drive.
        other_car: also a swing that was made for another car than the scenario's.

    Raises:
        UserError: no such file or name; malformed; a setting that a law may not bring, or that the scenario refuses; a
            swing for another car.
    """
    shipped = {one.name: Candidate(one.name, tuple(one.settings)) for one in short_turn.load_entries().candidates}
    path = Path(name_or_path)
    if name_or_path in shipped:
        laws = [shipped[name_or_path]]
    elif not path.suffix and not path.exists() and name_or_path not in shipped_names("swings"):
        known = [*shipped, *shipped_names("swings")]
        raise SweepError(
            f"law {name_or_path!r}: no such file, and none ships by this name; {nearest(name_or_path, known)}"
        )
    elif path.exists() and "candidates" in (data := read_yaml(path, SwingFileError)):
        laws = _listed(path, data)
    else:
        laws = [swing_player(name_or_path)]
    for law in laws:
        try:
            turn = load_scenario(scenario, law.settings)
            if not other_car:
                refuse_other_car(turn)
        except UserError as error:
            raise SweepError(f"{name_or_path}: law {law.name!r}: {error}") from None
    return laws


def _listed(path: Path, data: dict[str, object]) -> list[Candidate]:
    """The demo's own list has more keys than laws need."""
    if data.get("schema") == short_turn.SCHEMA:
        data = {"schema": SCHEMA, "candidates": data["candidates"]}
    laws = checked(LawList, data, str(path), SweepError, schema=SCHEMA).candidates
    refuse_twice([law.name for law in laws], f"{path}: law")
    return [Candidate(law.name, tuple(law.settings)) for law in laws]
