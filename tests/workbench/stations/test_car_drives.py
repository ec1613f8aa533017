"""What drives the plant: the same with and without the truth beside it, and the air as Drake's
kinematics have it.
"""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import LogVectorOutput

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import STATION_OUTPUTS
from aerodima.workbench.controllers.manoeuvre import run_time
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.stations.car_drives import DRIVES
from aerodima.workbench.stations.car_station import simulated_car
from aerodima.workbench.systems.system_ports import Stage, period_of

WIND = ["wind.mean_x=-1.0", "wind.mean_y=2.0", "wind.gust_amplitude=1.0", "wind.turbulence=0.5"]
RUNS = {
    "published swing": ("turn_swing", []),
    "no tail": ("turn_none", []),
    "no tail, flips": ("turn_none", ["manoeuvre.speed=3.61"]),
    "locked sail": ("turn_swing", ["tail.sail=locked"]),
    "coefficients over speed": (
        "turn_swing",
        ["tail.coefficients=robot_tail_line", "manoeuvre.duration=2.7"],
    ),
    "free sail through the turn": ("turn_swing", ["tail.sail=free", "manoeuvre.duration=2.7"]),
    "added mass in wind": ("turn_swing", ["tail.added_mass=0.003", *WIND]),
    "held, to the right, smaller step": (
        "turn_held",
        ["manoeuvre.direction=right", "simulation.step=0.001"],
    ),
}


def run(scenario, lean):
    """State of the plant at every step, and every output of the contract at 100 Hz, by name of the
    port.
    """
    car = assemble(scenario, lean=lean)
    rates = {"plant_state_truth": 1.0 / scenario.simulation.step} | dict.fromkeys(
        STATION_OUTPUTS, 100.0
    )
    sinks = {
        name: LogVectorOutput(
            car.station.GetOutputPort(name),
            car.builder,
            publish_period=period_of(rate, Stage.RECORD),
        )
        for name, rate in rates.items()
    }
    simulator = Simulator(car.builder.Build())
    simulator.AdvanceTo(run_time(scenario))
    return {name: sink.FindLog(simulator.get_context()).data() for name, sink in sinks.items()}


@pytest.mark.slow
@pytest.mark.parametrize("case", RUNS)
def test_station_moves_alike_with_and_without_its_truth_over_a_whole_run(case):
    """With it the plant samples its output ports, and what drives it is kept by a `SampledHold`."""
    name, settings = RUNS[case]
    scenario = load_scenario(name, settings)
    expected, found = (run(scenario, lean) for lean in (False, True))
    moved = expected["plant_state_truth"]
    assert moved.shape[1] > 1300
    assert np.abs(moved - moved[:, :1]).max() > 1.0
    for port, values in expected.items():
        np.testing.assert_array_equal(found[port], values, err_msg=port)


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings", [["tail.sail=free"], ["tail.sail=locked", "tail.added_mass=0.003"]]
)
def test_air_in_wind_is_what_a_tail_force_says_at_every_state_of_a_run(settings):
    """`TailForce` asks Drake where the sail is and how it moves; what drives the plant has that in
    closed form.
    """
    car = assemble(load_scenario("turn_swing", [*settings, *WIND]))
    station = car.station
    plant = simulated_car(car.station).plant
    drives = station.GetSubsystemByName("car_drives").GetOutputPort("drives")
    reporters = [
        system
        for system in station.GetSystems()
        if system.get_name().startswith("tail_force_tail_sail")
    ]
    wrenches = [system.GetOutputPort("wrench") for system in reporters]
    chassis = plant.GetBodyByName("chassis")
    sail = plant.GetBodyByName("tail_sail")
    simulator = Simulator(car.builder.Build())
    strongest = 0.0
    context = simulator.get_mutable_context()
    for time in np.arange(0.1, 4.0, 0.02):
        simulator.AdvanceTo(time)
        told = [port.Eval(port.get_system().GetMyContextFromRoot(context)) for port in wrenches]
        (force, moment, _) = np.split(np.sum(told, axis=0), 3)
        p_WSo = told[0][6:]
        found = drives.Eval(drives.get_system().GetMyContextFromRoot(context))
        plant_context = plant.GetMyContextFromRoot(context)
        arm = p_WSo - plant.EvalBodyPoseInWorld(plant_context, chassis).translation()
        np.testing.assert_allclose(
            found[DRIVES["air_on_chassis"]],
            [*moment + np.cross(arm, force), *force],
            rtol=0.0,
            atol=1e-9,
        )
        axis = plant.EvalBodyPoseInWorld(plant_context, sail).rotation().matrix()[:, 2]
        assert found[DRIVES["air_on_joints"]][2] == pytest.approx(axis @ moment, abs=1e-9)
        strongest = max(strongest, np.linalg.norm(force))
    assert strongest > 0.5
