"""How long tests take: `python -m tests.durations` lists those that take more than they may.

`out/tests/durations.csv` holds the latest duration of every test that was run in the checkout. A
test above `MAX_SECONDS` stands in
`tests/slow_tests.toml` with its seconds on a quiet machine and the reason. The command ends with
status 1 if a test is missing there, or takes more than twice its seconds. On a slower machine
every limit is longer by the factor of the median entry.
"""

import csv
import statistics
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tests.code_measure import ROOT

DURATIONS = ROOT / "out" / "tests" / "durations.csv"
BUDGETS = ROOT / "tests" / "slow_tests.toml"
MAX_SECONDS = 3.0
"""Longest test that needs no entry, s."""
SLACK = 2.0
"""Factor by which a busy machine may exceed an entry."""
PACED = frozenset({"realtime", "emulated", "nightly"})
"""Marks of tests whose length a clock or a number of draws sets, not the code."""


def write_durations(stats: Mapping[str, Iterable[Any]], path: Path) -> None:
    """Stores the seconds of each test, set-up and tear-down included, the longest first.

    Tests of a mark of `PACED` are left out.
    """
    measured: dict[str, float] = defaultdict(float)
    for reports in stats.values():
        for report in reports:
            is_timed = hasattr(report, "duration") and hasattr(report, "when")
            if is_timed and PACED.isdisjoint(report.keywords):
                measured[report.nodeid] += report.duration
    if not measured:
        return
    seconds = {**read_durations(path), **measured} if path.is_file() else measured
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["test", "seconds"])
        for test, value in sorted(seconds.items(), key=lambda item: -item[1]):
            writer.writerow([test, f"{value:.3f}"])


def read_durations(path: Path) -> dict[str, float]:
    """Seconds of each test of the last run."""
    with path.open(newline="", encoding="utf-8") as file:
        return {row["test"]: float(row["seconds"]) for row in csv.DictReader(file)}


def read_budgets(path: Path) -> dict[str, float]:
    """Seconds of each entry: a test without its parameters."""
    entries = tomllib.loads(path.read_text(encoding="utf-8")).get("test", [])
    return {entry["name"]: float(entry["seconds"]) for entry in entries}


def longest_cases(durations: Mapping[str, float]) -> dict[str, float]:
    """Seconds of the longest case of each test, by the test's name without its parameters."""
    longest: dict[str, float] = defaultdict(float)
    for test, seconds in durations.items():
        name = test.partition("[")[0]
        longest[name] = max(longest[name], seconds)
    return longest


def machine_factor(durations: Mapping[str, float], budgets: Mapping[str, float]) -> float:
    """Factor by which this machine is slower than that of the entries: their median, at least 1.

    One slow test moves the median of all entries by little, so it is found on any machine.
    """
    longest = longest_cases(durations)
    ratios = [longest[name] / budget for name, budget in budgets.items() if name in longest]
    return max(1.0, statistics.median(ratios)) if ratios else 1.0


def too_slow(
    durations: Mapping[str, float], budgets: Mapping[str, float], factor: float = 1.0
) -> list[str]:
    """One line for each test that has no entry, or takes more than `SLACK` times its seconds.

    Args:
        durations: seconds of each case of each test.
        budgets: seconds of each entry.
        factor: `machine_factor`; both limits are multiplied by it.
    """
    lines = []
    for test, seconds in durations.items():
        budget = budgets.get(test.partition("[")[0])
        if budget is None and seconds > factor * MAX_SECONDS:
            lines.append(f"{test}: {seconds:.1f} s, no entry in {BUDGETS.name}")
        elif budget is not None and seconds > factor * SLACK * budget:
            lines.append(f"{test}: {seconds:.1f} s, entry: {budget} s")
    return lines


def main() -> int:
    """Prints the list; returns the status of the command."""
    if not DURATIONS.is_file():
        print(f"error: {DURATIONS} is missing; run `make test-all` first", file=sys.stderr)
        return 2
    durations, budgets = read_durations(DURATIONS), read_budgets(BUDGETS)
    factor = machine_factor(durations, budgets)
    print(f"this machine takes {factor:.2f} times the seconds of {BUDGETS.name}")
    lines = too_slow(durations, budgets, factor)
    for line in lines:
        print(line)
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
