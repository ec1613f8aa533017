"""Foreign formats, several rates on one grid, and what is wrong in a log."""

import json
import sys

import h5py
import numpy as np
import pandas as pd
import pytest
from mcap.writer import CompressionType, Writer
from scipy.io import savemat

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.importers import import_log, read_foreign_log
from aerodima.workbench.logs.log_findings import implausible_values, inconsistent_rates
from aerodima.workbench.logs.mapping import CsvFormat, mapping_from
from tests.refusals import assert_named, assert_refused

TIMES = np.arange(400) / 100.0
ANGLE = 0.5 * np.sin(2.0 * TIMES)
RATE = np.cos(2.0 * TIMES)


MAPPING = """
schema: aerodima/log-mapping/1
kind: swing
time: {from: t, unit: ms}
columns: {angle_rad: {from: theta, unit: deg}}
"""


def swing_mapping(prefix="", time=None, kind="swing", **more):
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


def foreign(**columns):
    table = {
        "t": TIMES * 1e3,
        "theta": np.rad2deg(ANGLE),
        "omega": np.rad2deg(RATE),
        "Fy": np.cos(TIMES),
    }
    return pd.DataFrame({**table, **columns})


def write_csv(folder, table):
    table.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def write_mat_7_3(path, columns):
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


def write_mcap(path, messages, encoding="json", compression=CompressionType.ZSTD):
    with open(path, "wb") as stream:
        writer = Writer(stream, compression=compression)
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


def assert_told(found, column, time, *named):
    """What a finding says: its column, its time (s), and what its text must name."""
    assert found.column == column
    assert found.time == (None if time is None else pytest.approx(time))
    assert_named(found.text, named)


def assert_is_the_swing(table):
    assert np.allclose(table["time_s"], TIMES, atol=1e-9)
    assert np.allclose(table["angle_rad"], ANGLE, atol=1e-12)
    assert np.allclose(table["angular_velocity_rad_per_s"], RATE, atol=1e-12)
    assert np.allclose(table["force_y_n"], np.cos(TIMES), atol=1e-12)


def test_csv_and_parquet_give_the_same_log(tmp_path):
    foreign().to_parquet(tmp_path / "log.parquet")
    for path in (write_csv(tmp_path, foreign()), tmp_path / "log.parquet"):
        imported = import_log(path, swing_mapping())
        assert_is_the_swing(imported.run_log.table)
        assert imported.findings == ()


def test_mat_of_version_5_with_structs(tmp_path):
    savemat(tmp_path / "log.mat", {"data": dict(foreign()), "note": "text"})
    assert_is_the_swing(import_log(tmp_path / "log.mat", swing_mapping("data.")).run_log.table)


def test_mat_of_version_7_3_with_a_matrix(tmp_path):
    """The second column of F is -Fy: rows and columns are not mixed up."""
    write_mat_7_3(tmp_path / "log.mat", dict(foreign()))
    mapping = swing_mapping("data.", columns={"force_y_n": {"from": "F(2)", "scale": -1}})
    assert_is_the_swing(import_log(tmp_path / "log.mat", mapping).run_log.table)


@pytest.mark.parametrize(
    "time", ["/imu@log_time", None], ids=["time of the log", "ms of a message"]
)
def test_mcap_puts_a_slow_topic_on_the_grid_of_the_fast_one(tmp_path, time):
    """The slow topic has the log's own times in s, whatever the unit of those of the rows."""
    rows = foreign().to_dict("records")
    fast = [("/imu", stamp, row) for stamp, row in zip(TIMES, rows, strict=True)]
    slow = [
        ("/motor", 0.1 * index, {"state": {"current": [0.0, 1000.0 * index]}})
        for index in range(40)
    ]
    write_mcap(tmp_path / "log.mcap", sorted([*fast, *slow], key=lambda message: message[1]))
    current = {"current_a": {"from": "/motor.state.current(2)", "unit": "mA"}}
    table = import_log(
        tmp_path / "log.mcap", swing_mapping("/imu.", time=time, columns=current)
    ).run_log.table
    assert_is_the_swing(table)
    held = np.floor(np.arange(400) / 10.0)
    assert np.array_equal(table["current_a"], held), "held from the row of its own time on"


