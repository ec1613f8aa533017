"""A stopped study goes on, its table is the same as without a stop; one client at a time; a full
disk loses nothing.
"""

import json
import shutil
import subprocess
import sys

import pandas as pd
import pyarrow.parquet as pq
import pytest

from aerodima.optimisation.studies.run_study import (
    METADATA_KEY,
    ROWS,
    TABLE,
    read_table,
    run_study,
)
from aerodima.optimisation.studies.runs import load_any_scenario, make_frame
from aerodima.optimisation.studies.study import Study, load_study
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.core.errors import SweepError
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.logs.schema import read_run_log
from tests.optimisation.studies.tiny import assert_same_table, tiny_study, write_study
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import signals_equal


class Stopping(Engine):
    """Is interrupted after so many runs, as by Ctrl-C."""

    def __init__(self, after):
        super().__init__()
        self.left = after
        self.names = []

    def map(self, work, tasks, done=None, lost=None):
        def count(place, row):
            done(place, row)
            self.names.append(row["settings"])
            self.left -= 1
            if self.left == 0:
                raise KeyboardInterrupt

        return super().map(work, tasks, count)


def assert_folder_refused(study, out):
    assert_refused(lambda: run_study(study, out, Engine()), SweepError, str(out))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    run_study(load_study(tiny_study(folder)), folder / "out", Engine())
    return folder / "out"


def test_stopped_study_goes_on_without_losing_or_doubling_a_run(tmp_path, undisturbed):
    study = load_study(tiny_study(tmp_path))
    out = tmp_path / "out"
    said = []
    first = Stopping(3)
    second = Stopping(-1)
    with pytest.raises(KeyboardInterrupt):
        run_study(study, out, first, progress=said.append)
    assert "3 of 4" in said[-1]
    assert not (out / TABLE).exists()
    run_study(study, out, second, progress=said.append)
    assert (len(first.names), len(second.names)) == (3, 1)
    assert not set(first.names) & set(second.names)
    assert_same_table(out, undisturbed)
    assert (out / "table.csv").read_bytes() == (undisturbed / "table.csv").read_bytes()
    third = Stopping(-1)
    pd.testing.assert_frame_equal(run_study(study, out, third), read_table(out))
    assert third.names == []


