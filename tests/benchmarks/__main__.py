"""Runs every `bench_*` function of the modules `tests/benchmarks/bench_*.py`, prints and writes
what they measured.

A benchmark function takes nothing and returns an iterable of `BenchRow`. A goal that is missed is
marked in the table; the exit status is 1 if a benchmark fails to run, or gives no row and does not
raise `NotPermittedError`. What failed and what was left out is listed at the end.
"""

import argparse
import csv
import inspect
import sys
import traceback
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path

from tests.benchmarks.rows import CSV_HEADER, BenchRow, NotPermittedError

Benchmark = Callable[[], Iterable[BenchRow]]


def collect(selected: str) -> list[Benchmark]:
    """Benchmark functions whose `module.function` contains `selected`, by module and line."""
    found: list[Benchmark] = []
    for path in sorted(Path(__file__).parent.glob("bench_*.py")):
        module = import_module(f"tests.benchmarks.{path.stem}")
        functions = [
            function
            for name, function in inspect.getmembers(module, inspect.isfunction)
            if name.startswith("bench_") and function.__module__ == module.__name__
        ]
        functions.sort(key=lambda function: function.__code__.co_firstlineno)
        found += [
            function for function in functions if selected in f"{path.stem}.{function.__name__}"
        ]
    return found


def write_csv(rows: Iterable[BenchRow], path: Path) -> None:
    """Write the rows under `CSV_HEADER`; makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(CSV_HEADER)
        writer.writerows(row.cells() for row in rows)


def run(benchmarks: Iterable[Benchmark], out: Path) -> int:
    """Prints every row as it comes and writes them all; the exit status."""
    rows: list[BenchRow] = []
    failed: list[str] = []
    left_out: list[str] = []
    line = "{:<44} {:>12} {:<6} {:<9} {:>12} {:>8}  {}"
    print(line.format(*CSV_HEADER, ""))
    for benchmark in benchmarks:
        name = f"{benchmark.__module__}.{benchmark.__name__}"
        before = len(rows)
        try:
            for row in benchmark():
                rows.append(row)
                print(
                    line.format(*row.cells(), {True: "", False: "MISSED", None: ""}[row.met]),
                    flush=True,
                )
            if len(rows) == before:
                raise RuntimeError("it measured nothing")
        except NotPermittedError as reason:
            left_out.append(f"{name}: {reason}")
        except Exception:
            failed.append(name)
            print(f"{name} failed:", file=sys.stderr)
            traceback.print_exc()
    write_csv(rows, out)
    print(f"wrote {out}", *(f"left out: {text}" for text in left_out), sep="\n")
    if failed:
        print(f"failed to run: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


def main() -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("out/bench/bench.csv"), help="where the CSV goes"
    )
    parser.add_argument(
        "-k", dest="selected", default="", help="only functions whose module.name contains this"
    )
    arguments = parser.parse_args()
    benchmarks = collect(arguments.selected)
    if not benchmarks:
        parser.error(f"-k {arguments.selected}: no benchmark has this in its name")
    return run(benchmarks, arguments.out)


if __name__ == "__main__":
    sys.exit(main())
