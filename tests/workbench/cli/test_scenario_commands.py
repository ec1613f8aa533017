"""`aerodima models export`, `diagram` and `range-of-motion`."""

import json

from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.view.model_figures import DiagramPicture
from tests.commands import done
from tests.refusals import assert_named


def test_export_is_the_whole_scenario():
    bundle = json.loads(done("models", "export", "turn_swing", "--set", "manoeuvre.speed=4.0"))
    assert (
        bundle["car"]["tyre_stiffness_front"] == 9869.34
    )  # Table 6.1: not in the scenario file, so resolved
    assert scenario_from_dict(bundle) == load_scenario("turn_swing", ["manoeuvre.speed=4.0"])


def test_diagram_is_a_picture(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(
        DiagramPicture, "render", lambda picture, kind: drawn.append(picture) or kind.encode()
    )
    out = tmp_path / "car.svg"
    done("models", "diagram", "turn_swing", "--out", out)
    assert out.read_text() == "svg"
    assert_named(drawn[0].text, ("car_station", "tail_controller", "driver", "roll_estimator"))


def test_diagram_without_graphviz_is_refused(refused, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "Graphviz" in refused("models", "diagram", "turn_none", "--out", tmp_path / "car.svg")
    assert ".jpeg" in refused("models", "diagram", "turn_none", "--out", tmp_path / "car.jpeg")
