"""A campaign on the rig: many logs from one file, each with its own seed, sensor errors and truth.

A campaign file (schema `aerodima/rig-campaign/1`) names a rig scenario, the grid of its experiments, how often each is
repeated, and what differs from log to log: `draw` sets a key to a number drawn evenly between two limits, `scatter`
adds one to it. The numbers of a log depend on the campaign's seed and the log's place alone.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from aerodima.workbench.config.checked_files import (
    StrictModel,
    checked,
    find_file,
    nearest,
    read_yaml,
    unit_factor,
    unit_of,
)
from aerodima.workbench.config.rig_scenario import RIG_SECTIONS, RigScenario, load_rig_scenario
from aerodima.workbench.config.scenario import Sourced
from aerodima.workbench.errors import LogError, ScenarioError

CAMPAIGN_SCHEMA = "aerodima/rig-campaign/1"
MOST_LOGS = 10000
"""Of one campaign; the published one has 540."""


class GridValues(Sourced):
    """What a key of the scenario takes in turn."""

    values: tuple[int | float | str, ...] = Field(min_length=1, max_length=100)


class Limits(Sourced):
    """Ends of an even distribution."""

    low: float
    high: float

    @model_validator(mode="after")
    def _low_is_below_high(self) -> "Limits":
        if self.low > self.high:
            raise ValueError(f"low {self.low:g} is above high {self.high:g}")
        return self


class Repeats(Sourced):
    """How many logs there are of each experiment."""

    value: int = Field(ge=1, le=MOST_LOGS)


class RigCampaign(StrictModel):
    """A campaign file."""

    schema_: Literal["aerodima/rig-campaign/1"] = Field(alias="schema")
    name: str = Field(min_length=1, max_length=80)
    scenario: str = Field(min_length=1)
    set_: tuple[str, ...] = Field((), alias="set")
    grid: Mapping[str, GridValues] = Field({})
    repeats: Repeats
    draw: Mapping[str, Limits] = Field({})
    scatter: Mapping[str, Limits] = Field({})


class RigTask(StrictModel):
    """One log of a campaign.

    Attributes:
        name: of its file, without suffix.
        scenario: resolved.
    """

    name: str
    scenario: RigScenario


def load_campaign(name_or_path: str | Path) -> RigCampaign:
    """Reads a campaign by path, or by name from `models/campaigns`.

    Raises:
        ScenarioError: names file, key, value and what is allowed.
    """
    path = find_file(name_or_path, "campaigns", "campaign")
    campaign = checked(RigCampaign, read_yaml(path), str(path), schema=CAMPAIGN_SCHEMA)
    for part in ("grid", "draw", "scatter"):
        for key, entry in getattr(campaign, part).items():
            _si_factor(key, entry, f"{path}: {part}: {key}")
    return campaign


def campaign_tasks(
    campaign: RigCampaign, seed: int = 1, repeats: int | None = None, settings: Sequence[str] = ()
) -> list[RigTask]:
    """The logs of a campaign, in the order of its grid.

    Args:
        campaign: see `load_campaign`.
        seed: of everything that is drawn.
        repeats: logs per experiment in place of the campaign's.
        settings: overrides of every scenario, such as `experiment.duration=5`; they go before grid and draws.

    Raises:
        ScenarioError: a key or value that the scenario does not take, or more than `MOST_LOGS` logs.
    """
    count = campaign.repeats.value if repeats is None else repeats
    cells = list(product(*([(key, value) for value in entry.values] for key, entry in campaign.grid.items())))
    if not 1 <= count * len(cells) <= MOST_LOGS:
        raise ScenarioError(
            f"campaign {campaign.name!r}: {count} repeats of {len(cells)} experiments; allowed: 1 to {MOST_LOGS} logs"
        )
    base = load_rig_scenario(campaign.scenario, [*campaign.set_, *settings])
    tasks = []
    for number, (cell, repeat) in enumerate(product(cells, range(1, count + 1))):
        generator = np.random.default_rng([seed, number])
        changes: dict[str, Any] = {"seed": int(generator.integers(2**32))}
        for key, value in cell:
            _put(changes, key, value if isinstance(value, str) else value * _si_factor(key, campaign.grid[key], key))
        for key, limits in campaign.draw.items():
            _put(changes, key, float(generator.uniform(limits.low, limits.high)) * _si_factor(key, limits, key))
        for key, limits in campaign.scatter.items():
            section, name = key.split(".")
            middle = changes.get(section, {}).get(name, getattr(getattr(base, section), name))
            added = float(generator.uniform(limits.low, limits.high)) * _si_factor(key, limits, key)
            _put(changes, key, middle + added)
        tasks.append(RigTask(name=_name(cell, repeat), scenario=base.varied(**changes)))
    return tasks


def _put(changes: dict[str, Any], key: str, value: Any) -> None:
    section, name = key.split(".")
    changes.setdefault(section, {})[name] = value


def _si_factor(key: str, entry: Sourced, where: str) -> float | int:
    """SI value of one of the entry's unit; 1 for words and whole numbers."""
    section, _, name = key.partition(".")
    model = RIG_SECTIONS.get(section)
    if model is None or name not in model.model_fields:
        known = [f"{part}.{field}" for part, owner in RIG_SECTIONS.items() for field in owner.model_fields]
        raise ScenarioError(f"{where}: no such key of a rig scenario; {nearest(key, known)}")
    si = unit_of(model, name)
    try:
        factor = unit_factor(entry.unit, si, where)
    except LogError as error:
        raise ScenarioError(str(error)) from None
    return 1 if factor == 1.0 else factor


def _name(cell: tuple[tuple[str, Any], ...], repeat: int) -> str:
    """`tail_1_major_angle_15_wind_speed_10_no_2`."""
    parts = [value if isinstance(value, str) else f"{key.partition('.')[2]}_{value:g}" for key, value in cell]
    return "_".join([*parts, f"no_{repeat}"])
