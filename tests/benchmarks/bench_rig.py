"""What the wind-tunnel rig costs: rollouts of a swing for fits, the diagram of the same swing, and
a static log.
"""

import time
from collections.abc import Callable, Iterator

import numpy as np
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder

from aerodima.workbench.rig.pendulum import (
    PendulumModel,
    air_torque,
    friction_torque,
)
from aerodima.workbench.rig.rig_plant import Rig, add_rig_plant
from aerodima.workbench.rig.static_hold import simulate_static_log
from aerodima.workbench.rig.swing_motion import simulate_swing
from aerodima.workbench.scenario.rig_scenario import RigScenario, load_rig_scenario
from tests.benchmarks.rows import BenchRow

_REPEATS = 5
_START = (1.5, 0.0)


def _best(action: Callable[[], object], repeats: int = _REPEATS) -> float:
    """Processor time of the fastest of some repetitions, s."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        action()
        best = min(best, time.process_time() - start)
    return float(best)


def _diagram_swing(scenario: RigScenario, step: float) -> Callable[[], np.ndarray]:
    """One second of a swing of the tail that was let go, as a Drake diagram; gives angle and rate
    at its end.
    """
    builder = DiagramBuilder()
    rig = add_rig_plant(builder, scenario)
    builder.ExportInput(rig.motor_torque, "motor_torque")
    diagram = builder.Build()

    def run() -> np.ndarray:
        simulator = Simulator(diagram)
        context = simulator.get_mutable_context()
        diagram.GetInputPort("motor_torque").FixValue(context, np.zeros(1))
        plant_context = rig.plant.GetMyMutableContextFromRoot(context)
        rig.plant.SetPositionsAndVelocities(plant_context, np.array(_START))
        ResetIntegratorFromFlags(simulator, "runge_kutta3", step)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
        simulator.AdvanceTo(1.0)
        return np.array(rig.plant.GetPositionsAndVelocities(plant_context))

    return run


def _pendulum_swing(scenario: RigScenario) -> Callable[[], np.ndarray]:
    """The same second as fits roll it out, at 4 ms; gives the angles."""
    pendulum = PendulumModel.from_scenario(scenario)
    air = air_torque(scenario)
    settings = scenario.friction
    friction = friction_torque(settings.coulomb, settings.viscous, settings.tanh_gain)
    torques = [friction] if air is None else [air, friction]
    return lambda: simulate_swing(pendulum, torques, _START, 0.004, 251)[0]


def bench_rollouts() -> Iterator[BenchRow]:
    """A second of swing in the wind of 10 m/s, once as the plain pendulum and once as the diagram,
    each at 4 ms.
    """
    scenario = load_rig_scenario("flick")
    swing = _pendulum_swing(scenario)
    diagram = _diagram_swing(scenario, 0.004)
    plain = _best(swing)
    drake = _best(diagram)
    yield BenchRow("rig: rollouts of 1 s per second", 1.0 / plain, "1/s", ">= 1", 1.0 / drake)
    finest = _diagram_swing(scenario, 0.0002)()
    error = abs(swing()[-1] - finest[0])
    yield BenchRow(
        "rig: angle of a rollout after 1 s against the diagram at 0.2 ms", error, "rad", "<= 1.2e-4"
    )
    bar = _pendulum_swing(load_rig_scenario("bar"))
    yield BenchRow("rig: bare-bar rollouts of 1 s per second", 1.0 / _best(bar), "1/s")


def bench_reaction() -> Iterator[BenchRow]:
    """Acceleration and wrench of the plant at one state among a thousand."""
    scenario = load_rig_scenario("flick")
    rig = Rig(scenario)
    angles = np.linspace(-0.5, 1.0, 1000)
    rates = np.linspace(-5.0, 5.0, 1000)

    def plant() -> None:
        for angle, rate in zip(angles, rates, strict=True):
            rig.reaction(angle, rate, 0.1)

    yield BenchRow(
        "rig: acceleration and wrench at one of 1000 states", _best(plant) * 1e6 / len(angles), "us"
    )


def bench_static_log() -> Iterator[BenchRow]:
    """A synthetic static log of 20 s at 1 kHz, model building included; 540 of them make a
    campaign.
    """
    scenario = load_rig_scenario("static")
    yield BenchRow(
        "rig: synthetic static log of 20 s", _best(lambda: simulate_static_log(scenario)), "s"
    )
