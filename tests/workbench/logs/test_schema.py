import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from aerodima.workbench.config.signal_table import (
    CAR_PORTS,
    CAR_TRUTH,
    Column,
    sensor_columns,
    truth_columns,
)
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.schema import (
    METADATA_KEY,
    encode_metadata,
    read_run_log,
    write_run_log,
)
from tests.workbench.made_up_runs import car_run_columns, made_up_run, signals_equal

UNIT_ENDINGS = {
    "m": "_m", "m/s": "_m_per_s", "m/s2": "_m_per_s2", "rad": "_rad", "rad/s": "_rad_per_s",
    "N": "_n",
    "N m": "_n_m", "N s": "_n_s", "N m s": "_n_m_s", "W": "_w", "s": "_s",
}  # fmt: skip


def awkward_run():
    """A run whose signals hold what text formats lose: NaN, both zeros, infinities, neighbours
    of 1.
    """
    run = made_up_run({"gyro_x_truth_rad_per_s": np.nextafter(1.0, 2.0), "throttle_command": -0.0})
    run.table.loc[3, "roll_estimate_rad"] = np.nan
    run.table.loc[4, "roll_estimate_rad"] = -np.inf
    return run


def test_every_column_ends_in_its_unit_and_has_a_meaning() -> None:
    for column in car_run_columns(("chassis_qw",)):
        assert column.meaning
        if column.unit in UNIT_ENDINGS:
            assert column.name.endswith(UNIT_ENDINGS[column.unit]), column


def test_columns_of_the_contract_are_there_once() -> None:
    names = [column.name for column in car_run_columns(("chassis_qw",))]
    assert len(names) == len(set(names))
    assert {
        "time_s", "planned_turn", "tail_pitch_command_kp", "tail_roll_command_torque_n_m",
        "sail_rate_rad_per_s",
        "imu_acceleration_y_m_per_s2", "status_operator_age_s", "status_tail_roll_fault",
        "status_armed",
        "roll_rate_estimate_rad_per_s", "tilt_truth_rad", "velocity_y_truth_m_per_s",
        "gyro_z_truth_rad_per_s",
        "acceleration_y_truth_m_per_s2", "com_z_truth_m", "tail_tip_x_truth_m",
        "tail_momentum_z_truth_n_s",
        "tail_angular_momentum_x_truth_n_m_s", "tail_force_moment_y_truth_n_m",
        "wheel_force_rear_left_z_truth_n",
        "wheel_contact_front_right_x_truth_m", "ground_contact_tail_truth_n",
        "plant_position_chassis_qw",
        "drive_power_truth_w", "tail_power_truth_w",
    } <= set(names)  # fmt: skip


def test_truth_is_named_truth_and_sensors_are_not() -> None:
    assert all("_truth_" in column.name for column in truth_columns())
    assert not any("truth" in column.name for column in sensor_columns())


def test_what_is_written_comes_back_bit_for_bit(tmp_path: Path) -> None:
    run = awkward_run()
    back = read_run_log(write_run_log(run, tmp_path / "new folder" / "run.parquet"))
    assert signals_equal(run, back)
    assert back.metadata() == run.metadata()
    assert (back.seed, back.kind, back.extra["tail_mass_kg"]) == (7, "car_run", 0.15)
    assert set(back.versions) == {"project", "drake", "python", "numpy"}


def test_metadata_apart_the_same_signals_are_equal() -> None:
    run = awkward_run()
    assert signals_equal(
        run, dataclasses.replace(run, created="another time", table=run.table.copy())
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda table: table.assign(throttle_command=0.0),
        lambda table: table.assign(gyro_x_truth_rad_per_s=1.0),
        lambda table: table.iloc[:-1],
        lambda table: table[[*table.columns[1:], table.columns[0]]],
        lambda table: table.drop(columns="status_armed"),
    ],
    ids=["sign of zero", "last bit", "a row less", "order", "a column less"],
)
def test_the_smallest_difference_makes_runs_unequal(change) -> None:
    run = awkward_run()
    assert not signals_equal(run, dataclasses.replace(run, table=change(run.table.copy())))


def test_pandas_reads_the_file_without_this_project(tmp_path: Path) -> None:
    run = made_up_run()
    table = pd.read_parquet(write_run_log(run, tmp_path / "run.parquet"))
    assert list(table.columns) == list(run.table.columns)


def test_folder_names_with_an_equals_sign_add_no_column(tmp_path: Path) -> None:
    run = made_up_run()
    assert signals_equal(
        run, read_run_log(write_run_log(run, tmp_path / "speed=3" / "run.parquet"))
    )


