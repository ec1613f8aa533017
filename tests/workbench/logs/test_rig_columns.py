from aerodima.workbench.config.signal_table import RIG_KINDS, rig_columns
from aerodima.workbench.logs.schema import missing_columns

CONTRACT = [
    "time_s", "angle_rad", "angular_velocity_rad_per_s", "current_a", "force_x_n", "force_y_n",
    "force_z_n",
    "torque_x_n_m", "torque_y_n_m", "torque_z_n_m",
]  # fmt: skip


def test_rig_columns_are_those_of_the_contract_with_their_units() -> None:
    assert [column.name for column in rig_columns()] == CONTRACT
    assert [column.unit for column in rig_columns()] == [
        "s",
        "rad",
        "rad/s",
        "A",
        *["N"] * 3,
        *["N m"] * 3,
    ]


def test_a_rig_log_needs_time_and_angle_and_may_lack_a_force_axis() -> None:
    for kind in RIG_KINDS:
        assert missing_columns(["time_s", "angle_rad", "torque_x_n_m"], kind, has_tail=True) == []
        assert missing_columns(["time_s", "force_y_n"], kind, has_tail=True) == ["angle_rad"]
