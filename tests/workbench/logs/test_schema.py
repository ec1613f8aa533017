import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import (
    METADATA_KEY,
    encode_metadata,
    read_run_log,
    write_run_log,
)
from aerodima.workbench.scenario.signal_table import CAR_PORTS, CAR_TRUTH, Column
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import awkward_run, car_run_columns, made_up_run, signals_equal

UNIT_ENDINGS = {
    "m": "_m", "m/s": "_m_per_s", "m/s2": "_m_per_s2", "rad": "_rad", "rad/s": "_rad_per_s",
    "N": "_n",
    "N m": "_n_m", "N s": "_n_s", "N m s": "_n_m_s", "W": "_w", "s": "_s",
}  # fmt: skip


def test_every_column_ends_in_its_unit_and_has_a_meaning():
    for column in car_run_columns(("chassis_qw",)):
        assert column.meaning
        if column.unit in UNIT_ENDINGS:
            assert column.name.endswith(UNIT_ENDINGS[column.unit]), column


def test_what_is_written_comes_back_bit_for_bit(tmp_path):
    run = awkward_run(truth=True)
    run.table.loc[4, "roll_estimate_rad"] = -np.inf
    back = read_run_log(write_run_log(run, tmp_path / "new folder" / "run.parquet"))
    assert signals_equal(run, back)
    assert back.metadata() == run.metadata()
    assert (back.seed, back.kind, back.extra["tail_mass_kg"]) == (7, "car_run", 0.15)
    assert set(back.versions) == {"project", "drake", "python", "numpy"}


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.assign(throttle_command=0.0),
        lambda table: table.assign(imu_gyro_x_rad_per_s=1.0),
        lambda table: table.iloc[:-1],
        lambda table: table[[*table.columns[1:], table.columns[0]]],
        lambda table: table.drop(columns="status_armed"),
    ],
    ids=["sign of zero", "last bit", "a row less", "order", "a column less"],
)
def test_the_smallest_difference_makes_runs_unequal(change):
    run = awkward_run()
    assert signals_equal(run, replace(run, table=run.table.copy()))
    assert not signals_equal(run, replace(run, table=change(run.table)))


def test_pandas_reads_the_file_without_this_project(tmp_path):
    run = made_up_run()
    table = pd.read_parquet(write_run_log(run, tmp_path / "run.parquet"))
    assert list(table.columns) == list(run.table.columns)


def test_folder_names_with_an_equals_sign_add_no_column(tmp_path):
    run = made_up_run()
    assert signals_equal(
        run, read_run_log(write_run_log(run, tmp_path / "speed=3" / "run.parquet"))
    )


def test_existing_file_is_kept_without_force(tmp_path):
    path = tmp_path / "run.parquet"
    path.write_text("precious")
    assert_refused(lambda: write_run_log(made_up_run(), path), LogError, "run.parquet", "--force")
    assert path.read_text() == "precious"
    write_run_log(made_up_run(), path, force=True)
    assert len(read_run_log(path).table) == 2001


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_behind(tmp_path, monkeypatch):
    path = write_run_log(made_up_run(), tmp_path / "run.parquet")
    before = path.read_bytes()

    def disk_full(table, temporary, **options):
        Path(temporary).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", disk_full)
    assert_refused(
        lambda: write_run_log(made_up_run(), path, force=True), LogError, "No space left"
    )
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def write_parquet(path, table, metadata=None):
    """A Parquet file as another program might leave it."""
    encoded = {} if metadata is None else {METADATA_KEY: encode_metadata(metadata)}
    pq.write_table(table.replace_schema_metadata(encoded), path)
    return path


def file_for_folder(folder):
    (folder / "out").write_text("a file")
    write_run_log(made_up_run(), folder / "out" / "run.parquet")


def folder_for_file(folder):
    (folder / "runs").mkdir()
    write_run_log(made_up_run(), folder / "runs", force=True)


def journal_without_log(folder):
    (folder / "run.parquet.journal").write_bytes(b"")
    read_run_log(folder / "run.parquet")


def other_version(folder):
    metadata = {**made_up_run().metadata(), "schema": "aerodima/run-log/9"}
    read_run_log(write_parquet(folder / "later.parquet", pa.table({"time_s": [0.0]}), metadata))


def less(folder, write):
    """Without two columns that it must have."""
    run = made_up_run()
    run = replace(run, table=run.table.drop(columns=["imu_yaw_rad", "tilt_truth_rad"]))
    if write:
        write_run_log(run, folder / "run.parquet")
    table = pa.Table.from_pandas(run.table)
    read_run_log(write_parquet(folder / "other.parquet", table, run.metadata()))


def nan_in_metadata(folder):
    run = replace(made_up_run(), extra={"tail_mass_kg": float("nan")})
    write_run_log(run, folder / "run.parquet")


