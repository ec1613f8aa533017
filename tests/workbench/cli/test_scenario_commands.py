"""`aerodima models export`, `diagram` and `range-of-motion`."""

import json

from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.view.model_figures import DiagramPicture


def test_export_is_the_whole_scenario(call):
    result = call("models", "export", "turn_swing", "--set", "manoeuvre.speed=4.0")
    assert result.exit_code == 0, result.output
    bundle = json.loads(result.stdout)
    assert (
        bundle["car"]["tyre_stiffness_front"] == 9869.34
    )  # Table 6.1: not in the scenario file, so resolved
    assert scenario_from_dict(bundle) == load_scenario("turn_swing", ["manoeuvre.speed=4.0"])


def test_export_to_a_file_is_not_overwritten(call, refused, tmp_path):
    out = tmp_path / "bundle.json"
    assert call("models", "export", "turn_none", "--out", out).exit_code == 0
    before = out.read_text()
    assert "--force" in refused("models", "export", "turn_swing", "--out", out)
    assert out.read_text() == before


def test_diagram_is_a_picture(call, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        DiagramPicture, "render", lambda picture, kind: drawn.append(picture) or kind.encode()
    )
    out = tmp_path / "car.svg"
    assert call("models", "diagram", "turn_swing", "--out", out).exit_code == 0
    assert out.read_text() == "svg"
    for part in ("car_station", "tail_controller", "driver", "roll_estimator"):
        assert part in drawn[0].text


def test_diagram_without_graphviz_is_refused(refused, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "Graphviz" in refused("models", "diagram", "turn_none", "--out", tmp_path / "car.svg")
    assert ".jpeg" in refused("models", "diagram", "turn_none", "--out", tmp_path / "car.jpeg")
