"""The table of signs both ways, and what a wrong ports file is told."""

import itertools
import json
import math
from functools import partial

import numpy as np
import pytest

from aerodima.hardware.car.car_ports import ports_from_dict, read_operator_ports, read_ports
from aerodima.hardware.car.mounting import AXES, load_mounting
from aerodima.hardware.car.wirings import tail_motors, wire_car
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.hardware.driving.motor_zero import write_zeros
from aerodima.workbench.car.car_station import NOT_FITTED
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.scenario.scenario import load_scenario
from tests.hardware.car.fake_devices import PORTS
from tests.refusals import assert_refused

PAIRS = [pair for pair in itertools.product(AXES, AXES) if AXES[pair[0]] @ AXES[pair[1]] == 0]


@pytest.mark.parametrize("axes", PAIRS, ids="".join)
def test_what_an_emulator_writes_is_what_the_car_reads_however_the_chip_is_mounted(axes):
    mounting = load_mounting().model_copy(update={"imu_x": axes[0], "imu_y": axes[1]})
    reading = np.array([0.1, -0.2, 2.9, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_allclose(
        mounting.imu_reading(mounting.imu_sample(reading)), reading, atol=1e-12
    )


def test_a_chip_turned_to_the_left_feels_the_cars_acceleration_forwards_on_its_minus_y_axis():
    mounting = load_mounting().model_copy(update={"imu_x": "-y", "imu_y": "+x"})
    sample = mounting.imu_sample(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.7, 2.0, 0.0, 0.0]))
    assert sample.acceleration == pytest.approx((0.0, -2.0, 0.0))
    assert sample.gyro == pytest.approx((0.0, 0.0, 0.7))


def test_chip_axes_that_are_none_are_refused():
    for x, y in (("+x", "-x"), ("x", "+y")):
        wrong = load_mounting().model_copy(update={"imu_x": x, "imu_y": y})
        assert_refused(lambda wrong=wrong: wrong.chip_to_body, HardwareError, "imu_x", x)


def test_pulses_and_sail_go_both_ways():
    mounting = load_mounting().model_copy(
        update={"sail_zero": 0.3, "sail_direction": -1, "steering_direction": -1}
    )
    for angle in (-0.5, -0.1, 0.0, 0.3):
        assert mounting.steering_angle(mounting.servo_pulse(angle)) == pytest.approx(
            angle, abs=5e-4
        )
        assert mounting.throttle(mounting.throttle_pulse(angle)) == pytest.approx(angle, abs=1.3e-3)
        assert mounting.sail_angle(mounting.encoder_angle(angle)) == pytest.approx(
            angle % (2 * math.pi)
        )
    assert mounting.servo_pulse(0.1) < 1500


def test_not_fitted_has_one_code_in_simulation_and_on_the_car():
    assert SourceFault.NOT_FITTED == NOT_FITTED


def test_motors_have_the_range_of_the_scenario_and_the_direction_of_the_table_or_the_ports():
    scenario = load_scenario("auto_turn")
    data = {**PORTS, "tail_roll": {"motor_id": 7, "zero": 0.25, "direction": -1}}
    pitch, roll = tail_motors(scenario, ports_from_dict(data), load_mounting())
    assert isinstance(pitch, MotorSettings)
    assert (roll.motor_id, roll.zero, roll.direction, pitch.direction) == (7, 0.25, -1, 1)
    assert roll.high == scenario.tail.roll_limit


WRONG = {
    "unknown key": ({"gyro": {"path": "/dev/x"}}, "gyro"),
    "schema": ({"schema": "aerodima/ports/2"}, "aerodima/ports/1", "aerodima/ports/2"),
    "device twice": ({"gps": {"path": "/dev/b"}}, "gps.path", "/dev/b", "imu"),
    "Teensy as adapter": (
        {"can": {"interface": "slcan", "channel": "/dev/a@115200"}, "teensy": {"path": "/dev/a"}},
        "can.channel",
        "/dev/a",
        "teensy.path",
    ),
    "profile": ({"firmware_profile": "ak70_10_v9"}, "ak70_10_v9"),
    "ids": ({"tail_roll": {"motor_id": 1}}, "id 1"),
    "id": ({"tail_roll": {"motor_id": 64}}, "tail_roll.motor_id", "64"),
    "degrees": ({"tail_roll": {"motor_id": 2, "zero": 90.0}}, "tail_roll.zero", "90", "rad"),
    "v3": ({"firmware_profile": "V3.0"}, "V3.0"),
    "rate": ({"imu": {"path": "/dev/b", "rate": 0}}, "imu.rate", "0"),
}


@pytest.mark.parametrize("row", WRONG.values(), ids=WRONG)
def test_a_wrong_ports_file_is_told_by_key_and_value(tmp_path, row):
    changes, *named = row
    path = tmp_path / "ports.json"
    path.write_text(json.dumps({**PORTS, **changes}))
    assert_refused(lambda: read_ports(path), HardwareError, *named)


NO_PORTS = {
    "missing": None,
    "cut": "{",
    "a list": "[]",
    "deep": "[" * 100_000,
    "half": '{"schema": "aerodima/ports/1", "imu": {"path": "x"}}',
}


@pytest.mark.parametrize("text", NO_PORTS.values(), ids=NO_PORTS)
@pytest.mark.parametrize("read", [read_ports, partial(write_zeros, angles={"tail_roll": 0.1})])
def test_what_is_no_ports_file_is_refused_by_its_name(tmp_path, read, text):
    path = tmp_path / "ports.json"
    if text is not None:
        path.write_text(text)
    assert_refused(lambda: read(path), HardwareError, "ports.json")


def test_the_operators_computer_names_its_radio_alone(tmp_path):
    path = tmp_path / "ports.json"
    console = {"schema": "aerodima/ports/1", "console": {"path": "/dev/c"}, "car": 3}
    for data in (console, PORTS | console):
        path.write_text(json.dumps(data))
        ports = read_operator_ports(path)
        assert (ports.console.path, ports.car) == ("/dev/c", 3)
    path.write_text(json.dumps(console))
    assert_refused(lambda: read_ports(path), HardwareError, "teensy", "imu")
    path.write_text(json.dumps(console | {"consol": {}}))
    assert_refused(lambda: read_operator_ports(path), HardwareError, "consol", "'console'")


def test_a_file_without_an_end_is_refused():
    assert_refused(lambda: read_ports("/dev/zero"), HardwareError, "/dev/zero", "longer")


def test_a_wiring_without_its_adapter_is_refused():
    scenario = load_scenario("auto_turn")
    ports = ports_from_dict(PORTS)
    bridge = wire_car(scenario, ports, "teensy_bridge", lambda: None)
    assert_refused(bridge.start, HardwareError, "teensy", "/dev/a")
    watched = lambda: wire_car(scenario, ports, "watched_can", lambda: None)  # noqa: E731
    assert_refused(watched, HardwareError, "watched_can")
