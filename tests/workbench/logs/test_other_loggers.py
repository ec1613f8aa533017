"""What other loggers write: files without names, preambles, dates, quaternions, bags, clocks."""

import h5py
import numpy as np
import pandas as pd
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.importers import import_log, read_foreign_log
from aerodima.workbench.logs.mapping import CsvFormat, mapping_from
from tests.refusals import assert_refused

TIME = np.arange(200) / 100.0
START = 1_700_000_000
"""2023-11-14 22:13:20 UTC, s since 1970."""
DATES = pd.Timestamp(START, unit="s") + pd.to_timedelta(TIME, unit="s")
ANGLES = 0.3 * np.sin(np.outer(TIME, [2.0, 3.0, 1.0])) + [0.0, 0.0, 2.9]
"""Roll, pitch and yaw, rad; the yaw passes half a turn."""
W, X, Y, Z = Rotation.from_euler("ZYX", ANGLES[:, ::-1]).as_quat(scalar_first=True).T
SPEED = {"speed_m_per_s": {"from": "v"}}


def car_mapping(time, columns=SPEED, **more):
    stated = {"schema": "aerodima/log-mapping/1", "kind": "car_log", "check_rates": False}
    return mapping_from({**stated, "time": time, "columns": columns, **more})


def write_csv(path, lines=(), header=True, **columns):
    text = pd.DataFrame(columns).to_csv(index=False, header=header)
    path.write_text("".join(f"{line}\n" for line in lines) + text)
    return path


PAIR = {"stamp": ["a", "b"]}
DATE, CLOCK = DATES.strftime("%d/%m/%Y"), DATES.strftime("%H:%M:%S.%f")


