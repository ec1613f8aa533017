"""The run log: one run in one Parquet file, signals as columns and provenance as metadata.

Columns are float64 (`aerodima.workbench.scenario.signal_table`). The metadata are one JSON object
under the key `aerodima`: schema, scenario (resolved), seed, versions, created, kind, extra. Two
runs of the same scenario and seed have equal signals, bit for bit; only `created` may differ.
"""

import json
import math
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib import metadata as distribution_metadata
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict
from typing_extensions import TypedDict

from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.core.file_reading import Facts, Json, reading
from aerodima.workbench.core.yaml_files import checked
from aerodima.workbench.scenario.signal_table import (
    CAR_TRUTH,
    RIG_KINDS,
    TIME,
    names_of,
    sensor_columns,
    truth_columns,
)

SCHEMA = "aerodima/run-log/1"
METADATA_KEY = b"aerodima"
_TAIL_TRUTH = frozenset(names_of(CAR_TRUTH["tail_truth"]))
PLANT_RUN = "plant_run"
"""Kind of a log of any plant that `observe` wrote, with the columns of
`aerodima.workbench.car.ground_truth`."""
TAIL_LAW = "tail_law"
"""Key in `extra` of a run whose tail followed a law that the scenario does not name: the name of
its class."""
DIAGRAM = "diagram"
"""Key in `extra` of a run that a user's own diagram drove, in place of driver and tail law: the
name of its function."""
DRIVEN_BY = "driven_by"
"""Key in `extra` of a run that did not follow the manoeuvre of its scenario: who steered, such as
`hand (MANUAL)`."""


class _Scenario(TypedDict, total=False):
    """Keys that are read from every scenario, which has others too."""

    tail: Json | None


class _Metadata(BaseModel):
    """Facts that every log states about its run, beside the schema."""

    model_config = ConfigDict(strict=True)

    scenario: _Scenario
    seed: int
    versions: Json
    created: str
    kind: str
    extra: Json


@dataclass(frozen=True)
class RunLog:
    """A run: the table of its signals, and what made them.

    Attributes:
        table: one row per log time, float64 columns; the first is `time_s`.
        scenario: resolved scenario as plain data.
        seed: seed of every random number of the run.
        versions: versions of the project, Drake, Python and NumPy.
        kind: kind of log, such as `car_run` for a run of the car and `plant_run` for one of another
            plant.
        created: ISO time of the start of the run.
        extra: further facts, for example `tail_mass_kg` (kg).
        source: name of the file that the log came from, for messages; empty for a run in memory.
    """

    table: pd.DataFrame
    scenario: Json
    seed: int
    versions: dict[str, str] = field(default_factory=dict)
    kind: str = "car_run"
    created: str = ""
    extra: Json = field(default_factory=dict)
    source: str = ""

    @property
    def name(self) -> str:
        """Gives the name for messages."""
        return self.source or "run log"

    @property
    def time(self) -> FloatArray:
        """Gives the log times, s, shape (n,)."""
        return self.signal(TIME)

    @property
    def has_truth(self) -> bool:
        """Says whether the run was simulated with its ground truth logged."""
        return "gyro_z_truth_rad_per_s" in self.table.columns

    @property
    def has_tail(self) -> bool:
        """Says whether the car had a tail; a log that does not say counts as one with a tail."""
        return scenario_has_tail(self.scenario)

    def signal(self, name: str) -> FloatArray:
        """Reads one column, shape (n,); LogError when the log has no such column."""
        if name not in self.table.columns:
            raise LogError(f"{self.name}: no column {name!r}")
        return self.table[name].to_numpy(dtype=np.float64)

    def vector(self, stem: str, suffix: str) -> FloatArray:
        """Reads the columns `<stem>_{x,y,z}_<suffix>`, shape (n, 3)."""
        return np.column_stack([self.signal(f"{stem}_{axis}_{suffix}") for axis in "xyz"])

    def setting(self, section: str, key: str) -> Any:
        """Reads a value of the scenario; LogError when it has none."""
        try:
            return self.scenario[section][key]
        except (KeyError, TypeError):
            raise LogError(f"{self.name}: its scenario has no {section}.{key}") from None

    def number(self, section: str, key: str) -> float:
        """Reads a number of the scenario; LogError when it has none, or not a finite one."""
        value = self.setting(section, key)
        numbers = _finite([value])
        if not numbers:
            raise LogError(
                f"{self.name}: its scenario has {section}.{key} {value!r}, but it must be a "
                "finite number"
            )
        return numbers[0]

    def stated(self, key: str, count: int) -> tuple[float, ...] | None:
        """Reads numbers under a key of `extra`; None without the key, LogError unless there are
        `count` finite ones.
        """
        value = self.extra.get(key)
        if value is None:
            return None
        numbers = _finite(value)
        if len(numbers) != count or not numbers:
            raise LogError(
                f"{self.name}: metadata {key!r} is {value!r}; {count} numbers are needed"
            )
        return numbers

    def metadata(self) -> Json:
        """Collects what goes into the file's metadata."""
        named = {name: getattr(self, name) for name in _Metadata.model_fields}
        return {"schema": SCHEMA, **named}