@pytest.mark.slow
def test_the_serial_engine_needs_no_dask(tmp_path, undisturbed):
    code = f"""
import sys
sys.modules["dask"] = sys.modules["distributed"] = None
from pathlib import Path
from aerodima.optimisation.studies.run_study import run_study
from aerodima.optimisation.studies.runs import make_frame
from aerodima.optimisation.studies.study import load_study
from aerodima.workbench.batch.engine import Engine
run_study(load_study(Path({str(tiny_study(tmp_path))!r})), Path({str(tmp_path / "out")!r}),
Engine())
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    assert_same_table(tmp_path / "out", undisturbed)


def test_table_is_tidy_and_carries_the_study(undisturbed):
    table = read_table(undisturbed)
    assert table["manoeuvre.speed"].tolist() == pytest.approx([1.0, 4 / 3, 5 / 3, 2.0])
    assert (table["outcome"] == "survived").all()
    assert not [name for name in table.columns if "wall" in name or "created" in name]
    metadata = json.loads(pq.read_schema(undisturbed / TABLE).metadata[METADATA_KEY])
    study = load_study(undisturbed.parent / "study.yaml")
    assert Study.model_validate(metadata["study"]) == study
    assert json.loads((undisturbed / "timing.json").read_text())["runs_of_the_last_call"] == 4


def test_a_folder_of_other_results_is_refused_and_made_anew_by_force(tmp_path, undisturbed):
    study = load_study(tiny_study(tmp_path))
    out = tmp_path / "out"
    with RowStore(out / ROWS, {"runs": "others"}):
        assert_folder_refused(study, out)
    assert_folder_refused(study, out)
    run_study(study, out, Engine(), force=True)
    assert_same_table(out, undisturbed)


@pytest.mark.parametrize("other", ["default_values", "software_versions", "load_any_scenario"])
def test_results_of_another_car_or_version_are_not_mixed(tmp_path, undisturbed, monkeypatch, other):
    """The same study with another parameter file, version or scenario of the same name."""
    out = shutil.copytree(undisturbed, tmp_path / "out")
    study = load_study(tiny_study(undisturbed.parent))
    changed = {"car.mass": 9.0}
    if other == "load_any_scenario":
        changed = load_any_scenario("straight", ["car.mass=6.9"])
    module = sys.modules[run_study.__module__]
    monkeypatch.setattr(module, other, lambda *_: changed)
    assert_folder_refused(study, out)


@pytest.mark.parametrize("logs", [False, True])
def test_runs_of_an_edited_file_are_made_again_and_never_beside_old_logs(tmp_path, logs):
    swing = tmp_path / "swing.yaml"
    thesis = model_path("swings/thesis_8_rad_per_s.yaml").read_text()
    swing.write_text(thesis)
    grid = f"grid: {{controller.swing_file: [{swing}], manoeuvre.speed: [1.0, 1.1]}}\n"
    path = write_study(tmp_path / "study.yaml", f"logs: {str(logs).lower()}\n{grid}")
    engine = Stopping(-1)
    run_study(load_study(path), tmp_path / "out", engine)
    swing.write_text(thesis.replace("velocity_rad_per_s: 8", "velocity_rad_per_s: 9"))
    if logs:
        assert_folder_refused(load_study(path), tmp_path / "out")
        return
    for made in (4, 4):
        run_study(load_study(path), tmp_path / "out", engine)
        assert len(engine.names) == made


def test_other_weights_of_an_ensemble_are_other_results(tmp_path):
    cars = tmp_path / "cars.yaml"
    members = "[{name: a, weight: 1, values: {}}, {name: b, weight: 1, values: {car.mass: 5.5}}]"
    cars.write_text(
        f"schema: aerodima/ensemble/1\nname: two\nprovenance: {{}}\nbest: a\nmembers: {members}\n"
    )
    path = write_study(tmp_path / "study.yaml", f"ensemble: {cars}\n")
    table = run_study(load_study(path), tmp_path / "out", Engine())
    assert table["weight"].tolist() == [0.5, 0.5]
    cars.write_text(cars.read_text().replace("weight: 1", "weight: 3", 1))
    assert_folder_refused(load_study(path), tmp_path / "out")


def test_kind_of_a_column_does_not_depend_on_the_order_of_the_rows():
    rows = [
        {"clean": None, "peak": None, "n": 1, "error": "x"},
        {"clean": True, "peak": 0.5, "n": 2.0, "error": ""},
    ]
    there = make_frame(rows)
    back = make_frame(rows[::-1])
    assert there.dtypes.to_dict() == back.dtypes.to_dict()
    text = str(pd.Series(["x"]).dtype)
    assert list(map(str, there.dtypes)) == ["boolean", "float64", "float64", text]


def test_study_of_a_rig_keeps_its_logs_and_makes_only_those_that_are_missing(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(
        """
scenario: static
logs: true
settings: [experiment.duration=0.3, experiment.wind_off=0.1, aero.source=constant]
grid: {experiment.tail: [1, 3], experiment.angle: [0.0, 1.3]}
sample:
  number: 2
  anew: true
  new_seeds: true
  factors: {tunnel.psi3: {low: -0.1, high: 0.1}, experiment.angle: {low: 0.001, high: 0.003}}
"""
    )
    study = load_study(path)
    out = tmp_path / "out"
    first = Stopping(-1)
    second = Stopping(-1)
    table = run_study(study, out, first)
    assert len(first.names) == len(set(table["seed"])) == len(set(table["tunnel.psi3"])) == 8
    angles = table["angle_rad"] - [0.0, 0.0, 1.3, 1.3] * 2
    assert angles.between(0.001, 0.003).all()
    assert table["tail"].tolist() == ["1"] * 4 + ["3"] * 4
    log = read_run_log(out / table["log"][5])
    assert log.extra["truth"]["psi3"] == table["true_psi3"][5] == table["tunnel.psi3"][5]
    (out / table["log"][5]).unlink()
    pd.testing.assert_frame_equal(run_study(study, out, second), table)
    assert second.names == [table["settings"][5]]
    assert signals_equal(read_run_log(out / table["log"][5]), log)


def test_log_of_a_rig_that_cannot_be_made_is_a_row_with_its_reason(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(
        "scenario: static\nlogs: true\nsettings: [experiment.duration=0.3, "
        "maxon.current_limit=2.3]\n"
        "grid: {experiment.angle: [0.0, 1.3]}\n"
    )
    out = tmp_path / "out"
    said = []
    table = run_study(load_study(path), out, Engine(), progress=said.append)
    assert pd.isna(table["outcome"][0])
    assert "2.3 A" in table["error"][0]
    assert table["error"][0] in said[-1]
    assert [(out / name).exists() for name in table["log"]] == [False, True]
