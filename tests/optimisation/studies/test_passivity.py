"""Passive and active tails on made-up cars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from aerodima.optimisation.studies.passivity_study import measure_passivity, tails, write_passivity
from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.optimisation.sweep.study_engine import RunTask
from aerodima.workbench.config.scenario import load_scenario


class StifferIsBetter:
    """A held tail keeps the car up to a friction that grows with its stiffness and falls with the speed."""

    workers, startup = 1, 0.0

    def rows(self, tasks: Sequence[RunTask], done: Any = None) -> list[dict[str, Any]]:
        rows = []
        for task in tasks:
            given = dict(setting.partition("=")[::2] for setting in task.settings)
            survived = 0.7 + 0.005 * float(given.get("controller.hold_kp", 17.0)) - 0.02 * (float(given[SPEED]) - 3.6)
            clean = float(given[FRICTION]) <= survived + 1e-9
            rows.append({"outcome": "survived" if clean else "flipped", "clean": clean, "peak_roll_rad": 0.1})
        return rows

    def call(self, function: Any, items: Sequence[Any]) -> list[Any]:
        return [function(item) for item in items]


def test_each_tail_has_its_critical_friction_and_the_picture_is_drawn(tmp_path: Path) -> None:
    table = measure_passivity(StifferIsBetter(), (3.6, 6.0))
    found = table.set_index(["tail", "speed_m_per_s"])["critical_friction"]
    assert found["held", 3.6] - found["loose on its stop", 3.6] == pytest.approx(0.085, abs=0.0126)
    assert found["held", 3.6] - found["held", 6.0] == pytest.approx(0.048, abs=0.0126)
    table_file, picture = write_passivity(table, tmp_path)
    assert table_file.read_text().count("\n") == 2 * len(tails()) + 1
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_tails_differ_in_what_their_names_say() -> None:
    gains = {}
    for tail in tails():
        scenario = load_scenario("turn_fast", list(tail.settings))
        gains[tail.name] = (scenario.tail.mode, scenario.controller.hold_kp, scenario.controller.swing_speed)
    assert gains["loose on its stop"][:2] == ("held", 0.0)
    assert gains["held"][:2] == ("held", 17.0)
    assert gains["12 rad/s"][::2] == ("swing", 12.0)
    assert len(set(gains.values())) == len(gains)