def _finite(values: Any) -> tuple[float, ...]:
    """Converts values to finite numbers; none if one of them is not."""
    try:
        numbers = tuple(map(float, values))
    except (TypeError, ValueError, OverflowError):
        return ()
    return numbers if all(map(math.isfinite, numbers)) else ()


def scenario_has_tail(scenario: Facts) -> bool:
    """Says whether the scenario's `tail.mode` is not `none`."""
    return str((scenario.get("tail") or {}).get("mode", "held")) != "none"


def run_metadata(
    scenario: Facts,
    seed: int,
    kind: str = "car_run",
    extra: Facts | None = None,
) -> Json:
    """Makes the metadata of a run that starts now, with the versions of this environment."""
    return {
        "schema": SCHEMA,
        "scenario": dict(scenario),
        "seed": seed,
        "versions": dict(software_versions()),
        "created": datetime.now(UTC).isoformat(),
        "kind": kind,
        "extra": dict(extra or {}),
    }


@cache
def software_versions() -> dict[str, str]:
    """Looks up the versions of the installed distributions that a run depends on, once in a
    process; Drake is not imported.
    """
    versions = {"python": platform.python_version(), "numpy": np.__version__}
    for key, distribution in (("project", "aerodima-workbench"), ("drake", "drake")):
        try:
            versions[key] = distribution_metadata.version(distribution)
        except distribution_metadata.PackageNotFoundError:
            versions[key] = "not installed"
    return versions


def run_log_from_metadata(table: pd.DataFrame, metadata: Facts, source: str = "") -> RunLog:
    """Makes a run log from its table and its metadata object (`run_metadata`)."""
    return RunLog(
        table=table, source=source, **{name: metadata[name] for name in _Metadata.model_fields}
    )


def write_run_log(run_log: RunLog, path: Path | str, force: bool = False) -> Path:
    """Writes a run to a Parquet file, whole or not at all.

    Raises:
        LogError: the file exists and `force` is not set, the folder cannot be used, a column is
            missing or is not made of numbers.
    """
    columns = {}
    for name in run_log.table.columns:
        try:
            columns[str(name)] = pa.array(run_log.table[name].to_numpy(dtype=np.float64))
        except (TypeError, ValueError) as cause:
            raise LogError(f"{path}: column {name!r} is not made of numbers ({cause})") from cause
    return write_table(pa.table(columns), run_log.metadata(), Path(path), force)


