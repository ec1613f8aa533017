"""`aerodima models export`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from aerodima.workbench.config.scenario import load_scenario, scenario_from_dict


def test_export_is_the_whole_scenario(call: Callable) -> None:
    result = call("models", "export", "turn_swing", "--set", "manoeuvre.speed=4.0")
    assert result.exit_code == 0, result.output
    bundle = json.loads(result.stdout)
    assert bundle["car"]["tyre_stiffness_front"] == 9869.34  # Table 6.1: not in the scenario file, so resolved
    assert scenario_from_dict(bundle) == load_scenario("turn_swing", ["manoeuvre.speed=4.0"])


def test_export_to_a_file_is_not_overwritten(call: Callable, refused: Callable, tmp_path: Path) -> None:
    out = tmp_path / "bundle.json"
    assert call("models", "export", "turn_none", "--out", out).exit_code == 0
    before = out.read_text()
    assert "--force" in refused("models", "export", "turn_swing", "--out", out)
    assert out.read_text() == before


def test_unknown_scenario_names_the_nearest(refused: Callable) -> None:
    assert "did you mean 'turn_none'?" in refused("models", "export", "turn_nune")
