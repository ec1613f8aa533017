"""Foreign formats, several rates on one grid, and what is wrong in a log."""

import builtins
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pytest
from mcap.writer import Writer
from scipy.io import savemat

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.importers import import_log
from aerodima.workbench.logs.mapping import mapping_from
from aerodima.workbench.logs.signals import hold_last
from tests.workbench.logs.foreign_logs import laboratory_columns, swing_readings

TIMES = np.arange(400) / 100.0
ANGLE = 0.5 * np.sin(2.0 * TIMES)
RATE = np.cos(2.0 * TIMES)


def swing_mapping(prefix: str = "", time: str | None = None, kind: str = "swing", **more: Any):
    columns = {"angle_rad": {"from": f"{prefix}theta", "unit": "deg"}}
    columns["angular_velocity_rad_per_s"] = {"from": f"{prefix}omega", "unit": "deg/s"}
    columns |= {"force_y_n": {"from": f"{prefix}Fy"}, **more.pop("columns", {})}
    source = {"from": time or f"{prefix}t", "unit": "s" if time else "ms"}
    return mapping_from(
        {
            "schema": "aerodima/log-mapping/1",
            "kind": kind,
            "time": source,
            "columns": columns,
            **more,
        },
        "m.yaml",
    )


def foreign(**columns: Any) -> pd.DataFrame:
    table = {
        "t": TIMES * 1e3,
        "theta": np.rad2deg(ANGLE),
        "omega": np.rad2deg(RATE),
        "Fy": np.cos(TIMES),
    }
    return pd.DataFrame({**table, **columns})