def write_table(table: pa.Table, metadata: Facts, path: Path, force: bool) -> Path:
    """Writes an Arrow table of float64 columns with this metadata object; see `write_run_log`."""
    from aerodima.workbench.core.atomic_write import write_atomically  # not for readers of logs

    refuse_missing(table.column_names, metadata, str(path))
    # Without marks of missing values: they would stand in the head of a page, outside its checksum.
    fields = [column.with_nullable(False) for column in table.schema]
    table = table.cast(pa.schema(fields, metadata={METADATA_KEY: encode_metadata(metadata)}))

    def write(temporary: Path) -> None:
        # Floating-point signals seldom repeat: a dictionary would cost time and save nothing.
        pq.write_table(
            table,
            temporary,
            compression="zstd",
            compression_level=1,
            use_dictionary=False,
            write_page_checksum=True,
        )

    return write_atomically(path, write, force, LogError)


def read_run_log(path: Path | str) -> RunLog:
    """Reads a run.

    Raises:
        LogError: no such file, cut off or not Parquet, not a run log, another schema version,
            columns missing.
    """
    path = Path(path)
    if path.is_dir():
        raise LogError(f"{path}: is a folder; must be the Parquet file of a run")
    if not path.is_file():
        raise LogError(f"{path}: no such run log" + _journal_hint(path))
    hint = _journal_hint(path) or (
        "; a run that was cut off leaves a *.journal for `aerodima log recover`"
    )
    with (
        reading(path, "a run log", LogError, f"; cut off, damaged or not Parquet{hint}"),
        pq.ParquetFile(path, page_checksum_verification=True) as file,
    ):
        metadata = decode_metadata(file.schema_arrow.metadata, str(path))
        table = file.read()
        refuse_missing(table.column_names, metadata, str(path))
        frame = table.to_pandas(ignore_metadata=True).astype(np.float64)
    if metadata["kind"] == "car_run":
        optional = [column.name for column in sensor_columns() if column.optional]
        absent = [name for name in optional if name not in frame]
        frame[absent] = math.nan
    return run_log_from_metadata(frame, metadata, source=str(path))


def encode_metadata(metadata: Facts) -> bytes:
    """Writes the JSON of a metadata object; LogError if something in it is NaN, infinite or not
    JSON.
    """
    try:
        return json.dumps(metadata, sort_keys=True, allow_nan=False).encode()
    except (TypeError, ValueError) as cause:
        raise LogError(f"run log metadata cannot be written as JSON: {cause}") from cause


def decode_metadata(schema_metadata: Mapping[bytes, bytes] | None, source: str) -> Json:
    """Reads the metadata object of an Arrow schema; LogError when absent or of another schema
    version.
    """
    raw = (schema_metadata or {}).get(METADATA_KEY)
    if raw is None:
        raise LogError(f"{source}: not a run log (no {METADATA_KEY.decode()!r} metadata)")
    with reading(source, "a run log, its metadata", LogError):
        metadata = json.loads(raw)
    checked(_Metadata, metadata, f"{source}: metadata", LogError, schema=SCHEMA)
    return dict(metadata)


def _journal_hint(path: Path) -> str:
    journal = path.with_name(path.name + ".journal")
    if journal.is_file():
        return f"; its journal is there: `aerodima log recover {journal}` rescues it"
    return ""


def refuse_missing(names: Iterable[str], metadata: Facts, source: str) -> None:
    """Raises LogError if a column is missing that a log of this kind and scenario must have.

    A `car_run` has every sensor column that is not optional; if it has one truth column it has all
    of them, apart from those of the tail when the car has none. A rig log needs time and angle: a
    fit does without what its force sensor did not give. Other kinds need their time. Further
    columns are welcome.
    """
    present = set(names)
    kind = metadata.get("kind")
    required = [TIME]
    if kind in RIG_KINDS:
        required = [TIME, "angle_rad"]
    if kind == "car_run":
        required = [column.name for column in sensor_columns() if not column.optional]
        if any("_truth_" in name for name in present):
            has_tail = scenario_has_tail(metadata.get("scenario") or {})
            truth = names_of(truth_columns())
            required += [name for name in truth if has_tail or name not in _TAIL_TRUTH]
    missing = [name for name in required if name not in present]
    if missing:
        raise LogError(f"{source}: {len(missing)} column(s) missing: {', '.join(missing)}")