@pytest.mark.parametrize(
    ("package", "suffix"), [("h5py", ".mat"), ("mcap", ".mcap"), ("rosbags", ".bag")]
)
def test_a_missing_optional_package_names_the_extra(tmp_path, monkeypatch, package, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"MATLAB 7.3 MAT-file" + bytes(600))
    monkeypatch.setitem(sys.modules, package, None)
    assert_refused(
        lambda: import_log(path, swing_mapping()), LogError, path.name, package, "[logs]"
    )


def write_rubbish(path):
    path.write_bytes(b"\x00\xff\x13 rubbish \n\n\x00" * 50)
    return path


def write_cdr_mcap(path):
    write_mcap(path, [("/imu", 0.0, {})], encoding="cdr")
    return path


def write_altered_mcap(path):
    """One digit of a number, and nothing else, is another one."""
    write_mcap(path, [("/imu", 0.0, {"v": 2.0})], compression=CompressionType.NONE)
    path.write_bytes(path.read_bytes().replace(b"2.0", b"9.0"))
    return path


def write_nameless_csv(path):
    foreign().to_csv(path, index=False, header=False)
    return path


def write_wide_csv(path):
    """Decimal commas beside commas as delimiters: more values than names."""
    path.write_text("t,theta,Fy\n" + "".join(f"0,{i},1,5,2\n" for i in range(9)), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "write", "named"),
    [
        *(
            (f"log{end}", write_rubbish, [])
            for end in (".parquet", ".mat", ".mcap", ".csv", ".bag", ".db3")
        ),
        ("log.xlsx", write_rubbish, [".xlsx"]),
        ("log.mcap", write_cdr_mcap, ["/imu", "cdr"]),
        ("log.csv", write_wide_csv, ["csv.delimiter", "','"]),
        ("log.csv", write_nameless_csv, ["csv.names"]),
        ("log.mcap", write_altered_mcap, []),
    ],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, name, write, named):
    path = write(tmp_path / name)
    assert_refused(lambda: import_log(path, swing_mapping()), LogError, name, *named)


def test_no_row_of_a_file_without_a_line_of_names_is_lost(tmp_path):
    path = write_nameless_csv(tmp_path / "log.csv")
    mapping = swing_mapping(csv={"names": ["t", "theta", "omega", "Fy"]})
    assert_is_the_swing(import_log(path, mapping).run_log.table)


def test_channels_in_rows_are_columns_and_what_is_no_number_is_listed(tmp_path):
    """As Simulink's To File writes rows; JSON has NaN as text."""
    savemat(
        tmp_path / "log.mat", {"F": foreign().to_numpy().T, "cube": np.ones((2, 2, 2)), "z": [1j]}
    )
    log = read_foreign_log(tmp_path / "log.mat", CsvFormat())
    assert np.array_equal(np.transpose(list(log.columns.values())), foreign())
    assert [*log.unreadable] == ["cube", "z"]
    assert "complex" in log.unreadable["z"]
    row = {"v": [1.0, "NaN"], "on": True, "note": "start"}
    write_mcap(tmp_path / "log.mcap", [("/i", 0.0, row), ("/i", 1.0, row | {"v": [2, 3]})])
    log = read_foreign_log(tmp_path / "log.mcap", CsvFormat())
    assert log.numbers("/i.on").tolist() == log.numbers("/i.v(1)").tolist()[:1] * 2
    assert np.array_equal(log.numbers("/i.v(2)"), [np.nan, 3.0], equal_nan=True)
    assert [*log.unreadable] == ["/i.note"]


def test_one_of_rows_with_equal_times_counts_if_the_mapping_says_which(tmp_path):
    table = foreign()
    table.loc[51, "t"] = table.t[50]
    path = write_csv(tmp_path, table)
    mapping = swing_mapping()
    assert_refused(lambda: import_log(path, mapping), LogError, "row 52", "`time.repeated: first`")
    for kept, dropped in (("first", 51), ("last", 50)):
        time = mapping.time.model_copy(update={"repeated": kept})
        imported = import_log(path, mapping.model_copy(update={"time": time}))
        assert_told(imported.findings[0], "t", None, "1 row")
        assert np.array_equal(imported.run_log.signal("force_y_n"), table.Fy.drop(dropped))
    back = write_csv(tmp_path, foreign().iloc[[0, 2, 1]])
    with pytest.raises(LogError, match="not increasing in row 3") as refusal:
        import_log(back, mapping)
    assert "repeated" not in str(refusal.value)


