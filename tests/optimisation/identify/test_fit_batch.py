"""Batches of fits: taken up again, never mixed, after a killed worker, too."""

import os
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.identify import fit_batch
from aerodima.optimisation.identify.fit_batch import WORKER_KILLED, fit_logs
from aerodima.workbench.core.errors import FitError
from tests.optimisation.identify.problems import fit_line
from tests.refusals import assert_refused


@pytest.fixture
def springs(tmp_path):
    """Springs of 1000, 1100 and 1200 N/m with a ripple."""
    paths = [tmp_path / f"spring_{number}.csv" for number in range(3)]
    x = np.arange(20) / 1000.0
    ripple = np.tile([0.01, -0.01], 10)
    for rate, path in zip((1000.0, 1100.0, 1200.0), paths, strict=True):
        table = pd.DataFrame({"displacement_m": x, "force_n": rate * x + ripple})
        table.to_csv(path, index=False)
    return paths


def fit_line_file(path):
    """Fits the CSV file of a spring: takes no time, where only the batch is tested."""
    return fit_line(*pd.read_csv(path, dtype=float).to_numpy().T, name=path)


def rates(batch):
    return [round(result.free[0].value, -2) for result in batch.results]


def test_a_second_call_takes_up_what_is_there_and_does_the_rest(springs, tmp_path):
    out = tmp_path / "fits"
    calls = []

    def work(name):
        calls.append(name)
        return fit_line_file(name)

    first = fit_logs(work, springs[:1], out, settings={})
    both = fit_logs(work, springs[:2], out, settings={})
    assert calls == [str(path) for path in springs[:2]]
    assert both.results[0] == first.results[0]
    springs[0].write_text(springs[0].read_text() + "\n0.031,110.0\n")
    again = fit_logs(work, springs[:2], out, settings={})
    assert (both.reused, again.reused) == (1, 1)


def test_results_of_other_settings_are_not_mixed(springs, tmp_path):
    fits = partial(fit_logs, fit_line_file, springs[:1], tmp_path / "fits")
    fits(settings={"fit": "springs"})
    assert_refused(lambda: fits(settings={"fit": "others"}), FitError, "settings")
    assert fits(settings={"fit": "others"}, force=True).reused == 0
    twice = partial(fit_logs, fit_line_file, springs[:1] * 2, tmp_path / "twice", settings={})
    assert_refused(twice, FitError, str(springs[0]))


def test_a_folder_in_which_every_fit_failed_takes_other_settings(tmp_path):
    log = tmp_path / "spring.csv"
    log.write_text("nothing")
    fits = partial(fit_logs, fit_line_file, [log], tmp_path / "fits")
    assert list(fits(settings={"rig": "a"}).failed) == [str(log)]
    assert fits(settings={"rig": "a"}).reused == 1
    assert (fits(settings={"rig": "b"}).reused, fits(settings={"rig": "b"}).reused) == (0, 1)


def fit_or_die(path, *, poison):
    """The fit of a spring, but the log of that name kills its process while `poison` exists."""
    if Path(path).stem == "spring_1" and poison.exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return fit_line_file(path)


@pytest.mark.slow
def test_a_log_that_kills_its_worker_does_not_stop_the_others(springs, tmp_path):
    poison = tmp_path / "poison"
    poison.touch()
    work = partial(fit_or_die, poison=poison)
    batch = fit_logs(work, springs, tmp_path / "fits", settings={}, workers=2)
    assert batch.failed == {str(springs[1]): WORKER_KILLED}
    assert rates(batch) == [1000.0, 1200.0]
    poison.unlink()
    again = fit_logs(work, springs, tmp_path / "fits", settings={}, workers=2)
    assert (again.failed, again.reused, len(again.results)) == ({}, 2, 3)


def test_fits_of_another_version_are_made_again(springs, tmp_path, monkeypatch):
    fits = partial(fit_logs, fit_line_file, springs, tmp_path / "fits", settings={})
    fits()
    monkeypatch.setattr(fit_batch, "software_versions", lambda: {"project": "0.0.0"})
    assert [fits().reused for _ in range(2)] == [0, 3]
