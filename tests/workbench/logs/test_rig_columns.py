from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import refuse_missing
from aerodima.workbench.scenario.signal_table import RIG_KINDS, rig_columns
from tests.refusals import assert_refused

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
        facts = {"kind": kind}
        refuse_missing(["time_s", "angle_rad", "torque_x_n_m"], facts, "log")
        lacking = ["time_s", "force_y_n"]
        assert_refused(
            lambda lacking=lacking, facts=facts: refuse_missing(lacking, facts, "log"),
            LogError,
            "log: 1 ",
            "angle_rad",
        )