def test_existing_file_is_kept_without_force(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    path.write_text("precious")
    with pytest.raises(LogError, match=r"run\.parquet: exists already.*--force"):
        write_run_log(made_up_run(), path)
    assert path.read_text() == "precious"
    write_run_log(made_up_run(), path, force=True)
    assert len(read_run_log(path).table) == 2001


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_behind(
    tmp_path: Path, monkeypatch
) -> None:
    path = write_run_log(made_up_run(), tmp_path / "run.parquet")
    before = path.read_bytes()

    def disk_full(table, temporary, **options):
        Path(temporary).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", disk_full)
    with pytest.raises(LogError, match="No space left"):
        write_run_log(made_up_run(), path, force=True)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_file_in_place_of_the_folder_is_one_clear_error(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(LogError, match="out: cannot be made or used as a folder"):
        write_run_log(made_up_run(), tmp_path / "out" / "run.parquet")


def test_folder_in_place_of_the_file_is_refused_even_with_force(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="is a folder"):
        write_run_log(made_up_run(), tmp_path, force=True)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nothing\.parquet: no such run log$"):
        read_run_log(tmp_path / "nothing.parquet")


def test_missing_file_with_a_journal_points_to_the_journal(tmp_path: Path) -> None:
    (tmp_path / "run.parquet.journal").write_bytes(b"")
    with pytest.raises(LogError, match=r"aerodima log recover .*run\.parquet\.journal"):
        read_run_log(tmp_path / "run.parquet")


@pytest.mark.parametrize(
    "kept", [0.0, 0.001, 0.5, 0.999], ids=["empty", "magic only", "half", "footer cut"]
)
def test_truncated_parquet_points_to_recovery(tmp_path: Path, kept: float) -> None:
    path = write_run_log(made_up_run(), tmp_path / "run.parquet")
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(LogError, match=r"run\.parquet: cut off, damaged.*aerodima log recover"):
        read_run_log(path)


def test_other_schema_version_says_which_is_read(tmp_path: Path) -> None:
    path = tmp_path / "run.parquet"
    metadata = {**made_up_run().metadata(), "schema": "aerodima/run-log/9"}
    table = pa.table({"time_s": [0.0]}).replace_schema_metadata(
        {METADATA_KEY: encode_metadata(metadata)}
    )
    pq.write_table(table, path)
    with pytest.raises(LogError, match=r"schema 'aerodima/run-log/9'.*reads 'aerodima/run-log/1'"):
        read_run_log(path)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("scenario", [1], r"scenario: \[1\] is not allowed; .*dictionary"),
        ("scenario", None, "scenario: None is not allowed; .*dictionary"),
        ("scenario", {"tail": 3}, r"scenario\.tail: 3 is not allowed; .*keys with values"),
        ("extra", None, "extra: None is not allowed; .*dictionary"),
        ("versions", "1.0", "versions: '1.0' is not allowed; .*dictionary"),
        ("seed", "seven", "seed: 'seven' is not allowed; .*integer"),
        ("seed", True, "seed: True is not allowed; .*integer"),
        ("kind", 3, "kind: 3 is not allowed; .*string"),
    ],
)
def test_metadata_of_another_type_are_named(
    tmp_path: Path, name: str, value: object, message: str
) -> None:
    run = made_up_run()
    encoded = encode_metadata({**run.metadata(), name: value})
    table = pa.Table.from_pandas(run.table).replace_schema_metadata({METADATA_KEY: encoded})
    pq.write_table(table, tmp_path / "odd.parquet")
    with pytest.raises(LogError, match=rf"odd\.parquet: metadata: {message}"):
        read_run_log(tmp_path / "odd.parquet")


def test_foreign_parquet_is_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time_s": [0.0]}), tmp_path / "foreign.parquet")
    with pytest.raises(LogError, match="not a run log"):
        read_run_log(tmp_path / "foreign.parquet")


def test_missing_columns_are_named_on_writing_and_reading(tmp_path: Path) -> None:
    run = made_up_run()
    less = dataclasses.replace(run, table=run.table.drop(columns=["imu_yaw_rad", "tilt_truth_rad"]))
    with pytest.raises(LogError, match=r"2 column\(s\) missing: imu_yaw_rad, tilt_truth_rad"):
        write_run_log(less, tmp_path / "run.parquet")
    assert not (tmp_path / "run.parquet").exists()
    encoded = encode_metadata(less.metadata())
    table = pa.Table.from_pandas(less.table).replace_schema_metadata({METADATA_KEY: encoded})
    pq.write_table(table, tmp_path / "other.parquet")
    with pytest.raises(LogError, match="imu_yaw_rad, tilt_truth_rad"):
        read_run_log(tmp_path / "other.parquet")


def test_optional_column_that_a_log_lacks_is_read_as_nan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        CAR_PORTS, "speed", [*CAR_PORTS["speed"][:1], dataclasses.replace(later, optional=False)]
    )
    with pytest.raises(LogError, match=later.name):
        read_run_log(path)


def test_a_car_without_a_tail_needs_no_tail_truth(tmp_path: Path) -> None:
    names = [column.name for column in CAR_TRUTH["tail_truth"]]
    bare = made_up_run(tail_mode="none")
    bare = dataclasses.replace(bare, table=bare.table.drop(columns=names))
    assert read_run_log(write_run_log(bare, tmp_path / "bare.parquet")).has_truth
    tailed = dataclasses.replace(bare, scenario=made_up_run(tail_mode="held").scenario)
    with pytest.raises(LogError, match="tail_com_x_truth_m"):
        write_run_log(tailed, tmp_path / "tailed.parquet")


def test_nan_in_the_metadata_and_text_in_a_signal_are_refused(tmp_path: Path) -> None:
    run = made_up_run()
    with pytest.raises(LogError, match="JSON"):
        write_run_log(
            dataclasses.replace(run, extra={"tail_mass_kg": float("nan")}), tmp_path / "a.parquet"
        )
    table = run.table.astype({"throttle_command": object})
    table.loc[0, "throttle_command"] = "full"
    with pytest.raises(LogError, match="'throttle_command' is not made of numbers"):
        write_run_log(dataclasses.replace(run, table=table), tmp_path / "b.parquet")


def test_unknown_signal_is_named(tmp_path: Path) -> None:
    path = write_run_log(made_up_run(), tmp_path / "run.parquet")
    shutil.copy(path, tmp_path / "copy.parquet")
    with pytest.raises(LogError, match=r"copy\.parquet: no column 'speed'"):
        read_run_log(tmp_path / "copy.parquet").signal("speed")
