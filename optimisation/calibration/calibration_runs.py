"""The runs of a calibration, kept on the disk as they come, so that an interrupted calibration can go on.

Every decision of a calibration follows from its plan, its seed and the rows of these runs. So the same command with the
same folder repeats the decisions, takes the rows that are there, and runs only what is missing.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.optimisation.sweep.study_engine import Engine, RememberingEngine, RunTask, tipped_before_turn
from aerodima.workbench.batch.row_store import RowStore, content_key
from aerodima.workbench.batch.worker_record import Say
from aerodima.workbench.config.ensemble import Value
from aerodima.workbench.config.scenario import Scenario, load_scenario
from aerodima.workbench.logs.schema import software_versions

RUNS_SCHEMA = "aerodima/calibration-runs/3"
RUNS = "runs.jsonl"
SCENARIOS = ("turn_none", "turn_held", "turn_swing", "slalom")
"""Whose numbers must be those of the runs that a folder holds, whatever varies from car to car."""

DEFAULT_LOG_RATE = 500.0
"""Hz; a coarser step than its period logs every step."""


@dataclass(frozen=True)
class Wanted:
    """One run of a car.

    Attributes:
        values: `section.key` -> value.
        tail_mode: `none`, `held` or `swing`.
        speed: commanded, m/s.
        step: of the plant, s; None for the default.
        manoeuvre: of the scenario, `turn` or `slalom`; a slalom has no tail arm.
        settings: further overrides.
    """

    values: Mapping[str, Value]
    tail_mode: str
    speed: float
    step: float | None = None
    manoeuvre: str = "turn"
    settings: tuple[str, ...] = ()

    def task(self) -> RunTask:
        """As a task of the engine; its name is its content, so equal runs have equal names.

        Without a tail arm its parameters say nothing; they are left out, so that cars that differ in them share a run.
        """
        acting = {
            key: value for key, value in self.values.items() if self.tail_mode != "none" or _acts_without_arm(key)
        }
        settings = [f"{key}={value}" for key, value in acting.items()]
        settings += [f"manoeuvre.speed={self.speed!r}", *self.settings]
        if self.step is not None:
            rate = min(DEFAULT_LOG_RATE, 1.0 / self.step)
            settings += [f"simulation.step={self.step!r}", f"simulation.log_rate={rate:.9g}"]
        scenario = f"turn_{self.tail_mode}" if self.manoeuvre == "turn" else self.manoeuvre
        digest = hashlib.sha256("\n".join([scenario, *settings]).encode()).hexdigest()[:20]
        return RunTask(digest, scenario, tuple(settings))


def car_values(keys: Sequence[str], rows: NDArray[np.float64]) -> list[dict[str, Value]]:
    """Cars of rows of parameters (m, n), with six digits: what a run gets is what a file says."""
    return [{key: float(f"{value:.6g}") for key, value in zip(keys, row, strict=True)} for row in rows]


class RunStore(RowStore):
    """Rows of finished runs in `runs.jsonl` of a folder, which is locked as long as the store lives.

    Args:
        folder: made when it is not there.
        varied: keys that vary from car to car, left out of what must agree.
        force: drop the rows that are there.

    Raises:
        UserError: as `RowStore`.
    """

    def __init__(self, folder: Path, varied: Iterable[str], *, force: bool = False):
        bases = {name: _digest(load_scenario(name), tuple(varied)) for name in SCENARIOS}
        identity = {"schema": RUNS_SCHEMA, "versions": software_versions(), "scenarios": bases}
        super().__init__(folder / RUNS, identity, force=force)

    def run(self, wanted: Sequence[Wanted], engine: Engine, say: Say | None = None, what: str = "") -> pd.DataFrame:
        """Rows of runs, in their order; those that are not in the store are run and stored first."""
        remembering = RememberingEngine(engine, self, say, what)
        return pd.DataFrame(remembering.rows([run.task() for run in wanted]))

    def __len__(self) -> int:
        return len(self.rows)


def survives(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Which runs survived (m)."""
    return np.asarray(rows["outcome"] == "survived", bool)


def flips_in_the_turn(rows: pd.DataFrame) -> NDArray[np.bool_]:
    """Which runs flipped in the turn (m), not before it. A run without outcome is neither a survival nor a flip."""
    tipped = [tipped_before_turn(row) for row in rows.to_dict("records")]
    return np.asarray(rows["outcome"] == "flipped", bool) & ~np.array(tipped, bool)


def _acts_without_arm(key: str) -> bool:
    """The place of the tail's joints is that of the gearbox, which stays on the car."""
    return not key.startswith("tail.") or key.startswith("tail.mount_")


def _digest(base: Scenario, varied: Sequence[str]) -> str:
    content = base.resolved()
    for key in varied:
        section, _, name = key.partition(".")
        content[section].pop(name, None)
    return content_key(content)
