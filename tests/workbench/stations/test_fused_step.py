"""The plant that a fused step drives moves as the one that separate systems drive, and so do the sensors' readings."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import LogVectorOutput

from aerodima.workbench.config.scenario import load_scenario
from aerodima.workbench.config.signal_table import STATION_OUTPUTS
from aerodima.workbench.controllers.manoeuvre import run_time
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.stations.car_station import make_car_station, simulated_car
from aerodima.workbench.stations.step_drives import AIR_ON_CHASSIS, AIR_ON_JOINTS
from aerodima.workbench.systems.event_order import Stage, period_of

WIND = ["wind.mean_x=-1.0", "wind.mean_y=2.0", "wind.gust_amplitude=1.0", "wind.turbulence=0.5"]
RUNS = {
    "published swing": ("turn_swing", []),
    "no tail": ("turn_none", []),
    "no tail, flips": ("turn_none", ["manoeuvre.speed=3.61"]),
    "locked sail": ("turn_swing", ["tail.sail=locked"]),
    "coefficients over speed": ("turn_swing", ["tail.coefficients=robot_tail_line", "manoeuvre.duration=2.7"]),
    "free sail through the turn": ("turn_swing", ["tail.sail=free", "manoeuvre.duration=2.7"]),
    "added mass in wind": ("turn_swing", ["tail.added_mass=0.003", *WIND]),
    "held, to the right, smaller step": ("turn_held", ["manoeuvre.direction=right", "simulation.step=0.001"]),
}


def run(scenario, systems):
    """State of the plant at every step, and every output of the contract at 100 Hz, by name of the port."""
    car = assemble(scenario, systems=systems)
    rates = {"plant_state_truth": 1.0 / scenario.simulation.step} | dict.fromkeys(STATION_OUTPUTS, 100.0)
    sinks = {
        name: LogVectorOutput(
            car.station.GetOutputPort(name), car.builder, publish_period=period_of(rate, Stage.RECORD)
        )
        for name, rate in rates.items()
    }
    simulator = Simulator(car.builder.Build())
    simulator.AdvanceTo(run_time(scenario))
    return {name: sink.FindLog(simulator.get_context()).data() for name, sink in sinks.items()}


@pytest.mark.parametrize("case", RUNS)
def test_both_stations_move_alike_over_a_whole_run(case):
    name, settings = RUNS[case]
    scenario = load_scenario(name, settings)
    expected, found = (run(scenario, systems) for systems in ("separate", "fused"))
    moved = expected["plant_state_truth"]
    assert moved.shape[1] > 1300
    assert np.abs(moved - moved[:, :1]).max() > 1.0
    for port, values in expected.items():
        np.testing.assert_allclose(found[port], values, rtol=0.0, atol=1e-9, err_msg=port)


def test_air_on_a_free_sail_in_wind_is_that_of_the_separate_systems_at_every_state_of_a_run():
    """It flutters after the turn, and rounding grows a thousandfold in 0.2 s: forces are compared instead of motion."""
    scenario = load_scenario("turn_swing", ["tail.sail=free", *WIND])
    car, reference = assemble(scenario, systems="fused"), make_car_station(scenario)
    drives = car.station.GetSubsystemByName("fused_step").GetOutputPort("drives")
    moving, plant = (simulated_car(station).plant for station in (car.station, reference))
    blowing, wind = (station.GetSubsystemByName("wind") for station in (car.station, reference))
    chassis, sail = plant.GetBodyByName("chassis"), plant.GetBodyByName("tail_sail")
    wrench = reference.GetSubsystemByName("sail_wrench").get_output_port()
    simulator, root = Simulator(car.builder.Build()), reference.CreateDefaultContext()
    context, plant_context = simulator.get_mutable_context(), plant.GetMyMutableContextFromRoot(root)
    strongest = 0.0
    for time in np.arange(0.1, 4.0, 0.02):
        simulator.AdvanceTo(time)
        root.SetTime(time)
        turbulence = blowing.GetMyContextFromRoot(context).get_discrete_state_vector().value()
        wind.GetMyMutableContextFromRoot(root).SetDiscreteState(turbulence)
        state = moving.GetPositionsAndVelocities(moving.GetMyContextFromRoot(context))
        plant.SetPositionsAndVelocities(plant_context, state)
        force, moment, p_WSo = np.split(wrench.Eval(wrench.get_system().GetMyContextFromRoot(root)), 3)
        found = drives.Eval(drives.get_system().GetMyContextFromRoot(context))
        arm = p_WSo - plant.EvalBodyPoseInWorld(plant_context, chassis).translation()
        np.testing.assert_allclose(
            found[AIR_ON_CHASSIS:AIR_ON_JOINTS], [*moment + np.cross(arm, force), *force], rtol=0.0, atol=1e-9
        )
        axis = plant.EvalBodyPoseInWorld(plant_context, sail).rotation().matrix()[:, 2]
        assert found[AIR_ON_JOINTS + 2] == pytest.approx(axis @ moment, abs=1e-9)
        strongest = max(strongest, np.linalg.norm(force))
    assert strongest > 0.5


@pytest.mark.parametrize("mode", ["none", "swing"])
def test_both_stations_have_the_ports_of_the_contract(mode):
    scenario = load_scenario(f"turn_{mode}")
    stations = [make_car_station(scenario, systems=systems) for systems in ("separate", "fused")]
    inputs, outputs = (
        [{port.get_name(): port.size() for port in ports(station)} for station in stations]
        for ports in (
            lambda station: map(station.get_input_port, range(station.num_input_ports())),
            lambda station: map(station.get_output_port, range(station.num_output_ports())),
        )
    )
    assert inputs[0] == inputs[1]
    contract = [{name: size for name, size in ports.items() if not name.endswith("_truth")} for ports in outputs]
    assert contract[0] == contract[1] == {name: fields.size for name, fields in STATION_OUTPUTS.items()}