def test_dates_are_times(tmp_path):
    stamps = pd.Timestamp("2026-11-20T12:00:00Z") + pd.to_timedelta(TIMES, unit="s")
    path = write_csv(tmp_path, foreign(t=[stamp.isoformat() for stamp in stamps]))
    mapping = swing_mapping(time="t")
    shifted = mapping.model_copy(
        update={"time": mapping.time.model_copy(update={"starts_at": 0.0, "unit": "ms"})}
    )
    lasting = pd.Series(TIMES * 1e3).round().astype("timedelta64[ms]")
    foreign(t=lasting).to_parquet(tmp_path / "log.parquet")
    assert_is_the_swing(import_log(tmp_path / "log.parquet", swing_mapping()).run_log.table)
    assert import_log(path, mapping).run_log.time[0] == stamps[0].timestamp()
    assert_is_the_swing(
        import_log(path, shifted).run_log.table.assign(
            time_s=lambda table: table["time_s"].round(6)
        )
    )


def test_empty_cells_of_a_sparse_table_are_no_samples(tmp_path):
    slow = np.where(np.arange(400) % 10 == 3, 1000.0 * np.arange(400), np.nan)
    path = write_csv(tmp_path, foreign(I=slow))
    current = {"current_a": {"from": "I", "unit": "mA", "largest": 1000}}
    imported = import_log(path, swing_mapping(columns=current, sparse=True))
    assert imported.run_log.signal("current_a")[:11].tolist() == [3.0] * 10 + [13.0]
    assert imported.run_log.time[0] == pytest.approx(0.03)
    assert_told(imported.findings[0], "current_a", 0.03, "3 earlier rows")
    dense = import_log(path, swing_mapping(columns=current))
    assert "360 of 400" in " ".join(map(str, dense.findings))


def test_a_slow_source_that_stops_is_reported(tmp_path):
    for name, number in (("a.mat", 10), ("b.mat", 3)):
        slow = {"tg": np.arange(float(number)), "g": np.ones(number)}
        savemat(tmp_path / name, {**foreign(), **slow})
    mapping = swing_mapping(columns={"current_a": {"from": "g", "time": "tg", "time_unit": "s"}})
    assert not [
        found
        for found in import_log(tmp_path / "a.mat", mapping).findings
        if found.time is not None
    ]
    late = import_log(tmp_path / "b.mat", mapping).findings[0]
    assert_told(late, "current_a", 2.0, "1.99 s")


def test_gap_and_nan_are_reported_with_column_and_time_and_stay(tmp_path):
    table = foreign()
    table.loc[100:102, "Fy"] = np.nan
    table = table.drop(index=range(200, 210))
    imported = import_log(write_csv(tmp_path, table), swing_mapping())
    gap, lost = imported.findings
    assert_told(gap, "time_s", 1.99, "0.11 s", "10 samples")
    assert_told(lost, "force_y_n", 1.0, "3 of 390")
    assert imported.run_log.extra["imported"]["findings"] == [str(gap), str(lost)]
    assert np.isnan(imported.run_log.signal("force_y_n")).sum() == 3
    assert len(imported.run_log.table) == 390


def swapped():
    table = foreign()
    table.loc[[50, 51], "t"] = table.loc[[51, 50], "t"].to_numpy()
    return table


def with_cell(row, name, value):
    table = foreign().astype({name: object})
    table.loc[row, name] = value
    return table


RPM = {"from": "omega", "unit": "rpm"}
TURNED = {"from": "omega", "unit": "deg/s", "scale": -1}


@pytest.mark.parametrize(
    ("table", "mapping", "named"),
    [
        (swapped(), {}, ["'t'", "row 52", "0.5 s", "0.51 s"]),
        (with_cell(50, "t", np.nan), {}, ["'t'", "nan", "row 51"]),
        (with_cell(7, "Fy", "OVERLOAD"), {}, ["'Fy'", "OVERLOAD", "row 8"]),
        (foreign(), {"columns": {"angle_rad": {"from": "beta"}}}, ["'beta'", "angle_rad"]),
        (foreign(), {"time": "clock"}, ["'clock'"]),
        (foreign(), {"time": "t"}, ["time_s", "10 s"]),
        (foreign(), {"columns": {"angle_rad": {"from": "theta"}}}, ["angle_rad", "rad", "6.597"]),
        (foreign(I=1500.0), {"columns": {"current_a": {"from": "I"}}}, ["current_a", "1500 A"]),
        (foreign(), {"columns": {"angular_velocity_rad_per_s": RPM}}, ["6 times", "angle_rad"]),
        (foreign(), {"columns": {"angular_velocity_rad_per_s": TURNED}}, ["-1 times", "angle_rad"]),
    ],
)
def test_what_makes_every_figure_wrong_is_named(tmp_path, table, mapping, named):
    """Times that run back, text among numbers, and units that betray themselves."""
    path = write_csv(tmp_path, table)
    assert_refused(lambda: import_log(path, swing_mapping(**mapping)), LogError, "log.csv", *named)


