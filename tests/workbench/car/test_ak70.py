"""The AK70-10 in MIT mode: exact torques, limits, and a damping that stays damping at the step of
the plant.
"""

import math

import pytest
from numpy.testing import assert_allclose

from aerodima.workbench.car.ak70 import TAIL_JOINTS, TailMotor
from aerodima.workbench.car.laws import mit_torque, torque_speed_limits
from aerodima.workbench.scenario.scenario import scenario_from_dict

MOTOR = scenario_from_dict({}).tail_motor
LINE = torque_speed_limits(MOTOR)
STALL, NO_LOAD = LINE
UNLIMITED = (1e9, 1e9)
"""A torque-speed line so high that it never acts."""


def torque(position=0.0, speed=0.0, *, q=0.0, qd=0.0, kp=0.0, kd=0.0, ff=0.0, line=UNLIMITED):
    return mit_torque(position, speed, (q, qd, kp, kd, ff), MOTOR, line)


def test_each_term_of_the_mit_law_has_its_own_gain_and_sign():
    assert torque(position=0.2, q=0.5, kp=10.0) == pytest.approx(3.0)
    assert torque(position=0.5, q=0.2, kp=10.0) == pytest.approx(-3.0)
    assert torque(speed=2.0, qd=8.0, kd=3.0) == pytest.approx(18.0)
    assert torque(speed=2.0, kd=3.0) == pytest.approx(-6.0)
    assert torque(ff=-1.25) == -1.25
    assert torque(0.1, 0.4, q=0.3, qd=-0.6, kp=20.0, kd=2.0, ff=0.5) == pytest.approx(
        4.0 - 2.0 + 0.5
    )


def test_torque_is_clipped_to_the_peak_on_both_sides():
    assert torque(ff=100.0) == MOTOR.torque_limit == 24.8
    assert torque(ff=-100.0) == -24.8


def test_gains_are_clipped_to_the_range_of_the_frame():
    assert torque(q=0.01, kp=900.0) == pytest.approx(500.0 * 0.01)
    assert torque(q=0.01, kp=-900.0) == 0.0
    assert torque(qd=1.0, kd=50.0) == pytest.approx(5.0)
    assert torque(qd=1.0, kd=-50.0) == 0.0


def test_torque_speed_line_comes_from_the_pack():
    # 25.9 V at 100 rpm/V behind 10:1 = 259 rpm; stall: 25.9 V / 0.27 ohm / (10.47 rad/s/V) * 10.
    assert pytest.approx(25.9 * 100 / 10 * 2 * math.pi / 60) == NO_LOAD
    assert pytest.approx(25.9 / 0.27 * 60 / (2 * math.pi * 100) * 10) == STALL


def test_near_the_no_load_speed_the_motor_brakes_but_does_not_push():
    for side in (1.0, -1.0):
        fast = side * 0.9 * NO_LOAD
        assert torque(speed=fast, ff=side * 20.0, line=LINE) == pytest.approx(side * 0.1 * STALL)
        assert torque(speed=side * 1.1 * NO_LOAD, ff=side * 20.0, line=LINE) == 0.0
        assert torque(speed=side * 1.1 * NO_LOAD, ff=-side * 20.0, line=LINE) == -side * 20.0


@pytest.mark.parametrize("load", [0.0, 3.0, -7.0])
@pytest.mark.parametrize("inertia", [0.005, 0.08])
def test_law_at_the_end_of_a_step_holds_at_the_end_of_the_step(load, inertia):
    position = 0.1
    speed = -0.7
    command = (0.4, 1.5, 17.0, 5.0, 0.3)
    step = 0.002
    tau = mit_torque(position, speed, command, MOTOR, UNLIMITED, (step, inertia, load))
    end_speed = speed + step * (tau + load) / inertia
    end_position = position + step * end_speed
    assert tau == pytest.approx(mit_torque(end_position, end_speed, command, MOTOR, UNLIMITED))


@pytest.mark.parametrize("kd", [1.0, 5.0])
def test_damping_calms_a_light_joint_at_any_step(kd):
    # kd h / I = 2.2 at 2 ms and 11 at 10 ms: a torque from the old rate would grow from step to
    # step beyond 2.
    inertia = 0.0045
    for step in (0.0005, 0.002, 0.01):
        speed = 1.0
        for _ in range(50):
            tau = mit_torque(
                0.0, speed, (0.0, 0.0, 0.0, kd, 0.0), MOTOR, UNLIMITED, (step, inertia, 0.0)
            )
            slower = speed + step * tau / inertia
            assert 0.0 <= slower < speed
            speed = slower


def motor_torques(commands, state, torque=0.0, step=0.0):
    """Torques of both motors on a tail of 0.08 kg m2 without friction that has not accelerated.

    Args:
        commands: of pitch and roll.
        state: angles of both, then their rates.
        torque: that acted on each joint in the last step.
        step: of the plant.
    """
    scenario = scenario_from_dict({"friction": {"coulomb": 0.0, "viscous": 0.0}})
    settings = scenario.simulation.model_copy(update={"step": step or 1e-12})
    scenario = scenario.model_copy(update={"simulation": settings})
    torques = []
    for index, joint in enumerate(TAIL_JOINTS):
        motor = TailMotor(scenario, joint)
        context = motor.CreateDefaultContext()
        inputs = {
            "joint_motion": [*state[index::2], 1.0, state[2 + index], torque, state[1]],
            "tail_command": commands[index],
        }
        for name, values in inputs.items():
            motor.GetInputPort(name).FixValue(context, values)
        torques += motor.GetOutputPort("torque").Eval(context).tolist()
    return torques


@pytest.mark.parametrize("index", range(5))
def test_nan_in_a_command_gives_no_torque_on_that_joint_only(index):
    good = [0.1, 0.0, 10.0, 0.0, 0.5]
    bad = list(good)
    bad[index] = math.nan
    assert_allclose(motor_torques((bad, good), [0.0] * 4), [0.0, 1.5])
    assert_allclose(motor_torques((good, bad), [0.0] * 4), [1.5, 0.0])


def test_held_load_is_met_exactly_whatever_the_step():
    # At rest, motor and friction balance the load of 1 N m: nothing moves, and the law gives kp
    # times the deflection.
    hold = [0.05, 0.0, 20.0, 5.0, 0.0]
    output = motor_torques((hold, hold), [0.0] * 4, torque=1.0, step=0.01)
    assert_allclose(output, [1.0, 1.0], rtol=1e-12)


@pytest.mark.parametrize("error", [0.1, -0.2])
def test_gains_and_feedforward_are_wrong_alike_and_the_peak_stays(error):
    wrong = MOTOR.model_copy(update={"torque_error": error})
    for command in ((0.3, 0.0, 20.0, 0.0, 0.0), (0.0, -0.6, 0.0, 2.0, 0.0), (0.0,) * 4 + (0.5,)):
        torque = mit_torque(0.1, 0.4, command, MOTOR, UNLIMITED)
        found = mit_torque(0.1, 0.4, command, wrong, UNLIMITED)
        assert found == pytest.approx((1.0 + error) * torque)
    strong = (0.0,) * 4 + (100.0,)
    assert mit_torque(0.0, 0.0, strong, wrong, UNLIMITED) == MOTOR.torque_limit
