"""Bags of ROS, MCAP with messages of ROS 2, ULog: written by the formats' own libraries or by their definition."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from aerodima.optimisation.identify.static_fit import fit_static
from aerodima.optimisation.identify.static_log import static_data
from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.foreign_files import read_foreign_log
from aerodima.workbench.logs.importers import import_log
from aerodima.workbench.logs.mapping import mapping_from
from aerodima.workbench.plants.rig import Rig
from tests.optimisation.identify.static_truth import CD, log_with_rest, static_scenario

TYPES = get_typestore(Stores.ROS2_HUMBLE)
STAMPS = (5.0, 5.01, 5.02)
WRENCH = [f"{quantity}_{axis}" for quantity in ("force", "torque") for axis in "xyz"]


def wrench_message(types: Any, time: float, wrench: np.ndarray) -> Any:
    vector, stamp = types.types["geometry_msgs/msg/Vector3"], types.types["builtin_interfaces/msg/Time"]
    second, part = divmod(round(time * 1e9), 1_000_000_000)
    header = types.types["std_msgs/msg/Header"](
        stamp=stamp(sec=second, nanosec=part), frame_id="sensor", **({"seq": 0} if types is not TYPES else {})
    )
    force, torque = vector(*map(float, wrench[:3])), vector(*map(float, wrench[3:]))
    inner = types.types["geometry_msgs/msg/Wrench"](force=force, torque=torque)
    return types.types["geometry_msgs/msg/WrenchStamped"](header=header, wrench=inner)


def joint_message(position: float, effort: float, time: float) -> Any:
    header = wrench_message(TYPES, time, np.zeros(6)).header
    return TYPES.types["sensor_msgs/msg/JointState"](
        header=header,
        name=["tail"],
        position=np.array([position]),
        velocity=np.array([]),
        effort=np.array([effort]),
    )


def ros2_bag(path: Path, storage: StoragePlugin, messages: list[tuple[str, float, Any]]) -> Path:
    with Writer2(path, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, time, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], round(time * 1e9), TYPES.serialize_cdr(message, kind))
    return path


def wrenches(times: tuple[float, ...] = STAMPS) -> list[tuple[str, float, Any]]:
    """Logged 2 ms after their stamps; the force along x is the number of the message."""
    return [("/ft", t + 0.002, wrench_message(TYPES, t, np.array([i, 0, 0, 0, 0, 7]))) for i, t in enumerate(times)]


def ros1_bag(folder: Path) -> Path:
    types = get_typestore(Stores.ROS1_NOETIC)
    path, kind = folder / "run.bag", "geometry_msgs/msg/WrenchStamped"
    with Writer1(path) as writer:
        connection = writer.add_connection("/ft", kind, typestore=types)
        for index, time in enumerate(STAMPS):
            message = wrench_message(types, time, np.array([index, 0, 0, 0, 0, 7]))
            writer.write(connection, round((time + 0.002) * 1e9), types.serialize_ros1(message, kind))
    return path


def mcap_of_ros2(folder: Path, definition: str | None = None) -> Path:
    """As a recorder of another make writes it: one file, no metadata.yaml, the definition in the file."""
    path, kind = folder / "run.mcap", "geometry_msgs/msg/WrenchStamped"
    text = TYPES.generate_msgdef(kind, ros_version=2)[0] if definition is None else definition
    with open(path, "wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(name=kind, encoding="ros2msg", data=text.encode())
        channel = writer.register_channel(topic="/ft", message_encoding="cdr", schema_id=schema)
        for _, time, message in wrenches():
            stamp = round(time * 1e9)
            data = bytes(TYPES.serialize_cdr(message, kind))
            writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "write",
    [
        lambda folder: ros2_bag(folder / "sqlite", StoragePlugin.SQLITE3, wrenches()),
        lambda folder: ros2_bag(folder / "mcap", StoragePlugin.MCAP, wrenches()),
        ros1_bag,
        mcap_of_ros2,
    ],
    ids=["ROS 2, SQLite", "ROS 2, MCAP", "ROS 1", "MCAP alone"],
)
def test_numbers_and_both_times_of_a_bag(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    log = read_foreign_log(write(tmp_path))
    assert log.unreadable == {}
    assert log.numbers("/ft.wrench.force.x").tolist() == [0.0, 1.0, 2.0]
    assert log.numbers("/ft.wrench.torque.z").tolist() == [7.0, 7.0, 7.0]
    assert log.numbers("/ft@header_stamp") == pytest.approx(STAMPS, abs=1e-9)
    assert log.numbers("/ft@log_time") == pytest.approx(np.array(STAMPS) + 0.002, abs=1e-9)
    assert log.time_of["/ft.wrench.force.x"] == "/ft@log_time"


def test_a_bag_of_the_wind_tunnel_is_imported_and_fitted_like_the_same_hold_as_csv(tmp_path: Path) -> None:
    scenario = static_scenario(1, "major", 30.0, 20.0, 0.03).varied(experiment={"duration": 4.0})
    run = log_with_rest(scenario, Rig(scenario), Rig(scenario.varied(experiment={"wind_speed": 0.0})), 1.0)
    table = run.table
    columns = [f"{name}_n" if name.startswith("force") else f"{name}_n_m" for name in WRENCH]
    messages = []
    for row in range(len(table)):
        time = float(table["time_s"][row])
        joint = joint_message(float(table["angle_rad"][row]), float(table["current_a"][row]), time)
        messages += [
            ("/ft", time, wrench_message(TYPES, time, table[columns].iloc[row].to_numpy())),
            ("/joints", time, joint),
        ]
    bag = ros2_bag(tmp_path / "hold", StoragePlugin.SQLITE3, messages)
    table.to_csv(tmp_path / "hold.csv", index=False)
    joints = {"angle_rad": "/joints.position(1)", "current_a": "/joints.effort(1)"}
    topics = joints | {
        column: f"/ft.wrench.{name.replace('_', '.')}" for column, name in zip(columns, WRENCH, strict=True)
    }
    facts = {"tail": 1, "axis": "major", "wind_speed_m_per_s": 20.0, "rest_s": [0, 1], "current_sampling": "mean"}

    def fitted(path: Path, time: str, sources: dict[str, str]) -> tuple[np.ndarray, dict[str, Any]]:
        named = {"columns": {ours: {"from": theirs} for ours, theirs in sources.items()}, "metadata": facts}
        form = {"schema": "aerodima/log-mapping/1", "kind": "static", "time": {"from": time}, **named}
        log = import_log(path, mapping_from(form, "m.yaml")).run_log
        estimates = fit_static(static_data(log)).estimates
        return log.table[columns].to_numpy(), {estimate.name: estimate for estimate in estimates}

    from_bag, bag_fit = fitted(bag, "/ft@header_stamp", topics)
    from_csv, csv_fit = fitted(tmp_path / "hold.csv", "time_s", {name: name for name in topics})
    assert from_bag == pytest.approx(from_csv, abs=1e-12)
    for name, estimate in csv_fit.items():
        assert bag_fit[name].value == pytest.approx(estimate.value, rel=1e-6)
    assert bag_fit["cd"].lower < CD < bag_fit["cd"].upper


def ulog(path: Path) -> Path:
    """By the definition of the format, https://docs.px4.io/main/en/dev_log/ulog_file_format."""

    def message(kind: bytes, payload: bytes) -> bytes:
        return struct.pack("<HB", len(payload), kind[0]) + payload

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    data += message(b"F", b"rates:uint64_t timestamp;float yaw;float[2] motor;")
    for instance in (0, 1):
        data += message(b"A", struct.pack("<BH", instance, instance) + b"rates")
    for instance, step in ((0, 0), (1, 0), (0, 1), (1, 1)):
        row = struct.pack("<HQfff", instance, 1_000_000 + 10_000 * step, 0.5 * step - instance, 3.0, 4.0 + step)
        data += message(b"D", row)
    path.write_bytes(data)
    return path


