"""The table of signs both ways, and what a wrong ports file is told."""

import itertools
import json
import math

import numpy as np
import pytest

from aerodima.hardware.car.car_ports import ports_from_dict, read_ports
from aerodima.hardware.car.mounting import AXES, load_mounting
from aerodima.hardware.car.wirings import tail_motors, wire_car
from aerodima.hardware.devices.device_states import SourceFault
from aerodima.hardware.devices.motor_settings import MotorSettings
from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.errors import HardwareError
from aerodima.workbench.stations.car_station import NOT_FITTED
from tests.hardware.car.fake_devices import PORTS

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
        with pytest.raises(HardwareError, match="imu_x"):
            load_mounting().model_copy(update={"imu_x": x, "imu_y": y}).chip_to_body  # noqa: B018


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
    "unknown key": ({**PORTS, "gyro": {"path": "/dev/x"}}, "gyro: unknown key"),
    "missing device": ({"schema": PORTS["schema"], "imu": PORTS["imu"]}, "teensy: missing"),
    "schema": ({**PORTS, "schema": "aerodima/ports/2"}, "allowed is 'aerodima/ports/1'"),
    "device twice": ({**PORTS, "gps": {"path": "/dev/b"}}, "gps.path: /dev/b is that of imu too"),
    "profile": ({**PORTS, "firmware_profile": "ak70_10_v9"}, "is unknown; allowed: ak70_10_v1_0_8"),
    "ids": (
        {**PORTS, "tail_roll": {"motor_id": 1}},
        "both motors have the id 1; each needs its own",
    ),
    "id": ({**PORTS, "tail_roll": {"motor_id": 64}}, "tail_roll.motor_id: 64"),
    "v3": ({**PORTS, "firmware_profile": "V3.0"}, "V3 firmware"),
    "list": ([], "holds a list; allowed is a mapping"),
    "rate": ({**PORTS, "imu": {"path": "/dev/b", "rate": 0}}, "imu.rate: 0 is not allowed"),
}


@pytest.mark.parametrize(("data", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_ports_file_is_told_in_one_line(tmp_path, data, message):
    path = tmp_path / "ports.json"
    path.write_text(json.dumps(data))
    with pytest.raises(HardwareError) as caught:
        read_ports(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_file_and_no_json_are_told(tmp_path):
    with pytest.raises(HardwareError, match="no such ports file"):
        read_ports(tmp_path / "none.json")
    (tmp_path / "ports.json").write_text("{")
    with pytest.raises(HardwareError, match="cannot be read as JSON"):
        read_ports(tmp_path / "ports.json")


def test_a_wiring_without_its_adapter_is_refused():
    scenario = load_scenario("auto_turn")
    with pytest.raises(
        HardwareError, match=r"teensy: /dev/a: cannot be opened: there is no such device"
    ):
        wire_car(scenario, ports_from_dict(PORTS), "teensy_bridge", lambda: None).start()
    with pytest.raises(HardwareError, match="watched_can needs a CAN adapter"):
        wire_car(scenario, ports_from_dict(PORTS), "watched_can", lambda: None)
    with pytest.raises(HardwareError, match="set the zero nearer"):
        tail_motors(
            scenario,
            ports_from_dict({**PORTS, "tail_roll": {"motor_id": 2, "zero": 12.0}}),
            load_mounting(),
        )
