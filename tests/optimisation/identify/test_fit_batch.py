"""Batches of fits: a worker that is killed, a journal that is damaged."""

import os
import signal
from functools import partial
from pathlib import Path

import pytest

from aerodima.optimisation.identify import fit_batch
from aerodima.optimisation.identify.fit_batch import WORKER_KILLED, fit_logs
from aerodima.optimisation.identify.fit_pipeline import FitResult
from tests.optimisation.identify.line_file import fit_line_file


def fit_or_die(path: str, *, poison: Path) -> FitResult:
    """The fit of a spring, but the log of that name kills its process while `poison` exists."""
    if Path(path).stem == "spring_1" and poison.exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return fit_line_file(path)


@pytest.mark.slow
def test_a_log_that_kills_its_worker_does_not_stop_the_others(tmp_path: Path) -> None:
    logs = []
    for number in range(4):
        rows = [
            f"{x / 1000},{(1000 + 100 * number) * x / 1000 + (-1) ** x * 0.01}" for x in range(20)
        ]
        logs.append(tmp_path / f"spring_{number}.csv")
        logs[-1].write_text("\n".join(["displacement_m,force_n", *rows]))
    poison = tmp_path / "poison"
    poison.touch()
    work = partial(fit_or_die, poison=poison)
    batch = fit_logs(work, logs, tmp_path / "fits", settings={}, workers=2)
    assert batch.failed == {str(logs[1]): WORKER_KILLED}
    assert [round(r.free[0].value, -2) for r in batch.results] == [1000.0, 1200.0, 1300.0]
    poison.unlink()
    again = fit_logs(work, logs, tmp_path / "fits", settings={}, workers=2)
    assert (again.failed, again.reused, len(again.results)) == ({}, 3, 4)


@pytest.mark.parametrize("damage", ["last line cut off", "header cut off", "other JSON", "no text"])
def test_a_damaged_journal_costs_only_the_damaged_lines(tmp_path: Path, damage: str) -> None:
    logs = []
    for number in range(3):
        logs.append(tmp_path / f"spring_{number}.csv")
        logs[-1].write_text(
            "\n".join(
                [
                    "displacement_m,force_n",
                    *(f"{x / 1000},{2 * x + (-1) ** x * 0.01}" for x in range(20)),
                ]
            )
        )
    first = fit_logs(fit_line_file, logs, tmp_path / "fits", settings={"a": 1})
    journal = tmp_path / "fits" / "fits.jsonl"
    whole = journal.read_bytes()
    lines = whole.splitlines(keepends=True)
    content, kept = {
        "last line cut off": (whole[:-40], 2),
        "header cut off": (lines[0][:5], 0),
        "other JSON": (b"".join([lines[0], b"5\n", b'{"log": "x"}\n', *lines[1:]]), 3),
        "no text": (b"".join([lines[0], b"\xff\xfe\n", *lines[1:]]), 3),
    }[damage]
    journal.write_bytes(content)
    for reused in (kept, 3):
        again = fit_logs(fit_line_file, logs, tmp_path / "fits", settings={"a": 1})
        assert (again.reused, again.failed) == (reused, {})
        assert [r.free[0].value for r in again.results] == [r.free[0].value for r in first.results]


def test_fits_of_another_version_are_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "spring.csv"
    rows = [f"{x / 1000},{2 * x + (-1) ** x * 0.01}" for x in range(20)]
    log.write_text("\n".join(["displacement_m,force_n", *rows]))
    for reused in (0, 1):
        assert fit_logs(fit_line_file, [log], tmp_path / "fits", settings={}).reused == reused
    monkeypatch.setattr(fit_batch, "software_versions", lambda: {"project": "0.0.0"})
    for reused in (0, 1):
        assert fit_logs(fit_line_file, [log], tmp_path / "fits", settings={}).reused == reused
