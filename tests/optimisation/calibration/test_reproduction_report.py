from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerodima.optimisation.calibration.calibration_plan import fitted_names, load_plan
from aerodima.optimisation.calibration.reproduction_evidence import change_row, figure_row, share_row
from aerodima.optimisation.calibration.reproduction_report import write_reproduction_report
from aerodima.workbench.config.ensemble import Ensemble, load_ensemble
from aerodima.workbench.errors import UserError
from tests.optimisation.calibration.made_up_car import MadeUpEngine

HALF = np.array([0.5, 0.5])


class TailedToo(MadeUpEngine):
    """The made-up car with a held tail too."""

    def row(self, task):
        return super().row(replace(task, scenario=task.scenario.replace("held", "swing")))


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ([9.9, 10.2], "reproduced"),
        ([10.5, 10.9], "reproduced"),  # not in the band, but within 10 %
        ([4.0, 16.0], "not reproduced"),  # in the band, which excludes nothing
        ([13.0, 14.0], "not reproduced"),
        ([np.nan, np.nan], "not reproduced"),  # no car survives the run that the published one survived
        ([10.0, np.nan], "not reproduced"),  # half of the weight does not survive it
    ],
)
def test_a_figure_is_reproduced_only_by_a_band_that_could_have_missed_it(values, verdict) -> None:
    assert figure_row("T", "c", "m", 10.0, np.array(values), HALF, "").verdict == verdict


def test_a_change_of_the_right_sign_and_wrong_size_is_a_direction_only() -> None:
    assert change_row("T", "c", -40.0, np.array([-5.0, -8.0]), HALF, "").verdict == "direction only"
    assert change_row("T", "c", -40.0, np.array([-5.0, 8.0]), HALF, "").verdict == "not reproduced"
    assert change_row("T", "c", -40.0, np.array([5.0, 8.0]), HALF, "").verdict == "not reproduced"
    assert change_row("T", "c", -40.0, np.array([-5.0, np.nan]), HALF, "").verdict == "not reproduced"


def test_an_outcome_needs_nine_tenths_of_the_weight() -> None:
    assert share_row("T", "c", 0.9, "").verdict == "reproduced"
    assert share_row("T", "c", 0.89, "").verdict == "not reproduced"


def test_the_report_has_a_row_per_claim_and_says_what_is_missing(tmp_path: Path) -> None:
    page = write_reproduction_report(load_ensemble("car"), 3, tmp_path, TailedToo(), lambda line: None, replays=False)
    rows = pd.read_csv(tmp_path / "rows.csv").fillna({"evidence": ""})
    assert set(rows.verdict) <= {"reproduced", "direction only", "not reproduced", "not computable"}
    assert (rows.place == "Table 7.4").sum() == 8
    assert (rows.evidence.str.len() > 0).all()
    text = page.read_text(encoding="utf-8")
    assert "3 of" in text
    assert "Fig. 6.8" in text
    assert "55 %" in text


def calibrated(ensemble: Ensemble) -> Ensemble:
    """The ensemble as if it had been calibrated to what the plan fits."""
    return replace(ensemble, provenance=ensemble.provenance | {"fitted": fitted_names(load_plan("car"))})


def test_a_row_that_the_cars_were_calibrated_to_is_never_counted_as_a_prediction(tmp_path: Path) -> None:
    class HoldsTheBracket(TailedToo):
        def row(self, task):
            row = super().row(task)
            flips = row["commanded_speed_m_per_s"] > 3.5 and task.scenario == "turn_none"
            return row | {"outcome": "flipped" if flips else "survived"}

    plain = load_ensemble("car")
    counts = {}
    for name, ensemble in (
        ("all", replace(plain, provenance=plain.provenance | {"fitted": []})),
        ("plan", calibrated(plain)),
    ):
        page = write_reproduction_report(
            ensemble, 3, tmp_path / name, HoldsTheBracket(), lambda line: None, replays=False
        )
        rows = pd.read_csv(tmp_path / name / "rows.csv", keep_default_na=False)
        predicted = (rows.basis == "prediction").sum()
        kept = rows[(rows.basis == "prediction") & (rows.verdict == "reproduced")]
        assert f"{len(kept)} are reproduced as predictions (of {predicted})" in page.read_text()
        counts[name] = rows
    changed = counts["all"].basis != counts["plan"].basis
    assert set(counts["all"][changed].basis) == {"prediction"}
    assert set(counts["plan"][changed].basis) == {"calibrated to"}
    fitted = counts["plan"][counts["plan"].basis == "calibrated to"]
    assert (fitted.verdict == "reproduced").any()
    assert counts["all"].verdict.equals(counts["plan"].verdict)


