"""The tailless flip speed against MuJoCo: the same plant, with the same tyres and with MuJoCo's own
contact.
"""

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, MatrixGain, Saturation, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from aerodima.workbench.car.car_plant import add_car_plant
from aerodima.workbench.car.laws import shaft_gain
from aerodima.workbench.car.termination import quaternion_flipped
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.port_wiring import add_and_connect
from aerodima.workbench.scenario.scenario import Scenario, load_scenario
from tests.benchmarks.mujoco_car import commanded, flips_in_mujoco, load_model
from tests.benchmarks.rows import BenchRow

SCENARIO = "turn_none"
SLOW, FAST = 2.0, 4.5
TOLERANCE = 0.05
"""m/s; also how far the answer of a coarse step may be from that of the fine one."""
FINE = 0.0005
STEPS = (0.005, 0.004, 0.002, 0.001)
"""s, coarsest first."""
LOOK = 0.02
"""Between two looks at whether Drake's car has flipped, s."""
STANDING_STEPS = 1000
Flips = Callable[[Scenario, float], bool]
"""Whether the car of a scenario flips at a step, s."""


def bench_flip_speed() -> Iterator[BenchRow]:
    """Flip speed of the plant alone in Drake, in MuJoCo with Drake's tyres, and in MuJoCo with its
    own contact; and the time to find it to 0.05 m/s, each engine at its coarsest sufficient step.

    The time has no goal: both engines need about 2 ms, at which a step of the standing car costs
    Drake ten times as much (`bench_raw_step`), and nothing of this project takes part in it.
    """
    fine = {name: _flip_speed(flips, FINE)[0] for name, flips in ENGINES.items()}
    for name, speed in fine.items():
        yield BenchRow(f"tailless flip speed, {name}, {1000 * FINE:g} ms", speed, "m/s")
    difference = abs(fine[DRAKE] / fine[SAME_TYRES] - 1.0)
    yield BenchRow("tailless flip speed, Drake against MuJoCo", difference, "1", "<= 0.03")
    seconds = {}
    for name in (DRAKE, OWN_CONTACT):
        for step in STEPS:
            speed, seconds[name] = _flip_speed(ENGINES[name], step)
            if abs(speed - fine[name]) <= TOLERANCE:
                break
        yield BenchRow(f"tailless flip speed, {name}, {1000 * step:g} ms", speed, "m/s")
    yield BenchRow(
        "tailless flip speed to 0.05 m/s, Drake over MuJoCo",
        seconds[DRAKE],
        "s",
        "",
        seconds[OWN_CONTACT],
    )


def bench_raw_step() -> Iterator[BenchRow]:
    """One step of the standing car at 2 ms: plant alone, without controller, sensors and log."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]  # of the extra `bench`

    scenario = load_scenario(SCENARIO)
    step = scenario.simulation.step
    builder = DiagramBuilder()
    add_car_plant(builder, scenario)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.1)
    start = time.perf_counter()
    simulator.AdvanceTo(0.1 + STANDING_STEPS * step)
    ours = (time.perf_counter() - start) / STANDING_STEPS
    model = load_model(scenario, step, own_contact=True)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 50)
    start = time.perf_counter()
    mujoco.mj_step(model, data, STANDING_STEPS)
    theirs = (time.perf_counter() - start) / STANDING_STEPS
    yield BenchRow(
        "raw step of the standing car, Drake over MuJoCo", 1e6 * ours, "us", "", 1e6 * theirs
    )


def _flip_speed(flips: Flips, step: float) -> tuple[float, float]:
    """Returns the middle of the bracket (m/s), and the wall time (s) of the bisection; NaN where
    the first bracket does not hold a flip speed.
    """
    low = SLOW
    high = FAST
    start = time.perf_counter()
    if flips(_scenario(low, step), step) or not flips(_scenario(high, step), step):
        return math.nan, time.perf_counter() - start
    while high - low > TOLERANCE:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if flips(_scenario(middle, step), step) else (middle, high)
    return 0.5 * (low + high), time.perf_counter() - start


def _scenario(speed: float, step: float) -> Scenario:
    rate = min(500.0, 1.0 / step)
    settings = [
        f"manoeuvre.speed={speed!r}",
        f"simulation.step={step!r}",
        f"simulation.log_rate={rate:g}",
    ]
    return load_scenario(SCENARIO, settings)


def make_drake_turn(scenario: Scenario, step: float) -> tuple[Simulator, Any, Any]:
    """Makes the plant alone, driven as MuJoCo's; returns simulator, plant and context of it."""
    builder = DiagramBuilder()
    car = add_car_plant(builder, scenario, sampled_outputs=False)
    plant = car.plant
    joints = plant.GetActuatorNames(car.car)
    knuckles, rates = commanded(scenario, step)

    def played(rows: FloatArray) -> OutputPort:
        held = PiecewisePolynomial.ZeroOrderHold(
            [k * step for k in range(len(rows))], [row[:, None] for row in rows]
        )
        return builder.AddSystem(TrajectorySource(held)).get_output_port()

    place = np.zeros((2, 2 * len(joints)))
    place[[0, 1], [joints.index(f"front_{side}_steering") for side in ("left", "right")]] = 1.0
    builder.Connect(played(knuckles @ place), plant.get_desired_state_input_port(car.car))
    gain = shaft_gain(scenario.drive, scenario.car)
    limit = np.array([scenario.drive.torque_limit])
    braking = np.zeros((1, plant.num_multibody_states()))
    torque = np.zeros((len(joints), 1))
    braking[
        0, plant.num_positions() + plant.GetJointByName("drive_shaft_spin").velocity_start()
    ] = -gain
    torque[joints.index("drive_shaft_spin"), 0] = 1.0
    total = builder.AddSystem(Adder(2, 1))
    limited = builder.AddSystem(Saturation(-limit, limit))
    slowed = add_and_connect(builder, MatrixGain(braking), u0=plant.get_state_output_port())
    for index, port in enumerate((played(gain * rates[:, None]), slowed.get_output_port())):
        builder.Connect(port, total.get_input_port(index))
    builder.Connect(total.get_output_port(), limited.get_input_port())
    driven = add_and_connect(builder, MatrixGain(torque), u0=limited.get_output_port())
    builder.Connect(driven.get_output_port(), plant.get_actuation_input_port(car.car))
    simulator = Simulator(builder.Build())
    return simulator, plant, plant.GetMyContextFromRoot(simulator.get_context())


def _flips_in_drake(scenario: Scenario, step: float) -> bool:
    """Returns whether the tilt passes 75 degrees; the run ends there."""
    simulator, plant, context = make_drake_turn(scenario, step)
    quaternion = plant.GetBodyByName("chassis").floating_positions_start()
    for end in np.arange(LOOK, scenario.manoeuvre.duration, LOOK):
        simulator.AdvanceTo(end)
        if quaternion_flipped(plant.GetPositions(context)[quaternion : quaternion + 4]):
            return True
    return False


DRAKE = "Drake"
SAME_TYRES = "MuJoCo with Drake's tyres"
OWN_CONTACT = "MuJoCo with its own contact"
ENGINES: dict[str, Flips] = {
    DRAKE: _flips_in_drake,
    SAME_TYRES: partial(flips_in_mujoco, own_contact=False),
    OWN_CONTACT: partial(flips_in_mujoco, own_contact=True),
}
