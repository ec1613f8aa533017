import numpy as np
import pytest

from aerodima.workbench.config.signal_table import (
    IMU,
    STATION_INPUTS,
    STATION_OUTPUTS,
    STATUS,
    TAIL_COMMAND,
    TAIL_STATE,
    PortFields,
)


def test_station_ports_have_the_sizes_of_the_contract():
    assert {name: fields.size for name, fields in STATION_INPUTS.items()} == {
        "steering_angle": 1,
        "throttle": 1,
        "tail_pitch_command": 5,
        "tail_roll_command": 5,
    }
    assert {name: fields.size for name, fields in STATION_OUTPUTS.items()} == {
        "tail_state": 6,
        "tail_torque": 2,
        "imu": 9,
        "speed": 1,
        "status": 13,
    }


def test_field_order_of_the_contract():
    assert TAIL_COMMAND.fields == ("position", "velocity", "kp", "kd", "torque")
    assert TAIL_STATE.index("roll_angle") == 1
    assert TAIL_STATE.index("pitch_rate") == 3
    assert IMU.index("gyro_z") == 5
    assert IMU.index("acceleration_x") == 6
    assert STATUS.index("imu_age") == 6
    assert STATUS.index("imu_fault") == 7
    assert STATUS.index("armed") == 12


def test_read_and_write_are_inverse():
    values = np.arange(9.0)
    assert IMU.read(values).gyro_x == 3.0
    np.testing.assert_array_equal(IMU.write(**IMU.read(values)._asdict()), values)


def test_unknown_field_and_wrong_length_are_named():
    with pytest.raises(
        ValueError, match="TailState has no field 'yaw'; it has pitch_angle, roll_angle"
    ):
        TAIL_STATE.index("yaw")
    with pytest.raises(ValueError, match="TailCommand has 5 elements, got 4"):
        TAIL_COMMAND.read([0.0] * 4)
    with pytest.raises(TypeError, match="torque"):
        TAIL_COMMAND.write(position=0.0, velocity=0.0, kp=0.0, kd=0.0)


def test_equal_fields_make_equal_ports():
    assert PortFields("A", ("x",)) == PortFields("A", ("x",))
    assert PortFields("A", ("x",)) != PortFields("A", ("y",))