def test_no_row_says_more_than_its_evidence(tmp_path: Path) -> None:
    class SomeFlipWithTheirTail(TailedToo):
        def row(self, task):
            row = super().row(task)
            heavy = any(setting in heavy_tails for setting in task.settings)
            return row | {"outcome": "flipped"} if heavy and task.scenario == "turn_swing" else row

    plain = load_ensemble("car")
    heavy_tails = {f"tail.mass={m.values['tail.mass']}" for m in plain.members if m.values["tail.mass"] > 0.15}
    write_reproduction_report(
        calibrated(plain), len(plain.members), tmp_path, SomeFlipWithTheirTail(), lambda line: None, replays=False
    )
    rows = pd.read_csv(tmp_path / "rows.csv", keep_default_na=False)
    bracket = rows[rows.claim.str.startswith("no tail: ")]
    assert set(bracket.basis) == {"calibrated to"}
    table = rows[(rows.place == "Table 7.1") & (rows.verdict != "not computable")]
    assert set(table.basis) == {"calibrated to"}  # Kohut too: yaw rate times the commanded speed
    assert set(rows[rows.place == "Table 7.3"].basis) <= {"prediction", ""}
    assert set(rows[rows.claim.str.startswith("tail: ")].basis) == {"prediction"}
    commanded = rows[rows.claim == "speed at the start of the turn"]
    assert len(commanded) == 4
    assert set(commanded.verdict) == {"not computable"}
    physical = rows[(rows.place == "Table 7.4") & (rows.basis != "")].set_index("claim").basis
    assert physical.to_dict() == {
        "largest yaw rate": "prediction",
        "mean yaw rate": "calibrated to",
        "largest lateral acceleration": "calibrated to",
        "mean lateral acceleration": "prediction",
        "largest Kohut": "prediction",
        "mean Kohut": "calibrated to",
        "roll integral": "prediction",
    }
    changes = rows[rows.place == "Table 7.3 to 7.4"].set_index("claim").basis
    assert (changes == "prediction").sum() == 4
    tailed = rows[(rows.place == "Table 7.2") & (rows.verdict != "not computable")]
    share = sum(member.weight for member in plain.members if member.values["tail.mass"] > 0.15)
    assert share > 0.1
    assert set(tailed.verdict) == {"not reproduced"}
    arithmetic = rows[rows.evidence.str.contains("printed numbers only")]
    assert set(arithmetic.basis) == {"printed numbers"}


def test_a_row_says_when_the_car_never_reached_its_turn(tmp_path: Path) -> None:
    class TipsOverBackwardsWhenFast(TailedToo):
        def row(self, task):
            row = super().row(task)
            fast = row["commanded_speed_m_per_s"] > 5.0
            return row | {"outcome": "flipped", "speed_m_per_s": 0.1} if fast else row

    write_reproduction_report(
        load_ensemble("car"), 2, tmp_path, TipsOverBackwardsWhenFast(), lambda line: None, replays=False
    )
    rows = pd.read_csv(tmp_path / "rows.csv", keep_default_na=False)
    fast = rows[rows.evidence.str.contains("100% of the weight tipped over before its turn")]
    assert (fast.place == "Table 7.4").sum() == 7
    assert (fast.place == "7.2.2").sum() == 2
    assert not rows[rows.place == "Table 7.2"].evidence.str.contains("tipped").any()


def test_survival_over_speed_says_who_flips_and_who_never_reached_the_turn(tmp_path: Path) -> None:
    class TipsAtTheFastestFlipsBelow(TailedToo):
        def row(self, task):
            row = super().row(task)
            speed = row["commanded_speed_m_per_s"]
            reached = {"speed_m_per_s": 0.1 if speed > 6.0 else speed}
            return row | {"outcome": "flipped" if speed > 5.0 else "survived", "clean": speed < 5.0} | reached

    engine, ensemble = TipsAtTheFastestFlipsBelow(), load_ensemble("car")
    page = write_reproduction_report(ensemble, 2, tmp_path, engine, lambda line: None, replays=False, survival=True)
    rows = pd.read_csv(tmp_path / "survival.csv").set_index(["tail", "speed_m_per_s"])
    assert len(rows) == 21
    assert rows.loc[("held", 4.72)].survived == pytest.approx(1.0)
    assert rows.loc[("swing", 5.28)].flipped_in_turn == pytest.approx(1.0)
    assert rows.loc[("none", 6.1)].members_tipped_before_turn == 2
    assert "At most 2 of 2 members tip over" in page.read_text(encoding="utf-8")
    figures = pd.read_csv(tmp_path / "figures.csv")
    assert {"use", "z", "z_with_discrepancy"} <= set(figures.columns)


def test_a_wrong_number_of_members_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="0 members of"):
        write_reproduction_report(load_ensemble("car"), 0, tmp_path, TailedToo(), lambda line: None, replays=False)


def test_a_member_that_is_no_possible_car_is_refused_before_anything_runs(tmp_path: Path) -> None:
    plain = load_ensemble("car")
    wrong = replace(plain.members[0], values={"car.gyration_roll": 0.45})
    with pytest.raises(UserError, match=rf"member '{wrong.name}': .*gyration_roll: 0\.45"):
        write_reproduction_report(replace(plain, members=(wrong,)), 1, tmp_path / "out", TailedToo(), lambda line: None)
    assert not (tmp_path / "out").exists()