def write_csv(folder: Path, table: pd.DataFrame) -> Path:
    table.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def write_mat_7_3(path: Path, columns: dict[str, np.ndarray]) -> None:
    """As MATLAB writes it: a text block of 512 bytes, then HDF5 with rows and columns exchanged."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("data")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in columns.items():
            group.create_dataset(name, data=np.atleast_2d(values)).attrs["MATLAB_class"] = (
                np.bytes_("double")
            )
        file.create_dataset("F", data=np.stack([columns["Fy"], -columns["Fy"]])).attrs[
            "MATLAB_class"
        ] = b"double"
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


def write_mcap(
    path: Path, messages: list[tuple[str, float, dict[str, Any]]], encoding: str = "json"
) -> None:
    with open(path, "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="any", encoding="jsonschema", data=b"{}")
        channels = {}
        for topic, time, message in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(
                    topic=topic, message_encoding=encoding, schema_id=schema
                )
            stamp = round(time * 1e9)
            data = json.dumps(message).encode()
            writer.add_message(channels[topic], log_time=stamp, data=data, publish_time=stamp)
        writer.finish()


def assert_is_the_swing(table: pd.DataFrame) -> None:
    assert np.allclose(table["time_s"], TIMES, atol=1e-9)
    assert np.allclose(table["angle_rad"], ANGLE, atol=1e-12)
    assert np.allclose(table["angular_velocity_rad_per_s"], RATE, atol=1e-12)
    assert np.allclose(table["force_y_n"], np.cos(TIMES), atol=1e-12)


def test_csv_and_parquet_give_the_same_log(tmp_path: Path) -> None:
    foreign().to_parquet(tmp_path / "log.parquet")
    for path in (write_csv(tmp_path, foreign()), tmp_path / "log.parquet"):
        imported = import_log(path, swing_mapping())
        assert_is_the_swing(imported.run_log.table)
        assert imported.findings == ()


def test_mat_of_version_5_with_structs(tmp_path: Path) -> None:
    savemat(
        tmp_path / "log.mat",
        {"data": {name: foreign()[name].to_numpy() for name in foreign()}, "note": "text"},
    )
    assert_is_the_swing(import_log(tmp_path / "log.mat", swing_mapping("data.")).run_log.table)


def test_mat_of_version_7_3_with_a_matrix(tmp_path: Path) -> None:
    """The second column of F is -Fy: rows and columns are not mixed up."""
    write_mat_7_3(tmp_path / "log.mat", {name: foreign()[name].to_numpy() for name in foreign()})
    mapping = swing_mapping("data.", columns={"force_y_n": {"from": "F(2)", "scale": -1}})
    assert_is_the_swing(import_log(tmp_path / "log.mat", mapping).run_log.table)


def test_mcap_puts_a_slow_topic_on_the_grid_of_the_fast_one(tmp_path: Path) -> None:
    fast = [
        (
            "/imu",
            time,
            {"t": 0.0, "theta": np.rad2deg(angle), "omega": np.rad2deg(rate), "Fy": np.cos(time)},
        )
        for time, angle, rate in zip(TIMES, ANGLE, RATE, strict=True)
    ]
    slow = [
        ("/motor", 0.1 * index, {"state": {"current": [0.0, 1000.0 * index]}})
        for index in range(40)
    ]
    write_mcap(tmp_path / "log.mcap", sorted([*fast, *slow], key=lambda message: message[1]))
    current = {"current_a": {"from": "/motor.state.current(2)", "unit": "mA"}}
    table = import_log(
        tmp_path / "log.mcap", swing_mapping("/imu.", time="/imu@log_time", columns=current)
    ).run_log.table
    assert_is_the_swing(table)
    assert np.array_equal(table["current_a"], np.floor(np.arange(400) / 10.0)), (
        "held from the row of its own time on"
    )


def test_mcap_in_another_encoding_is_refused_by_name(tmp_path: Path) -> None:
    write_mcap(tmp_path / "log.mcap", [("/imu", 0.0, {})], encoding="cdr")
    with pytest.raises(
        LogError, match=r"log\.mcap: no messages that can be read \(/imu: its messages are 'cdr'"
    ):
        import_log(tmp_path / "log.mcap", swing_mapping("/imu.", time="/imu@log_time"))


@pytest.mark.parametrize(("package", "suffix"), [("h5py", ".mat"), ("mcap", ".mcap")])
def test_a_missing_optional_package_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, suffix: str
) -> None:
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"MATLAB 7.3 MAT-file" + bytes(600))
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.split(".")[0] == package:
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(LogError, match=rf"{package}: pip install 'aerodima-workbench\[logs\]'"):
        import_log(path, swing_mapping())


@pytest.mark.parametrize("suffix", [".parquet", ".mat", ".mcap", ".csv", ".xlsx"])
def test_rubbish_is_refused_in_one_line_that_names_the_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"rubbish{suffix}"
    path.write_bytes(b"\x00\xff\x13 rubbish \n\n\x00" * 50)
    with pytest.raises(LogError, match=rf"rubbish\{suffix}: ") as caught:
        import_log(path, swing_mapping())
    assert "\n" not in str(caught.value)


def test_an_mcap_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    write_mcap(tmp_path / "whole.mcap", [("/imu", time, {"theta": 1.0}) for time in TIMES])
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "whole.mcap").read_bytes()[:-300])
    with pytest.raises(LogError, match=r"cut\.mcap: cut off, damaged"):
        import_log(tmp_path / "cut.mcap", swing_mapping("/imu.", time="/imu@log_time"))


def test_dates_are_times(tmp_path: Path) -> None:
    stamps = pd.Timestamp("2026-11-20T12:00:00Z") + pd.to_timedelta(TIMES, unit="s")
    path = write_csv(tmp_path, foreign(t=[stamp.isoformat() for stamp in stamps]))
    mapping = swing_mapping(time="t")
    shifted = mapping.model_copy(
        update={"time": mapping.time.model_copy(update={"starts_at": 0.0})}
    )
    assert import_log(path, mapping).run_log.time[0] == stamps[0].timestamp()
    assert_is_the_swing(
        import_log(path, shifted).run_log.table.assign(
            time_s=lambda table: table["time_s"].round(6)
        )
    )


def test_hold_last_holds_until_the_next_sample_and_knows_nothing_before_the_first() -> None:
    held = hold_last(np.arange(7.0), np.array([1.0, 3.0, 3.5]), np.array([10.0, 30.0, 35.0]))
    assert np.array_equal(held, [np.nan, 10.0, 10.0, 30.0, 35.0, 35.0, 35.0], equal_nan=True)


def test_empty_cells_of_a_sparse_table_are_no_samples(tmp_path: Path) -> None:
    slow = np.where(np.arange(400) % 10 == 3, 1000.0 * np.arange(400), np.nan)
    path = write_csv(tmp_path, foreign(I=slow))
    current = {"current_a": {"from": "I", "unit": "mA", "largest": 1000}}
    imported = import_log(path, swing_mapping(columns=current, sparse=True))
    assert imported.run_log.signal("current_a")[:11].tolist() == [3.0] * 10 + [13.0]
    assert imported.run_log.time[0] == pytest.approx(0.03)
    assert "3 earlier rows of the log are left out" in str(imported.findings[0])
    dense = import_log(path, swing_mapping(columns=current))
    assert "360 of 400 samples are not numbers" in " ".join(map(str, dense.findings))


def test_a_slow_source_that_stops_is_reported(tmp_path: Path) -> None:
    savemat(
        tmp_path / "a.mat",
        {**{name: foreign()[name] for name in foreign()}, "tg": np.arange(10.0), "g": np.ones(10)},
    )
    savemat(
        tmp_path / "b.mat",
        {**{name: foreign()[name] for name in foreign()}, "tg": [0.0, 1.0, 2.0], "g": np.ones(3)},
    )
    mapping = swing_mapping(columns={"current_a": {"from": "g", "time": "tg", "time_unit": "s"}})
    assert not [
        found
        for found in import_log(tmp_path / "a.mat", mapping).findings
        if found.time is not None
    ]
    late = import_log(tmp_path / "b.mat", mapping).findings[0]
    assert (
        str(late)
        == "column 'current_a' at 2 s: no sample in the last 1.99 s of the log, the value is held"
    )
    with pytest.raises(
        LogError,
        match=r"column 'g' has 10 samples for 400 times of 't'; name the column with its own",
    ):
        import_log(tmp_path / "a.mat", swing_mapping(columns={"current_a": {"from": "g"}}))


def test_gap_and_nan_are_reported_with_column_and_time_and_stay(tmp_path: Path) -> None:
    table = foreign()
    table.loc[100:102, "Fy"] = np.nan
    table = table.drop(index=range(200, 210))
    imported = import_log(write_csv(tmp_path, table), swing_mapping())
    assert [str(found) for found in imported.findings] == [
        "column 'time_s' at 1.99 s: gap of 0.11 s, about 10 samples lost",
        "column 'force_y_n' at 1 s: 3 of 390 samples are not numbers, the first here",
    ]
    assert imported.run_log.extra["imported"]["findings"] == [
        str(found) for found in imported.findings
    ]
    assert np.isnan(imported.run_log.signal("force_y_n")).sum() == 3
    assert len(imported.run_log.table) == 390


def test_reversed_time_names_row_and_time(tmp_path: Path) -> None:
    table = foreign()
    table.loc[[50, 51], "t"] = table.loc[[51, 50], "t"].to_numpy()
    with pytest.raises(
        LogError, match=r"log\.csv: column 't': not increasing in row 51, 0\.5 s after 0\.51 s"
    ):
        import_log(write_csv(tmp_path, table), swing_mapping())
    table.loc[50, "t"] = np.nan
    with pytest.raises(LogError, match=r"column 't': nan in row 50; times must be finite"):
        import_log(write_csv(tmp_path, table), swing_mapping())


def test_text_among_the_numbers_names_the_row(tmp_path: Path) -> None:
    table = foreign().astype({"Fy": object})
    table.loc[7, "Fy"] = "OVERLOAD"
    with pytest.raises(LogError, match=r"column 'Fy': 'OVERLOAD' in row 8 is not a number"):
        import_log(write_csv(tmp_path, table), swing_mapping())


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (
            {"angle_rad": {"from": "theta", "unit": "rad"}},
            r"column 'angle_rad': .* rad at .* s; up to 6\.597 is plausible",
        ),
        (
            {"current_a": {"from": "I", "unit": "A"}},
            r"column 'current_a': 1500 A at 0 s; .* Is the unit in the mapping",
        ),
        (
            {"angular_velocity_rad_per_s": {"from": "omega", "unit": "rpm"}},
            r"6 times the derivative of 'angle_rad'",
        ),
        (
            {"angular_velocity_rad_per_s": {"from": "omega", "unit": "deg/s", "scale": -1}},
            r"-1 times the derivative",
        ),
    ],
)
def test_a_wrong_unit_betrays_itself(tmp_path: Path, columns: dict[str, Any], message: str) -> None:
    with pytest.raises(LogError, match=message):
        import_log(write_csv(tmp_path, foreign(I=1500.0)), swing_mapping(columns=columns))


def test_milliseconds_taken_for_seconds_betray_themselves(tmp_path: Path) -> None:
    with pytest.raises(
        LogError, match=r"column 'time_s': steps of 10 s; .* Is the unit of the times right"
    ):
        import_log(write_csv(tmp_path, foreign()), swing_mapping(time="t"))


def test_the_checks_of_units_give_way_when_told(tmp_path: Path) -> None:
    columns = {
        "current_a": {"from": "I", "unit": "A", "largest": 2000},
        "angular_velocity_rad_per_s": {"from": "omega", "unit": "rpm"},
    }
    imported = import_log(
        write_csv(tmp_path, foreign(I=TIMES + 1500)),
        swing_mapping(columns=columns, check_rates=False),
    )
    assert imported.run_log.signal("current_a")[0] == 1500.0


def test_a_missing_force_axis_is_said_and_the_rest_kept(tmp_path: Path) -> None:
    columns = {"force_z_n": {"from": "FZ"}, "torque_x_n_m": {"from": "dead"}}
    imported = import_log(write_csv(tmp_path, foreign(dead=np.nan)), swing_mapping(columns=columns))
    assert [str(found) for found in imported.findings] == [
        "column 'force_z_n': left out: the file has no column 'FZ'; it has t, theta, omega, Fy, "
        "dead",
        "column 'torque_x_n_m': left out: not one sample is a number",
    ]
    assert_is_the_swing(imported.run_log.table)


def test_rows_with_more_values_than_names_are_refused_and_not_cut(tmp_path: Path) -> None:
    """Decimal commas beside commas as delimiters; what is not in the mapping is told of the file,
    not of a column.
    """
    (tmp_path / "log.csv").write_text(
        "t,theta,Fy\n" + "".join(f"0,{i},1,5,2\n" for i in range(9)), encoding="utf-8"
    )
    with pytest.raises(
        LogError, match=r"more values than its first line has names; are `csv.delimiter` ','"
    ):
        import_log(tmp_path / "log.csv", swing_mapping())
    found = import_log(
        write_csv(tmp_path, foreign(extra=np.arange(len(TIMES)))), swing_mapping()
    ).findings
    assert [str(finding) for finding in found] == [
        "columns of the file that are not in the mapping: extra"
    ]


def test_a_missing_angle_or_time_is_an_error(tmp_path: Path) -> None:
    path = write_csv(tmp_path, foreign())
    with pytest.raises(LogError, match=r"no column 'beta', which angle_rad comes from"):
        import_log(path, swing_mapping(columns={"angle_rad": {"from": "beta"}}))
    with pytest.raises(LogError, match=r"log\.csv: no column 'clock'"):
        import_log(path, swing_mapping(time="clock"))


def test_a_constant_signal_and_three_samples_are_reported(tmp_path: Path) -> None:
    constant = import_log(write_csv(tmp_path, foreign(Fy=0.25)), swing_mapping()).findings
    assert [str(found) for found in constant] == [
        "column 'force_y_n': constant, 0.25 in every row: is the sensor connected?"
    ]
    few = import_log(write_csv(tmp_path, foreign()[:3]), swing_mapping()).findings
    assert str(few[0]) == "column 'time_s': only 3 samples; no filter and no fit can work on them"


def test_a_held_angle_is_constant_and_nothing_odd(tmp_path: Path) -> None:
    path = write_csv(tmp_path, foreign(theta=45.0, omega=0.0))
    assert import_log(path, swing_mapping(kind="static")).findings == ()
    assert len(import_log(path, swing_mapping(kind="swing")).findings) == 2


def test_scale_and_zero_are_in_foreign_units(tmp_path: Path) -> None:
    """An encoder of 2048 counts per turn that reads 512 with the tail hanging, and counts
    backwards.
    """
    counts = 512 - 2048 * ANGLE / (2 * np.pi)
    columns = {"angle_rad": {"from": "n", "unit": "rev", "scale": -1 / 2048, "zero": 512}}
    table = import_log(
        write_csv(tmp_path, foreign(n=counts)), swing_mapping(columns=columns)
    ).run_log.table
    assert np.allclose(table["angle_rad"], ANGLE, atol=1e-12)


def test_the_laboratory_log_keeps_its_signs(tmp_path: Path) -> None:
    """The file's Fy and My are those of axes that point the other way."""
    readings = swing_readings()
    columns = {
        "angle_rad": {"from": "Winkel", "unit": "deg"},
        "angular_velocity_rad_per_s": {"constant": 0.0},
        "force_y_n": {"from": "Fy", "scale": -1},
        "torque_y_n_m": {"from": "My", "unit": "N mm", "scale": -1},
    }
    mapping = swing_mapping(columns=columns, check_rates=False)
    mapping = mapping.model_copy(update={"time": mapping.time.model_copy(update={"from_": "t_ms"})})
    table = import_log(write_csv(tmp_path, laboratory_columns(readings)), mapping).run_log.table
    for name in ("force_y_n", "torque_y_n_m"):
        assert np.allclose(table[name], readings[name], rtol=1e-12)
