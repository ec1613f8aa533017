import numpy as np

from aerodima.workbench.scenario.signal_table import (
    CAR_PORTS,
    IMU,
    STATUS,
    TAIL_COMMAND,
    TAIL_STATE,
)
from tests.refusals import assert_refused


def test_field_order_of_the_contract():
    assert TAIL_COMMAND.fields == ("position", "velocity", "kp", "kd", "torque")
    assert TAIL_STATE.index("roll_angle") == 1
    assert TAIL_STATE.index("pitch_rate") == 3
    assert IMU.index("gyro_z") == 5
    assert IMU.index("acceleration_x") == 6
    assert STATUS.index("imu_age") == 6
    assert STATUS.index("imu_fault") == 7
    assert STATUS.index("armed") == 12
    columns = [column.name.removesuffix("_s") for column in CAR_PORTS["status"]]
    assert columns == [f"status_{name}" for name in STATUS.fields]


def test_read_and_write_are_inverse():
    values = np.arange(9.0)
    assert IMU.read(values).gyro_x == 3.0
    np.testing.assert_array_equal(IMU.write(**IMU.read(values)._asdict()), values)


def test_a_missing_field_is_named():
    rest = dict.fromkeys(TAIL_COMMAND.fields[:-1], 0.0)
    assert_refused(lambda: TAIL_COMMAND.write(**rest), TypeError, "torque")
