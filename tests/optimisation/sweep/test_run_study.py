"""A stopped study goes on, its table is the same as without a stop; one client at a time; a full
disk loses nothing.
"""

import errno
import json
import subprocess
import sys

import pandas as pd
import pyarrow.parquet as pq
import pytest

from aerodima.optimisation.sweep.run_study import (
    METADATA_KEY,
    ROWS,
    TABLE,
    open_store,
    read_table,
    run_study,
)
from aerodima.optimisation.sweep.runs import make_frame
from aerodima.optimisation.sweep.study import load_study
from aerodima.workbench.batch.engine import Engine
from aerodima.workbench.batch.row_store import RowStore
from aerodima.workbench.errors import SweepError
from aerodima.workbench.logs.schema import read_run_log
from tests.optimisation.sweep.tiny import tiny_study, write_study
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
    assert "stopped: 3 of 4 runs are kept" in said[-1]
    assert not (out / TABLE).exists()
    run_study(study, out, second, progress=said.append)
    assert (len(first.names), len(second.names)) == (3, 1)
    assert not set(first.names) & set(second.names)
    assert (out / TABLE).read_bytes() == (undisturbed / TABLE).read_bytes()
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
from aerodima.optimisation.sweep.run_study import run_study
from aerodima.optimisation.sweep.runs import make_frame
from aerodima.optimisation.sweep.study import load_study
from aerodima.workbench.batch.engine import Engine
run_study(load_study(Path({str(tiny_study(tmp_path))!r})), Path({str(tmp_path / "out")!r}),
Engine())
"""
    subprocess.run([sys.executable, "-c", code], check=True)
    assert (tmp_path / "out" / TABLE).read_bytes() == (undisturbed / TABLE).read_bytes()


def test_table_is_tidy_and_carries_the_study(undisturbed):
    table = read_table(undisturbed)
    assert len(table) == 4
    assert table["manoeuvre.speed"].tolist() == pytest.approx([1.0, 4 / 3, 5 / 3, 2.0])
    assert (table["outcome"] == "survived").all()
    assert not [name for name in table.columns if "wall" in name or "created" in name]
    metadata = json.loads(pq.read_schema(undisturbed / TABLE).metadata[METADATA_KEY])
    assert metadata["study"]["name"] == "tiny"
    assert json.loads((undisturbed / "timing.json").read_text())["runs_of_the_last_call"] == 4


def test_member_that_makes_no_plant_is_a_row_with_its_reason(tmp_path):
    study = load_study(write_study(tmp_path / "s.yaml", "grid:\n  car.mass: [6.0, 1.3]\n"))
    said = []
    table = run_study(study, tmp_path / "out", Engine(), progress=said.append)
    assert table["outcome"].tolist()[0] == "survived"
    assert pd.isna(table["outcome"].iloc[1])
    assert table["error"].iloc[1]
    assert "1 failed, the first: " in said[-1]


def test_second_client_and_another_study_are_refused(tmp_path, undisturbed):
    study = load_study(tiny_study(tmp_path))
    out = tmp_path / "out"
    busy = pytest.raises(SweepError, match="another process works in it")
    with open_store(out, {"runs": "others"}), busy:
        run_study(study, out, Engine())
    with pytest.raises(SweepError, match="holds results of other parameters"):
        run_study(study, out, Engine())
    run_study(study, out, Engine(), force=True)
    assert (out / TABLE).read_bytes() == (undisturbed / TABLE).read_bytes()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    with pytest.raises(SweepError, match=r"holds other files \(thesis\.tex\)"):
        run_study(study, tmp_path / "mine", Engine())


class Full:
    """A file on a full disk."""

    def write(self, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self):
        pass


def test_full_disk_is_one_clear_error_and_what_was_written_is_used_again(
    tmp_path, undisturbed, monkeypatch
):
    study = load_study(tiny_study(tmp_path))
    out = tmp_path / "out"
    whole = RowStore._write
    rows = []

    def full_after_two_rows(store, data):
        if b'"key"' in data:
            if len(rows) == 2:
                store._stream.write(data[:40])
                store._stream = Full()
            rows.append(data)
        whole(store, data)

    with monkeypatch.context() as patch:
        patch.setattr(RowStore, "_write", full_after_two_rows)
        with pytest.raises(SweepError, match=r"cannot be written \(No space left on device\)"):
            run_study(study, out, Engine())
    rest = Stopping(-1)
    run_study(study, out, rest)
    assert len(rest.names) == 2
    assert (out / TABLE).read_bytes() == (undisturbed / TABLE).read_bytes()


def test_damaged_line_costs_its_row_alone(tmp_path):
    for expected in ({}, {"1": {"outcome": "survived"}}):
        with open_store(tmp_path / "out", {}) as opened:
            assert opened.rows == expected
            opened.add("0", {"outcome": "flipped"})
            opened.add("1", {"outcome": "survived"})
        path = tmp_path / "out" / ROWS
        path.write_text(path.read_text().replace('{"key": "0", "outcome": "f', '{"key": "0", "ou'))


def test_kind_of_a_column_does_not_depend_on_the_order_of_the_rows():
    rows = [
        {"clean": None, "peak": None, "n": 1, "error": "x"},
        {"clean": True, "peak": 0.5, "n": 2.0, "error": ""},
    ]
    there = make_frame(rows)
    back = make_frame(rows[::-1])
    assert there.dtypes.to_dict() == back.dtypes.to_dict()
    assert [str(kind) for kind in there.dtypes] == [
        "boolean",
        "float64",
        "float64",
        str(pd.Series(["x"]).dtype),
    ]


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
    table = run_study(load_study(path), tmp_path / "out", Engine())
    assert "A; allowed: within +-2.3 A" in table["error"][0]
    assert [(tmp_path / "out" / name).exists() for name in table["log"]] == [False, True]
