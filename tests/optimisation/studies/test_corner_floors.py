"""Floors: the climb that finds critical frictions, and the store in which its runs are kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from aerodima.optimisation.studies import study_store
from aerodima.optimisation.studies.study_store import open_runs
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, Case, Search, find_thresholds
from aerodima.optimisation.sweep.study_engine import RunTask
from aerodima.workbench.errors import UserError


class Island:
    """Clean up to a friction; below 0.72 also beyond 0.955."""

    workers, startup = 1, 0.0

    def __init__(self, clean_below: float) -> None:
        self._clean_below = clean_below

    def rows(self, tasks: Sequence[RunTask], done: Any = None) -> list[dict[str, Any]]:
        rows = []
        for place, task in enumerate(tasks):
            friction = float(task.settings[-1].partition("=")[2])
            clean = friction <= self._clean_below + 1e-9 or (self._clean_below == 0.72 and friction > 0.955)
            rows.append({"outcome": "survived" if clean else "flipped", "clean": clean})
            if done is not None:
                done(place, rows[-1])
        return rows

    def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
        return [function(item) for item in items]


@pytest.mark.parametrize(
    ("clean_below", "start", "survived", "lost"),
    [(0.72, 0.6, 0.72, 0.73), (0.72, 0.9, 0.72, 0.73), (2.0, 0.6, 1.0, None), (0.1, 0.6, None, 0.3)],
)
def test_a_climb_ends_at_the_first_loss(
    clean_below: float, start: float, survived: float | None, lost: float | None
) -> None:
    climb = Search(FRICTION, 0.3, 1.0, 0.1, 0.01)
    (found,) = find_thresholds([Case("", "turn_fast")], climb, Island(clean_below), starts=[start])
    assert found.survived == (None if survived is None else pytest.approx(survived))
    assert found.lost == (None if lost is None else pytest.approx(lost))


def test_runs_of_other_parameters_are_not_gone_on_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_runs(tmp_path) as store:
        store.add("one", {"outcome": "survived"})
    with open_runs(tmp_path) as store:
        assert store.rows["one"]["outcome"] == "survived"
    monkeypatch.setattr(study_store, "default_values", lambda: {"car": {"mass": 7.0}})
    with pytest.raises(UserError, match="holds results of other parameters"), open_runs(tmp_path):
        pass
    with open_runs(tmp_path, force=True) as store:
        assert not store.rows