@pytest.mark.parametrize(
    ("time", "columns", "more"),
    [
        ({"from": "a", "unit": "%d/%m/%Y %H:%M:%S.%f"}, {"a": DATE + " " + CLOCK + " "}, {}),
        ({"from": "stamp", "unit": "%d/%m/%Y %H:%M:%S.%f"}, {"a": DATE, "b": CLOCK}, PAIR),
        ({"from": "stamp"}, {"a": DATES.strftime("%Y-%m-%d"), "b": CLOCK}, PAIR),
        ({"from": "stamp"}, {"a": START + TIME // 1, "b": (TIME % 1 * 1e9).round()}, PAIR),
    ],
    ids=["day first", "date and time of day", "ISO in two columns", "seconds and nanoseconds"],
)
def test_times_of_other_loggers(tmp_path, time, columns, more):
    path = write_csv(tmp_path / "log.csv", **columns, v=TIME)
    run_log = import_log(path, car_mapping(time, stamps=more)).run_log
    # A float64 of 1.7e9 s has steps of 2.4e-7 s.
    assert np.allclose(run_log.time - START, TIME, rtol=0.0, atol=5e-7)


def test_a_date_of_another_form_is_named_with_its_row(tmp_path):
    path = write_csv(tmp_path / "log.csv", a=[*DATE[:3], "14.11.2023"], v=range(4))
    mapping = car_mapping({"from": "a", "unit": "%d/%m/%Y"})
    named = ["log.csv", "'a'", "row 4", "14.11.2023", "%d/%m/%Y"]
    assert_refused(lambda: import_log(path, mapping), LogError, *named)


def test_columns_without_names_are_numbered(tmp_path):
    path = write_csv(tmp_path / "log.csv", header=False, t=TIME, v=3.6 * TIME)
    columns = {"speed_m_per_s": {"from": "2", "unit": "km/h"}}
    table = import_log(path, car_mapping({"from": "1"}, columns, csv={"names": []})).run_log.table
    assert np.allclose(table, np.transpose([TIME, TIME]))


def test_a_preamble_of_other_widths_stands_above_names_and_units_and_remarks_are_left_out(tmp_path):
    """As MoTeC's i2 writes it."""
    lines = ['"Format","MoTeC CSV File",,,"Workbook",""', '"Range","outing"', "", "", '"t","v"']
    lines += ['"s","km/h"', "", "# the engine was started"]
    path = write_csv(tmp_path / "log.txt", lines, header=False, t=TIME, v=TIME)
    form = {"skip_lines": 4, "skip_after_names": 2, "comment": "#"}
    table = import_log(path, car_mapping({"from": "t"}, csv=form)).run_log.table
    assert np.allclose(table, np.transpose([TIME, TIME]))
    assert_refused(lambda: import_log(path, car_mapping({"from": "t"})), LogError, "'t'", "Format")


ATTITUDE = {f"imu_{name}_rad": {"from": f"imu.{name}"} for name in ("roll", "pitch", "yaw")}


def quaternions(prefix=""):
    return {"imu": [f"{prefix}{name}" for name in "wxyz"]}


def assert_is_the_attitude(table):
    assert np.allclose(table[[*ATTITUDE]], ANGLES, atol=1e-6)


def test_a_quaternion_becomes_roll_pitch_and_yaw(tmp_path):
    path = write_csv(tmp_path / "log.csv", t=TIME, w=W, x=X, y=Y, z=Z)
    mapping = car_mapping({"from": "t"}, ATTITUDE, quaternions=quaternions())
    imported = import_log(path, mapping)
    assert_is_the_attitude(imported.run_log.table)
    assert imported.findings == ()
    write_csv(path, t=TIME, w=np.where(TIME == 0.5, 2.0, W), x=X, y=Y, z=Z)
    assert_refused(lambda: import_log(path, mapping), LogError, "log.csv", "'imu'", "row 51", "1")


def write_struct_array(path, elements):
    fields = [(name, object) for name in elements[0]]
    savemat(path, {"run": np.array([tuple(part.values()) for part in elements], fields)})


def write_struct_array_7_3(path, elements):
    """As MATLAB of version 7.3 writes it: a field is a dataset of references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in elements[0]:
            parts = [np.atleast_2d(element[name]).T for element in elements]
            refs = [
                file.create_dataset(f"#refs#/{name}{n}", data=p).ref for n, p in enumerate(parts)
            ]
            file.create_dataset(f"run/{name}", data=np.array(refs, h5py.ref_dtype))


@pytest.mark.parametrize("write", [write_struct_array, write_struct_array_7_3])
def test_struct_arrays_of_matlab(tmp_path, write):
    """Elements are samples, or trials of different length."""
    path = tmp_path / "log.mat"
    write(path, [{"t": time, "v": 2 * time, "p": [time, 1.0]} for time in TIME])
    log = read_foreign_log(path, CsvFormat())
    assert np.array_equal(log.numbers("run.v"), 2 * TIME)
    assert np.array_equal(log.numbers("run.p(2)"), np.ones(200))
    write(path, [{"t": TIME[:size], "v": TIME[:size]} for size in (50, 80)])
    log = read_foreign_log(path, CsvFormat())
    assert {name: values.size for name, values in log.columns.items()} == {
        "run.t(1)": 50, "run.t(2)": 80, "run.v(1)": 50, "run.v(2)": 80}  # fmt: skip


def test_files_with_different_clocks_are_joined_by_a_stated_offset(tmp_path):
    first = write_csv(tmp_path / "a.csv", t=TIME, v=TIME)
    second = write_csv(tmp_path / "b.csv", s=START + TIME // 1, n=TIME % 1 * 1e9, yaw=TIME)
    columns = {**SPEED, "imu_yaw_rad": {"from": "2:yaw", "time": "gps"}}
    stamps = {"gps": ["2:s", "2:n"]}

    def imported(offsets):
        mapping = car_mapping({"from": "t", "offsets": offsets}, columns, stamps=stamps)
        return import_log([first, second], mapping).run_log

    run_log = imported({2: 0.5 - START})
    assert np.allclose(run_log.time - run_log.signal("imu_yaw_rad"), 0.5, atol=0.011)
    assert_refused(lambda: imported({}), LogError, "'2:yaw'", "time.offsets")
    assert_refused(lambda: imported({3: 1.0}), LogError, "time.offsets", "3")


@pytest.mark.parametrize("date", ["20260102", "2026-01-02"])
def test_a_stamp_of_columns_of_different_size_is_refused(tmp_path, date):
    first = write_csv(tmp_path / "a.csv", t=TIME, n=TIME)
    second = write_csv(tmp_path / "b.csv", s=[date] * 100, v=TIME[:100])
    mapping = car_mapping({"from": "t"}, stamps={"gps": ["2:s", "n"]})
    named = ["b.csv", "stamps.gps", "'2:s'", "100", "'n'", "200"]
    assert_refused(lambda: import_log([first, second], mapping), LogError, *named)


def write_bag(path, ros, suffix):
    """Attitude at 100 Hz and a type that no distribution of ROS has; returns what is read."""
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    kinds = store.types
    seq = {"seq": 0} if ros == 1 else {}
    if ros == 1:
        writer = Ros1Writer(path / "log.bag")
    else:
        plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
        writer = Ros2Writer(path / "bag", version=8, storage_plugin=plugin)
    vector = kinds["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    with writer:
        imu = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        scan = writer.add_connection("/picture", "std_msgs/msg/UInt8MultiArray", typestore=store)
        serialize = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        layout = kinds["std_msgs/msg/MultiArrayLayout"]([], 0)
        picture = kinds["std_msgs/msg/UInt8MultiArray"](layout, np.zeros(1000, np.uint8))
        for time, quaternion in zip(TIME, np.transpose([X, Y, Z, W]), strict=True):
            stamp = kinds["builtin_interfaces/msg/Time"](START + int(time), round(time % 1 * 1e9))
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **seq)
            attitude = kinds["geometry_msgs/msg/Quaternion"](*quaternion)
            covariance = np.zeros(9)
            message = kinds["sensor_msgs/msg/Imu"](
                header, attitude, covariance, vector, covariance, vector, covariance)  # fmt: skip
            logged = round((START + time + 0.25) * 1e9)
            writer.write(imu, logged, serialize(message, imu.msgtype))
            writer.write(scan, logged, serialize(picture, scan.msgtype))
    if ros == 1:
        return path / "log.bag"
    return path / "bag" / (f"bag{suffix}" if suffix else "")


@pytest.mark.parametrize(("ros", "suffix"), [(1, ".bag"), (2, ""), (2, ".db3"), (2, ".mcap")])
def test_bags_of_ros(tmp_path, ros, suffix):
    path = write_bag(tmp_path, ros, suffix)
    stamps = {"stamp": [f"/imu.header.stamp.{part}" for part in ("sec", "nanosec")]}
    turned = {"imu": [f"/imu.orientation.{axis}" for axis in "wxyz"]}
    for time, late in (("stamp", 0.0), ("/imu@log_time", 0.25)):
        mapping = car_mapping({"from": time}, ATTITUDE, quaternions=turned, stamps=stamps)
        run_log = import_log(path, mapping).run_log
        assert_is_the_attitude(run_log.table)
        assert np.allclose(run_log.time - START, TIME + late, rtol=0.0, atol=5e-7)
    assert "1000 values" in read_foreign_log(path, CsvFormat()).unreadable["/picture.data"]