def text_in_a_signal(folder):
    run = made_up_run()
    table = run.table.astype({"throttle_command": object})
    table.loc[0, "throttle_command"] = "full"
    write_run_log(replace(run, table=table), folder / "run.parquet")


def no_such_column(folder):
    path = write_run_log(made_up_run(), folder / "first.parquet")
    shutil.copy(path, folder / "copy.parquet")
    read_run_log(folder / "copy.parquet").signal("speed")


@pytest.mark.parametrize(
    ("work", "named"),
    [
        (file_for_folder, ["/out"]),
        (folder_for_file, ["/runs:"]),
        (lambda folder: read_run_log(folder / "nothing.parquet"), ["nothing.parquet"]),
        (journal_without_log, ["aerodima log recover", "run.parquet.journal"]),
        (other_version, ["later.parquet", "aerodima/run-log/9", "aerodima/run-log/1"]),
        (
            lambda folder: read_run_log(
                write_parquet(folder / "foreign.parquet", pa.table({"time_s": [0.0]}))
            ),
            ["foreign.parquet"],
        ),
        (lambda folder: less(folder, True), ["run.parquet", "imu_yaw_rad", "tilt_truth_rad"]),
        (lambda folder: less(folder, False), ["other.parquet", "imu_yaw_rad", "tilt_truth_rad"]),
        (nan_in_metadata, ["JSON"]),
        (text_in_a_signal, ["run.parquet", "throttle_command", "full"]),
        (no_such_column, ["copy.parquet", "'speed'"]),
    ],
)
def test_what_is_no_log_is_named_and_nothing_is_written(tmp_path, work, named):
    assert_refused(lambda: work(tmp_path), LogError, *named)
    assert not (tmp_path / "run.parquet").exists()


@pytest.mark.parametrize(
    "kept", [0.0, 0.001, 0.5, 0.999], ids=["empty", "magic only", "half", "footer cut"]
)
def test_truncated_parquet_points_to_recovery(tmp_path, kept):
    path = write_run_log(made_up_run(), tmp_path / "run.parquet")
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    assert_refused(lambda: read_run_log(path), LogError, "run.parquet", "aerodima log recover")


@pytest.mark.parametrize(
    ("name", "value", "place"),
    [
        ("scenario", [1], "scenario: [1]"),
        ("scenario", {"tail": 3}, "scenario.tail: 3"),
        ("versions", "1.0", "versions: '1.0'"),
        ("seed", True, "seed: True"),
        ("kind", 3, "kind: 3"),
    ],
)
def test_metadata_of_another_type_are_named(tmp_path, name, value, place):
    run = made_up_run()
    path = write_parquet(
        tmp_path / "odd.parquet", pa.Table.from_pandas(run.table), {**run.metadata(), name: value}
    )
    assert_refused(lambda: read_run_log(path), LogError, "odd.parquet", place)


@pytest.mark.parametrize("value", [[0.0], [0.0, 1.0, 2.0], [0.0, float("nan")], ["a", "b"], 3.0])
def test_numbers_that_metadata_state_are_as_many_as_asked_for_and_finite(value):
    run = replace(made_up_run(), extra={"rest_s": value})
    assert_refused(lambda: run.stated("rest_s", 2), LogError, "rest_s", repr(value))
    assert replace(run, extra={"rest_s": [0, 2]}).stated("rest_s", 2) == (0.0, 2.0)
    assert run.stated("another", 2) is None


def test_optional_column_that_a_log_lacks_is_read_as_nan(tmp_path, monkeypatch):
    path = write_run_log(made_up_run(), tmp_path / "before.parquet")
    later = Column("speed_accuracy_m_per_s", "m/s", "accuracy of the speed", optional=True)
    monkeypatch.setitem(CAR_PORTS, "speed", [*CAR_PORTS["speed"], later])
    run = read_run_log(path)
    assert np.isnan(run.signal(later.name)).all()
    run.table[later.name] = 0.5
    assert (
        read_run_log(write_run_log(run, tmp_path / "after.parquet")).signal(later.name) == 0.5
    ).all()
    monkeypatch.setitem(
        CAR_PORTS, "speed", [*CAR_PORTS["speed"][:1], replace(later, optional=False)]
    )
    assert_refused(lambda: read_run_log(path), LogError, later.name)


def test_a_car_without_a_tail_needs_no_tail_truth(tmp_path):
    names = [column.name for column in CAR_TRUTH["tail_truth"]]
    bare = made_up_run(tail_mode="none")
    bare = replace(bare, table=bare.table.drop(columns=names))
    assert read_run_log(write_run_log(bare, tmp_path / "bare.parquet")).has_truth
    tailed = replace(bare, scenario=made_up_run(tail_mode="held").scenario)
    assert_refused(
        lambda: write_run_log(tailed, tmp_path / "tailed.parquet"), LogError, "tail_com_x_truth_m"
    )