def test_two_instances_of_a_topic_of_px4(tmp_path: Path) -> None:
    log = read_foreign_log(ulog(tmp_path / "flight.ulg"))
    assert log.numbers("rates.yaw").tolist() == [0.0, 0.5]
    assert log.numbers("rates_1.yaw").tolist() == [-1.0, -0.5]
    assert log.numbers("rates.motor[1]").tolist() == [4.0, 5.0]
    assert log.numbers("rates_1@log_time") == pytest.approx([1.0, 1.01])


def test_a_picture_is_no_signal(tmp_path: Path) -> None:
    header = wrench_message(TYPES, 1.0, np.zeros(6)).header
    scan = TYPES.types["sensor_msgs/msg/Image"](
        header=header, height=9, width=9, encoding="mono8", is_bigendian=0, step=9, data=np.zeros(81, np.uint8)
    )
    log = read_foreign_log(ros2_bag(tmp_path / "bag", StoragePlugin.SQLITE3, [("/camera", 1.0, scan)]))
    assert [name for name in log.columns if "data" in name] == []
    assert log.numbers("/camera.width").tolist() == [9.0]


def test_what_is_no_bag_or_a_part_of_one_is_said_in_one_line(tmp_path: Path) -> None:
    def refusal(path: Path) -> str:
        with pytest.raises(LogError) as caught:
            read_foreign_log(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    bag = ros2_bag(tmp_path / "bag", StoragePlugin.SQLITE3, wrenches())
    assert f"name its folder, with metadata.yaml: {bag}" in refusal(next(bag.glob("*.db3")))
    next(bag.glob("*.db3")).write_bytes(b"rubbish")
    assert "cut off, damaged or not a bag of ROS" in refusal(bag)
    (tmp_path / "empty").mkdir()
    assert "a folder without metadata.yaml" in refusal(tmp_path / "empty")
    (tmp_path / "cut.ulg").write_bytes(ulog(tmp_path / "flight.ulg").read_bytes()[:20])
    assert "cut.ulg: " in refusal(tmp_path / "cut.ulg")
    (tmp_path / "cut.bag").write_bytes(ros1_bag(tmp_path).read_bytes()[:200])
    assert "cut off, damaged or not a bag of ROS" in refusal(tmp_path / "cut.bag")
    assert "the definition of geometry_msgs/msg/WrenchStamped cannot be read" in refusal(
        mcap_of_ros2(tmp_path, "strange_msgs/Unknown what\n???")
    )
