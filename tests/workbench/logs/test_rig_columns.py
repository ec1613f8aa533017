from aerodima.workbench.logs.schema import missing_columns
from aerodima.workbench.scenario.signal_table import RIG_KINDS, rig_columns

UNITS = {
    "time_s": "s",
    "angle_rad": "rad",
    "angular_velocity_rad_per_s": "rad/s",
    "current_a": "A",
    **{f"force_{axis}_n": "N" for axis in "xyz"},
    **{f"torque_{axis}_n_m": "N m" for axis in "xyz"},
}


def test_rig_columns_are_those_of_the_contract_with_their_units():
    assert {column.name: column.unit for column in rig_columns()} == UNITS


def test_a_rig_log_needs_time_and_angle_and_may_lack_a_force_axis():
    for kind in RIG_KINDS:
        assert missing_columns(["time_s", "angle_rad", "torque_x_n_m"], kind, has_tail=True) == []
        assert missing_columns(["time_s", "force_y_n"], kind, has_tail=True) == ["angle_rad"]
