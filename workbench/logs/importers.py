"""Foreign files become a run log: columns renamed, units made SI, rates put on one time grid.

A column that was sampled at other times (GPS beside IMU) holds its last sample, as a control loop
would have seen it. Nothing is filtered or filled in: gaps and NaN stay in the log and are reported;
`aerodima.workbench.logs.signals` deals with them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from aerodima.workbench.core.array_types import FloatArray, IntArray
from aerodima.workbench.core.errors import LogError, ScenarioError
from aerodima.workbench.core.file_reading import Json, reading
from aerodima.workbench.core.yaml_files import find_file
from aerodima.workbench.logs.foreign_files import (
    ForeignLog,
    joined,
    read_bag,
    read_csv,
    read_mat,
    read_mcap,
    read_parquet,
)
from aerodima.workbench.logs.log_findings import (
    LogFinding,
    gap_findings,
    implausible_values,
    inconsistent_rates,
    nan_findings,
    table_findings,
)
from aerodima.workbench.logs.mapping import (
    CsvFormat,
    Mapping,
    known_columns,
)
from aerodima.workbench.logs.schema import RunLog, run_log_from_metadata, run_metadata
from aerodima.workbench.logs.signals import (
    GAP_FACTOR,
    UNWRAPPED,
    check_time,
    hold_last,
    median_step,
)
from aerodima.workbench.scenario.rig_scenario import RigScenario
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import RIG_KINDS, TIME

Findings = list[LogFinding]
_TEXT_FILES = (".csv", ".txt", ".tsv")
_READERS: dict[str, Callable[[Path], ForeignLog]] = {
    ".parquet": read_parquet,
    ".mat": read_mat,
    ".mcap": read_mcap,
    ".bag": read_bag,
    ".db3": read_bag,
    "/": read_bag,
}
_LEFT_OUT = "left out"
"""Beginning of the findings about columns that are not in the log."""
_REMEDY = "; is it cut off or damaged? Of a text: is it written as `csv` in the mapping says?"
_EQUAL_TIMES = " (`time.repeated: first`, or last, in the mapping keeps one of equal times)"


@dataclass(frozen=True)
class Imported:
    """A run log and what was odd in the files it came from."""

    run_log: RunLog
    findings: tuple[LogFinding, ...]


def import_log(paths: Sequence[Path | str] | Path | str, mapping: Mapping) -> Imported:
    """Reads foreign files of one run.

    Args:
        paths: path of one file, or of several that share a clock or have `time.offsets`; the
            columns of the second are called `2:<name>` in the mapping.
        mapping: mapping that says which column is which.

    Raises:
        LogError: a file cannot be read, the times are not increasing, no column is there; or, all
            at once, whatever else is wrong: a needed column is missing, a cell is not a number, a
            value betrays a wrong unit, the scenario. Names file, column and time.
    """
    if isinstance(paths, str | Path):
        paths = [paths]
    files = [Path(path) for path in paths]
    for number in mapping.time.offsets:
        if not 2 <= number <= len(files):
            raise LogError(f"mapping: time.offsets: {number}: must be from 2 to {len(files)} files")
    foreign = joined([read_foreign_log(file, mapping.csv) for file in files])
    foreign = foreign.combined(mapping.stamps, mapping.quaternions)
    table, findings, problems = mapped_table(foreign, mapping)
    units = {name: column.unit for name, column in known_columns().items()}
    largest = {name: source.largest for name, source in mapping.columns.items()}
    problems += implausible_values(table, units, largest)
    if mapping.check_rates:
        problems += inconsistent_rates(table)
    scenario: Json = {}
    try:
        scenario = _scenario(mapping)
    except ScenarioError as error:
        problems.append(str(error))
    if problems:
        problems += [str(finding) for finding in findings if finding.text.startswith(_LEFT_OUT)]
        raise LogError("; ".join(f"{foreign.path}: {problem}" for problem in problems))
    findings = [*findings, *table_findings(table, mapping.kind)]
    facts = mapping.facts
    if "tail" in facts:
        facts["tail"] = str(facts["tail"])
    facts["imported"] = {
        "files": [file.name for file in files],
        "mapping": mapping.model_dump(mode="json", by_alias=True, exclude_defaults=True),
        "findings": [str(finding) for finding in findings],
    }
    metadata = run_metadata(scenario, seed=0, kind=mapping.kind, extra=facts)
    return Imported(run_log_from_metadata(table, metadata, source=foreign.path), tuple(findings))


def read_foreign_log(path: Path, csv: CsvFormat) -> ForeignLog:
    """Reads a file by its ending: .csv, .txt, .tsv, .parquet, .mat, .mcap, .bag, .db3; or the
    folder of a bag of ROS 2.

    Raises:
        LogError: missing, of another kind, damaged, or an optional package is not installed (names
            the extra).
    """
    suffix = "/" if path.is_dir() else path.suffix.lower()
    if not path.exists():
        raise LogError(f"{path}: no such file")
    readers = _READERS | dict.fromkeys(_TEXT_FILES, partial(read_csv, form=csv))
    if suffix not in readers:
        found = suffix or "a file without ending"
        raise LogError(f"{path}: {found} is not read; must be {' '.join(readers)}")
    with reading(path, f"a {suffix} file", LogError, _REMEDY):
        foreign = readers[suffix](path)
    if not foreign.columns:
        reasons = [f"{name}: {reason}" for name, reason in foreign.unreadable.items()]
        raise LogError(f"{path}: no column of numbers; {'; '.join(reasons) or 'it is empty'}")
    return foreign


def mapped_table(foreign: ForeignLog, mapping: Mapping) -> tuple[pd.DataFrame, Findings, list[str]]:
    """Makes the table of a run log from foreign columns: SI units, one time grid, `time_s` first.

    Returns:
        The table, findings, and problems of columns, which the table then lacks.

    Raises:
        LogError: the times cannot be read or are not increasing, no column is there.
    """
    findings: Findings = []
    problems = []
    time, rows = _times(foreign, mapping, mapping.time.from_, mapping.time.unit, findings)
    columns = {TIME: time}
    held = []
    known = {None, *foreign.columns, *foreign.unreadable}
    there = ", ".join(foreign.columns)
    for name, source in mapping.columns.items():
        if source.from_ not in known:
            text = f"{_LEFT_OUT}: the file has no column {source.from_!r}; it has {there}"
            findings.append(LogFinding(name, None, text))
            continue
        try:
            values, other_times = _column(foreign, mapping, name, (time, rows), findings)
        except LogError as error:
            problems.append(str(error).removeprefix(f"{foreign.path}: "))
            continue
        if not np.isfinite(values).any():
            findings.append(LogFinding(name, None, f"{_LEFT_OUT}: not one sample is a number"))
            continue
        columns[name] = values
        if other_times:
            held.append(name)
    angle = mapping.columns.get("angle_rad")
    if mapping.kind != "car_log" and angle is not None and angle.from_ not in known:
        problems.append(f"no column {angle.from_!r}, which angle_rad comes from")
    constant = all(mapping.columns[name].constant is not None for name in columns if name != TIME)
    if constant and not problems:
        raise LogError(f"{foreign.path}: none of the mapped columns is there; it has {there}")
    findings += _unused(foreign, mapping)
    table = pd.DataFrame(columns)
    first = table[held].notna().idxmax()  # row of the first sample of each
    start = int(first.max()) if held else 0
    if start:
        text = f"its first sample is here; the {start} earlier rows of the log are left out"
        findings.append(LogFinding(str(first.idxmax()), float(time[start]), text))
        table = table.iloc[start:].reset_index(drop=True)
    if mapping.time.starts_at is not None:
        table[TIME] += mapping.time.starts_at - table[TIME].iloc[0]
    return table, findings, problems


def _column(
    foreign: ForeignLog,
    mapping: Mapping,
    name: str,
    grid: tuple[FloatArray, IntArray],
    findings: Findings,
) -> tuple[FloatArray, bool]:
    """Puts a column of the run log on the grid, times (s) and the rows that have them; also returns
    whether its own times differ, so that it is held.
    """
    time, rows = grid
    source = mapping.columns[name]
    if source.from_ is None:
        return np.full(time.size, source.constant, float), False
    factor = source.scale * mapping.unit_factor(name)
    values = factor * (foreign.numbers(source.from_) - source.zero)
    own = source.time or foreign.time_of.get(source.from_, "")
    if own in ("", foreign.time_of.get(mapping.time.from_)):  # of the same messages as the rows
        own = mapping.time.from_
    sample_time = time
    if own != mapping.time.from_:
        unit = source.time_unit or (mapping.time.unit if source.time else "s")
        sample_time, rows = _times(foreign, mapping, own, unit, findings)
    where = f"{foreign.path}: column {source.from_!r}"
    samples = foreign.columns[own].size
    if values.size != samples:
        raise LogError(
            f"{where} has {values.size} samples for {samples} times of {own!r}; name the column "
            "with its own times as `time`"
        )
    values = values[rows]
    if mapping.sparse:
        sampled = np.isfinite(values)
        sample_time = sample_time[sampled]
        values = values[sampled]
    if name in UNWRAPPED:
        finite = np.isfinite(values)
        values[finite] = np.unwrap(values[finite])
    if sample_time is time:
        return values, False
    if sample_time.size == 0:
        return np.full(time.size, np.nan), True
    if sample_time.size < 2:
        raise LogError(f"{where}: {sample_time.size} sample(s), at least 2 are needed")
    if sample_time[-1] < time[0] or time[-1] < sample_time[0]:
        raise LogError(
            f"{where}: its times, from {sample_time[0]:.10g} s, do not meet those of the log, from "
            f"{time[0]:.10g} s; state `time.offsets` of files with different clocks"
        )
    if not mapping.sparse or sample_time.size < time.size:
        findings += gap_findings(sample_time, name)
        findings += nan_findings(sample_time, name, values)
        last = float(sample_time[-1])
        age = time[-1] - last
        if age > GAP_FACTOR * median_step(sample_time):
            text = f"no sample in the last {age:.3g} s of the log, the value is held"
            findings.append(LogFinding(name, last, text))
    return hold_last(time, sample_time, values), True


def _times(
    foreign: ForeignLog, mapping: Mapping, name: str, unit: str, findings: Findings
) -> tuple[FloatArray, IntArray]:
    """Reads a column of times, s, and the rows of the file that count: only one of those with the
    same time if the mapping says which.
    """
    time = foreign.times(name, unit)
    for file, offset in mapping.time.offsets.items():
        if mapping.stamps.get(name, [name])[0].startswith(f"{file}:"):
            time = time + offset
    rows = np.arange(time.size)
    if mapping.time.repeated is not None:
        rows = pd.Series(time).drop_duplicates(keep=mapping.time.repeated).index.to_numpy()
        if rows.size < time.size:
            text = f"left out: {time.size - rows.size} row(s) with the time of another"
            findings.append(LogFinding(name, None, text))
    time = time[rows]
    try:
        check_time(time, name)
    except LogError as error:
        remedy = _EQUAL_TIMES if np.any(time[1:] == time[:-1]) else ""
        raise LogError(f"{foreign.path}: {error}{remedy}") from None
    return time, rows


def _unused(foreign: ForeignLog, mapping: Mapping) -> Findings:
    """Lists the columns of the files that cannot be read, or are not in the mapping."""
    used: set[str | None] = {mapping.time.from_, *foreign.time_of.values()}
    for source in mapping.columns.values():
        used |= {source.from_, source.time}
    for parts in [*mapping.stamps.values(), *mapping.quaternions.values()]:
        used |= {*parts}
    names = [name for name in foreign.columns if not name.endswith("@publish_time")]
    unused = ", ".join(name for name in names if name not in used)
    findings = [
        LogFinding(name, None, f"not read: {reason}") for name, reason in foreign.unreadable.items()
    ]
    if unused:
        text = f"columns of the file that are not in the mapping: {unused}"
        findings.append(LogFinding("", None, text))
    return findings


def _scenario(mapping: Mapping) -> Json:
    """Loads the car or the rig that a mapping names; a rig without its experiment, which the
    metadata state.
    """
    if mapping.scenario is None:
        return {}
    kind = RigScenario if mapping.kind in RIG_KINDS else Scenario
    path = find_file(mapping.scenario.base, kind.folder, "scenario", start=mapping.folder)
    content = kind.load(path, mapping.scenario.set).resolved()
    if kind is RigScenario:
        for key in ("experiment", "schema", "name", "seed"):
            del content[key]
    return content