def test_all_that_is_wrong_is_named_at_once(tmp_path):
    """Text, two wrong units, a sign, a name that is not there, and the scenario."""
    columns = {
        "force_y_n": {"from": "Fy"},
        "current_a": {"from": "I", "unit": "A"},
        "force_x_n": {"from": "Fx"},
        "angular_velocity_rad_per_s": TURNED,
        "torque_x_n_m": {"from": "mx"},
    }
    table = with_cell(7, "Fy", "OVERLOAD").assign(I=1500.0, Fx=2000.0)
    mapping = swing_mapping(columns=columns, scenario={"base": "cheetha"})
    assert_refused(
        lambda: import_log(write_csv(tmp_path, table), mapping),
        LogError,
        *("OVERLOAD", "1500 A", "2000 N", "-1 times", "'mx'", "'cheetha'"),
    )


def test_a_column_of_another_length_needs_times_of_its_own(tmp_path):
    savemat(tmp_path / "a.mat", {**foreign(), "g": np.ones(10)})
    mapping = swing_mapping(columns={"current_a": {"from": "g"}})
    assert_refused(lambda: import_log(tmp_path / "a.mat", mapping), LogError, "'g'", "10", "400")


@pytest.mark.parametrize(
    ("column", "unit", "plausible", "wrong"),
    [
        ("angle_rad", "rad", 6.5, 7.0),
        ("imu_yaw_rad", "rad", 99.0, 101.0),
        ("steering_command_rad", "rad", 1.5, 3.0),
        ("sail_angle_rad", "rad", 99.0, 101.0),
        ("angular_velocity_rad_per_s", "rad/s", 59.0, 61.0),
        ("imu_acceleration_y_m_per_s2", "m/s2", 299.0, 301.0),
        ("speed_m_per_s", "m/s", 59.0, 61.0),
        ("force_x_n", "N", 499.0, 501.0),
        ("torque_x_n_m", "N m", 99.0, 101.0),
    ],
)
def test_values_beyond_what_is_plausible_betray_a_wrong_unit(column, unit, plausible, wrong):
    """Of either sign; a heading and a free sail turn several times, other angles do not."""

    def check(value, largest=None):
        table = pd.DataFrame({"time_s": [0.0, 0.01, 0.02], column: [0.0, value, np.nan]})
        return implausible_values(table, {column: unit}, {column: largest})

    assert not check(plausible)
    assert not check(-wrong, largest=1.1 * wrong)
    for value in (wrong, -wrong):
        (problem,) = check(value)
        assert_named(problem, [column, f"{value:g} {unit}", "0.01 s"])


@pytest.mark.parametrize(
    ("angle", "rate"),
    [("imu_yaw_rad", "imu_gyro_z_rad_per_s"), ("sail_angle_rad", "sail_rate_rad_per_s")],
)
def test_a_rate_is_compared_with_an_angle_that_is_wrapped(tmp_path, angle, rate):
    """It passes 180 degrees twice; a heading is written without jumps, as in our own logs."""
    turned = 8.0 * TIMES / TIMES[-1] + 0.5 * np.sin(3.0 * TIMES)
    wrapped = np.mod(turned + np.pi, 2.0 * np.pi) - np.pi
    path = write_csv(tmp_path, foreign(psi=wrapped, r=np.gradient(turned, TIMES)))

    def imported(scale):
        columns = {angle: {"from": "psi"}, rate: {"from": "r", "scale": scale}}
        return import_log(path, swing_mapping(columns=columns)).run_log.signal(angle)

    written = turned if angle == "imu_yaw_rad" else wrapped
    assert np.allclose(imported(1.0), written, atol=1e-9)
    assert_refused(lambda: imported(-1.0), LogError, rate, angle)


