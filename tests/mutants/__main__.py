"""Applies each mutant of the tables in this folder to a copy of the checkout, one at a time, and
runs the tests that should notice it.

Usage: `python -m tests.mutants [--area AREA] [--file PART] [--jobs N]`.

A mutant is one plausible mistake: `file`, the text `find` that stands there exactly once, and
`replace`. `tests` names the files that are expected to notice it; they run first. If they pass, the
whole mirrored folder runs. The command ends with status 1 if a mutant cannot be applied, or if
fewer than 90 % are noticed. Before the first mutant the named files run without any, and must pass.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).resolve().parent.parent.parent
COPIED = (
    "src",
    "workbench",
    "optimisation",
    "hardware",
    "models",
    "tests",
    "docs",
    "notebooks",
    "pyproject.toml",
    "README.md",
    "CHANGELOG.md",
)
"""What the tests of a folder read."""
TIME_LIMIT = 600.0
"""Longest run of the tests on one mutant, s; a mutant that hangs counts as noticed."""
MIN_SHARE = 0.9
"""Share of the mutants that must be noticed."""
PASSED = 0
"""Status of pytest when all tests passed."""
FAILED = 1
"""Status of pytest when a test failed."""
NOTHING_RUN = 5
"""Status of pytest when no test has the marks; any further one says that nothing was judged."""
HUNG = -1
"""Stands for a run that did not end within `TIME_LIMIT`."""
FAST = "not slow and not realtime and not emulated and not nightly"
SLOW = "slow and not realtime and not emulated and not nightly"


@dataclass(frozen=True)
class Mutant:
    """One row of a table."""

    area: str
    file: str
    find: str
    replace: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """File, and the first line of what replaces the text."""
        lines = self.replace.strip().splitlines() or ["(removed)"]
        return f"{self.file}: {lines[0].strip()[:60]}"

    @property
    def folder(self) -> str:
        """Tests of the mirrored folder."""
        return str(Path("tests") / Path(self.file).parent)


@dataclass(frozen=True)
class Outcome:
    """What the tests made of a mutant."""

    mutant: Mutant
    noticed: bool
    detail: str
    seconds: float


def read_mutants(folder: Path) -> list[Mutant]:
    """All rows of the tables of a folder, in the order of their areas."""
    mutants = []
    for path in sorted(folder.glob("*.toml")):
        for row in tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]:
            tests = tuple(row["tests"])
            mutants.append(Mutant(path.stem, row["file"], row["find"], row["replace"], tests))
    return mutants


def misplaced(mutants: list[Mutant], root: Path) -> list[str]:
    """Mutants that cannot be applied, each with its reason."""
    problems = []
    for mutant in mutants:
        path = root / mutant.file
        count = path.read_text(encoding="utf-8").count(mutant.find) if path.is_file() else -1
        if count != 1:
            reason = "no such file" if count < 0 else f"`find` stands there {count} times"
            problems.append(f"{mutant.name}: {reason}")
        for name in mutant.tests:
            if not (root / name).exists():
                problems.append(f"{mutant.name}: no such test: {name}")
    return problems


def copy_checkout(root: Path, target: Path) -> None:
    """Copies what product and tests need; links in `src` stay links within the copy."""
    for name in COPIED:
        source = root / name
        if source.is_dir():
            ignored = shutil.ignore_patterns("__pycache__", ".ipynb_checkpoints")
            shutil.copytree(source, target / name, symlinks=True, ignore=ignored)
        else:
            shutil.copy2(source, target / name)


def run_tests(copy: Path, paths: list[str], marks: str) -> tuple[int, str]:
    """Status of pytest, and the first test that failed; `HUNG` after `TIME_LIMIT`."""
    environment = dict(os.environ)
    environment["PYTHONPATH"] = str(copy / "src")
    environment["PYTHONPYCACHEPREFIX"] = str(copy / ".pycache")
    environment["OMP_NUM_THREADS"] = "1"
    environment["OPENBLAS_NUM_THREADS"] = "1"
    environment["MPLBACKEND"] = "Agg"
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-m", marks, "-p", "no:cacheprovider"]
    try:
        done = subprocess.run(
            [*command, *paths],
            cwd=copy,
            env=environment,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return HUNG, f"hung for {TIME_LIMIT:.0f} s"
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return done.returncode, failed[0].partition(" - ")[0] if failed else ""


def judge(mutant: Mutant, copy: Path) -> Outcome:
    """Applies one mutant to a copy, runs the tests, and restores the file."""
    path = copy / mutant.file
    original = path.read_text(encoding="utf-8")
    start = time.monotonic()
    stages = [([*mutant.tests], FAST), ([*mutant.tests], SLOW)]
    if (copy / mutant.folder).exists():
        stages += [([mutant.folder], FAST), ([mutant.folder], SLOW)]
    path.write_text(original.replace(mutant.find, mutant.replace), encoding="utf-8")
    # A compiled file counts as current when time and size agree, and a mutant may keep both.
    os.utime(path, (time.time() + 10, time.time() + 10))
    try:
        for number, (paths, marks) in enumerate(stages):
            status, detail = run_tests(copy, paths, marks)
            first_stage = number == 0
            if status not in (PASSED, NOTHING_RUN):
                break
    finally:
        path.write_text(original, encoding="utf-8")
        os.utime(path, (time.time() + 20, time.time() + 20))
    noticed = status in (FAILED, HUNG)
    if status == FAILED and not first_stage:
        # Only the first stage was run without a mutant, so the test that failed must pass again.
        test = detail.removeprefix("FAILED ").removeprefix("ERROR ")
        again, _ = run_tests(copy, [test], "not realtime and not emulated")
        noticed = again == PASSED
    if status not in (PASSED, NOTHING_RUN, FAILED, HUNG):
        detail = f"pytest ended with status {status}: {detail}"
    return Outcome(mutant, noticed, detail, time.monotonic() - start)


def judge_all(mutants: list[Mutant], root: Path, jobs: int) -> list[Outcome]:
    """Judges all mutants in `jobs` copies at a time, and prints each outcome as it is known."""
    outcomes: list[Outcome] = []
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        copies: Queue[Path] = Queue()
        for number in range(jobs):
            copy = Path(folder) / f"copy{number}"
            copy.mkdir()
            copy_checkout(root, copy)
            copies.put(copy)
        named = sorted({name for mutant in mutants for name in mutant.tests})
        print(f"{len(named)} test files without a mutant first ...", flush=True)
        status, detail = run_tests(copy, named, FAST)
        if status != PASSED:
            raise SystemExit(f"error: a test fails without any mutant: {detail} (status {status})")

        def work(mutant: Mutant) -> Outcome:
            copy = copies.get()
            try:
                return judge(mutant, copy)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(jobs) as pool:
            for outcome in pool.map(work, mutants):
                outcomes.append(outcome)
                word = "noticed" if outcome.noticed else "NOT NOTICED"
                elapsed = time.monotonic() - begin
                left = elapsed / len(outcomes) * (len(mutants) - len(outcomes))
                print(
                    f"{len(outcomes):3d}/{len(mutants)} {word}: {outcome.mutant.name} "
                    f"({outcome.detail or 'all tests passed'}; {outcome.seconds:.0f} s, "
                    f"{left / 60:.0f} min left)",
                    flush=True,
                )
    return outcomes


def main() -> int:
    """Runs the command; returns its status."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.mutants",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--area", help="a table of this folder, without its ending")
    parser.add_argument("--file", help="only mutants of files whose path contains this")
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time (2)")
    options = parser.parse_args()
    mutants = read_mutants(Path(__file__).resolve().parent)
    mutants = [
        mutant
        for mutant in mutants
        if options.area in (None, mutant.area) and (options.file or "") in mutant.file
    ]
    if not mutants:
        print("error: no mutant has this area and file", file=sys.stderr)
        return 2
    problems = misplaced(mutants, ROOT)
    if problems:
        print("\n".join(problems), file=sys.stderr)
        return 1
    outcomes = judge_all(mutants, ROOT, options.jobs)
    survivors = [outcome.mutant.name for outcome in outcomes if not outcome.noticed]
    noticed = len(outcomes) - len(survivors)
    for name in survivors:
        print(f"survived: {name}")
    print(f"{noticed} of {len(outcomes)} mutants noticed ({100 * noticed / len(outcomes):.0f} %)")
    return int(noticed < MIN_SHARE * len(outcomes))


if __name__ == "__main__":
    sys.exit(main())
