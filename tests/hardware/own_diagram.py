"""What a stranger writes: a controller with discrete and continuous state for tail and steering;
and broken ones.

`build` is for `simulate`, `drive` and `--diagram`. The others break in the tick of `BREAKS_AT`, and
write when that was (s, `time.monotonic`) into the file that the environment names.
"""

import math
import os
import time
from pathlib import Path

import numpy as np
from pydrake.systems.framework import LeafSystem
from pydrake.systems.primitives import Integrator, LogVectorOutput

BREAKS_AT, STALL = 1.0, 0.05
BROKE_FILE = "AERODIMA_TEST_BROKE"
OWN = ["tick_s", "turned_rad", "yaw_rate_rad_per_s", "way_m"]


class LeanIn(LeafSystem):
    """Steers to the left from 2 to 2.4 s, and lifts the tail by twice the angle that the car has
    turned.

    The throttle rises more slowly than the guard of the car allows, so that simulated and real car
    accelerate alike.
    """

    def __init__(self, broken=lambda: 0.0):
        super().__init__()
        self._broken = broken
        self._imu = self.DeclareVectorInputPort("imu", 9)
        seen = self.DeclareDiscreteState(3)
        self.DeclareStateOutputPort("seen", seen)
        for name, size in (
            ("steering_angle", 1),
            ("throttle", 1),
            ("tail_pitch_command", 5),
            ("tail_roll_command", 5),
        ):
            calc = getattr(self, f"_calc_{name}")
            self.DeclareVectorOutputPort(name, size, calc, {self.discrete_state_ticket(seen)})
        self.DeclarePeriodicDiscreteUpdateEvent(0.01, 0.0, self._tick)

    def _tick(self, context, state):
        time_now = context.get_time()
        yaw_rate = float(self._imu.Eval(context)[5])
        turned = float(context.get_discrete_state_vector().value()[1]) + 0.01 * yaw_rate
        if time_now > BREAKS_AT:
            turned += self._broken()
        state.set_value(np.array([time_now, turned, yaw_rate]))

    def _calc_steering_angle(self, context, out):
        time_now = context.get_discrete_state_vector().value()[0]
        out.set_value([0.2 if 2.0 <= time_now < 2.4 else 0.0])

    def _calc_throttle(self, context, out):
        time_now = context.get_discrete_state_vector().value()[0]
        out.set_value([min(0.3, 0.12 + 0.15 * time_now)])

    def _calc_tail_pitch_command(self, context, out):
        out.set_value([0.0, 0.0, 17.0, 5.0, 0.0])

    def _calc_tail_roll_command(self, context, out):
        turned = context.get_discrete_state_vector().value()[1]
        angle = -math.pi / 2 + np.clip(2.0 * turned, 0.0, 1.0)  # NaN stays NaN
        out.set_value([angle, 0.0, 17.0, 5.0, 0.0])


def build(
    builder,
    station,
    broken=lambda: 0.0,
    heard=True,
):
    """Adds the controller and an integrator of the speed; what they find becomes columns of the
    log.
    """
    controller = builder.AddNamedSystem("lean_in", LeanIn(broken))
    if heard:
        builder.Connect(station.GetOutputPort("imu"), controller.GetInputPort("imu"))
    for name in ("steering_angle", "throttle", "tail_pitch_command", "tail_roll_command"):
        builder.Connect(controller.GetOutputPort(name), station.GetInputPort(name))
    builder.ExportOutput(controller.GetOutputPort("seen"), ", ".join(OWN[:3]))
    way = builder.AddSystem(Integrator(1))
    builder.Connect(station.GetOutputPort("speed"), way.get_input_port())
    LogVectorOutput(way.get_output_port(), builder).set_name(OWN[3])


def _note():
    path = Path(os.environ[BROKE_FILE])
    if not path.exists():
        path.with_suffix(".part").write_text(str(time.monotonic()), encoding="utf-8")
        path.with_suffix(".part").rename(path)


def _raise():
    _note()
    raise ZeroDivisionError("in my controller")


def _nan():
    _note()
    return math.nan


def _stall():
    _note()
    time.sleep(STALL)
    return 0.0


def _hang():
    _note()
    while True:
        try:
            math.sqrt(2.0)
        except Exception:  # as who tries again would write it
            continue


def _hang_for_good():
    _note()
    while True:
        try:
            math.sqrt(2.0)
        except BaseException:  # nothing reaches it
            continue


def raises(builder, station):
    build(builder, station, _raise)


def commands_nan(builder, station):
    build(builder, station, _nan)


def stalls(builder, station):
    build(builder, station, _stall)


def hangs(builder, station):
    build(builder, station, _hang)


def hangs_for_good(builder, station):
    build(builder, station, _hang_for_good)


def unconnected(builder, station):
    build(builder, station, heard=False)


def no_throttle(builder, station):
    controller = builder.AddSystem(LeanIn())
    for name in ("steering_angle", "tail_pitch_command", "tail_roll_command"):
        builder.Connect(controller.GetOutputPort(name), station.GetInputPort(name))