@pytest.mark.parametrize(
    ("axis", "scale", "offset"),
    [("y", -1.0, 0.0), ("y", 9.81, 0.0), ("x", 9.81, 0.0), ("z", 1.0, 9.81)],
)
def test_an_acceleration_that_is_not_that_of_the_car_is_named(axis, scale, offset):
    """Of a car in a slalom, which brakes and speeds up; its accelerations are without gravity."""
    name = f"imu_acceleration_{axis}_m_per_s2"
    table = pd.DataFrame({"time_s": TIMES, "speed_m_per_s": 4.0 + ANGLE})
    table["imu_gyro_z_rad_per_s"] = RATE
    right = {"x": RATE, "y": table.speed_m_per_s * RATE, "z": 0.1 * RATE}[axis]
    assert not inconsistent_rates(table.assign(**{name: right}))
    table[name] = scale * right + offset
    (problem,) = inconsistent_rates(table)
    assert name in problem


def test_a_steering_to_the_other_side_than_the_car_yaws_is_named():
    """Of a car in a slalom at changing speed, which yaws 0.05 s after it is steered."""
    table = pd.DataFrame({"time_s": TIMES, "speed_m_per_s": 4.0 + ANGLE})
    steering = 0.1 * np.sin(3.0 * TIMES)
    late = 0.1 * np.sin(3.0 * (TIMES - 0.05))
    table["imu_gyro_z_rad_per_s"] = table.speed_m_per_s * np.tan(late) / 0.4
    assert not inconsistent_rates(table.assign(steering_command_rad=steering))
    (problem,) = inconsistent_rates(table.assign(steering_command_rad=-steering))
    assert_named(problem, ["steering_command_rad", "left", "scale: -1"])
    assert not inconsistent_rates(table.assign(steering_command_rad=0.0))


def test_the_checks_of_units_give_way_when_told(tmp_path):
    columns = {
        "current_a": {"from": "I", "unit": "A", "largest": 2000},
        "angular_velocity_rad_per_s": {"from": "omega", "unit": "rpm"},
    }
    imported = import_log(
        write_csv(tmp_path, foreign(I=TIMES + 1500)),
        swing_mapping(columns=columns, check_rates=False),
    )
    assert imported.run_log.signal("current_a")[0] == 1500.0


def test_what_the_file_lacks_or_has_beyond_the_mapping_is_told(tmp_path):
    columns = {"force_z_n": {"from": "FZ"}, "torque_x_n_m": {"from": "dead"}}
    path = write_csv(tmp_path, foreign(dead=np.nan, extra=TIMES))
    imported = import_log(path, swing_mapping(columns=columns))
    lacking, dead, further = imported.findings
    assert_told(lacking, "force_z_n", None, "FZ")
    assert_told(dead, "torque_x_n_m", None)
    assert_told(further, "", None, "extra")
    assert not {"force_z_n", "torque_x_n_m"} & set(imported.run_log.table)
    assert_is_the_swing(imported.run_log.table)


def test_a_constant_signal_and_three_samples_are_reported(tmp_path):
    (constant,) = import_log(write_csv(tmp_path, foreign(Fy=0.25)), swing_mapping()).findings
    assert_told(constant, "force_y_n", None, "0.25")
    few = import_log(write_csv(tmp_path, foreign()[:3]), swing_mapping()).findings
    assert_told(few[0], "time_s", None, "3")


def test_a_held_angle_is_constant_and_nothing_odd(tmp_path):
    path = write_csv(tmp_path, foreign(theta=45.0, omega=0.0))
    assert import_log(path, swing_mapping(kind="static")).findings == ()
    assert len(import_log(path, swing_mapping(kind="swing")).findings) == 2


def test_scale_and_zero_are_in_foreign_units(tmp_path):
    """An encoder of 2048 counts per turn that reads 512 with the tail hanging, and counts
    backwards.
    """
    counts = 512 - 2048 * ANGLE / (2 * np.pi)
    columns = {"angle_rad": {"from": "n", "unit": "rev", "scale": -1 / 2048, "zero": 512}}
    table = import_log(
        write_csv(tmp_path, foreign(n=counts)), swing_mapping(columns=columns)
    ).run_log.table
    assert np.allclose(table["angle_rad"], ANGLE, atol=1e-12)
