"""Any plant, watched: what its log holds, what reads it, and what is refused in one line."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from scipy.integrate import trapezoid

from aerodima.workbench import (
    SectionLayout,
    UserError,
    add_tail_force,
    metrics_of,
    observe,
    plant_metrics,
)
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.car.car_diagram import assemble
from aerodima.workbench.car.car_station import make_car_station
from aerodima.workbench.core.errors import LogError
from aerodima.workbench.metrics.run_summary import plant_outcome
from aerodima.workbench.scenario.scenario import load_scenario, scenario_from_dict
from aerodima.workbench.scenario.signal_table import STATION_INPUTS
from aerodima.workbench.view.logged_run import add_logged_run
from aerodima.workbench.view.run_figures import plot_overlay
from tests.refusals import assert_refused
from tests.workbench.made_up_runs import signals_equal
from tests.workbench.view.cart_poles import PLATE, add_cart_pole, observed_swing

STEPS = {"continuous": 0.0, "discrete": 0.002}


@pytest.fixture(scope="module")
def swings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swings")
    return {name: observed_swing(step, folder / f"{name}.parquet") for name, step in STEPS.items()}


@pytest.mark.parametrize("name", STEPS)
def test_log_has_a_row_per_period_and_the_state_of_its_instant(swings, name):
    log, plant, context = swings[name]
    assert log.time == pytest.approx(np.arange(51) / 100.0, abs=1e-12)
    last = log.table.iloc[-1]
    q = plant.GetPositions(context)
    v = plant.GetVelocities(context)
    # The row of the end stands a few nanoseconds before it.
    assert [
        last["plant_position_cart_pole_slide_x"],
        last["plant_position_cart_pole_swing_q"],
    ] == pytest.approx(q, abs=1e-7)
    assert [
        last["plant_velocity_cart_pole_slide_v"],
        last["plant_velocity_cart_pole_swing_w"],
    ] == pytest.approx(v, abs=1e-6)
    first = log.table.iloc[0]
    assert first["tilt_truth_rad"] == pytest.approx(1.0)
    assert first["plant_position_cart_pole_swing_q"] == 1.0


@pytest.mark.parametrize("name", STEPS)
def test_force_of_the_log_is_that_of_the_plate_in_its_wind(swings, name):
    """At the start only the wind blows: 1/2 rho A C_N |v_p| v_n along the normal, which is 1 rad
    from the wind.
    """
    log, *_ = swings[name]
    normal = np.array([np.cos(1.0), 0.0, -np.sin(1.0)])
    speed = 2.0 * np.cos(
        1.0
    )  # without the part along the axis; the wind lies in the plane of axis and normal
    expected = 0.5 * 1.225 * 0.12 * 1.2 * speed * speed * normal
    assert log.vector("tail_force_pole", "truth_n")[0] == pytest.approx(expected)
    assert log.vector("wind", "truth_m_per_s")[0] == pytest.approx([2.0, 0.0, 0.0])
    sections = [
        log.signal(f"tail_force_pole_section_{index}_force_n") for index in range(PLATE.number)
    ]
    assert sum(sections)[0] == pytest.approx(np.linalg.norm(expected))


def test_replay_puts_the_bodies_where_they_were(swings):
    log, plant, context = swings["continuous"]
    builder = DiagramBuilder()
    logged = add_logged_run(builder, log)
    replayed = logged.plant.CreateDefaultContext()
    logged.move(replayed, len(log.table) - 1)
    poses = [
        [p.EvalBodyPoseInWorld(c, p.GetBodyByName(body)) for body in ("cart", "pole")]
        for p, c in ((plant, context), (logged.plant, replayed))
    ]
    for before, after in zip(*poses, strict=True):
        assert after.rotation().matrix() == pytest.approx(before.rotation().matrix(), abs=1e-6)
        assert after.translation() == pytest.approx(before.translation(), abs=1e-6)


def fallen(tilt):
    """A body that holds this tilt, rad, in three rows."""
    log, *_ = observed_swing(0.01)
    table = log.table.iloc[:3].copy()
    table["tilt_truth_rad"] = tilt
    return replace(log, table=table)


def test_outcome_is_that_of_a_base_that_starts_upright():
    assert plant_outcome(fallen([0.0, 0.5, 0.1])).result == "survived"
    assert plant_outcome(fallen([0.0, 1.4, 0.1])).result == "flipped"
    upside_down = fallen([3.1, 1.4, 0.1])
    assert plant_outcome(upside_down) is None
    assert plant_metrics(upside_down)["outcome"] is None


def test_car_and_another_plant_are_told_apart(swings, tailless):
    plant = swings["continuous"][0]
    assert_refused(lambda: metrics_of(plant), LogError, "continuous.parquet")
    assert_refused(lambda: plot_overlay([tailless, plant], ["a", "b"]), LogError, plant.name)


def test_further_signals_have_columns_of_their_own():
    builder = DiagramBuilder()
    plant = add_cart_pole(builder, 0.01)
    ports = {
        "reaction_time": plant.get_state_output_port(),
        "wind_x": builder.GetSubsystemByName("wind"),
    }
    ports["wind_x"] = ports["wind_x"].GetOutputPort("wind_velocity")
    with observe(builder, plant, signals=ports, rate=50.0) as run:
        Simulator(builder.Build()).AdvanceTo(0.1)
    assert run.log.signal("wind_x_0") == pytest.approx(np.full(6, 2.0))
    assert "reaction_time_3" in run.log.table
    assert "tilt_truth_rad" not in run.log.table  # nothing floats, no base was named


def test_station_of_a_car_in_a_builder_of_ones_own_gives_the_log_of_a_car(tailed):
    scenario = scenario_from_dict(tailed.scenario)
    car = assemble(scenario)
    with observe(
        car.builder, car.station, rate=scenario.simulation.log_rate, settings=scenario
    ) as run:
        Simulator(car.builder.Build()).AdvanceTo(tailed.time[-1])
    assert run.log.kind == "car_run"
    assert signals_equal(run.log, replace(tailed, table=tailed.table))


def add_constants(builder, station):
    for name, fields in STATION_INPUTS.items():
        source = builder.AddSystem(ConstantVectorSource(np.full(fields.size, 0.1)))
        builder.Connect(source.get_output_port(), station.GetInputPort(name))


def test_controller_of_ones_own_gives_the_log_that_simulate_gives():
    short = ["manoeuvre.duration=0.1", "manoeuvre.turn_start=0.05", "manoeuvre.rolling_start=true"]
    scenario = load_scenario("turn_swing", [*short, "manoeuvre.speed=0"])
    expected = simulate(scenario, build=add_constants).table
    builder = DiagramBuilder()
    station = builder.AddSystem(make_car_station(scenario))
    add_constants(builder, station)
    with observe(builder, station, rate=scenario.simulation.log_rate, settings=scenario) as run:
        Simulator(builder.Build()).AdvanceTo(0.1)
    assert run.log.table.equals(expected)


def test_log_of_a_station_without_its_scenario_names_the_columns_that_it_leaves_out():
    builder = DiagramBuilder()
    station = builder.AddSystem(make_car_station(load_scenario("turn_swing")))
    with pytest.warns(UserWarning, match="settings= .* throttle_command, .* imu_gyro_z_rad_per_s"):
        observe(builder, station)


def test_impulse_of_the_logged_air_is_the_change_of_momentum():
    """Of a trunk in the air whose tail turns: the motor's torque is internal, only the air changes
    the momentum.
    """
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    trunk = plant.AddRigidBody("trunk", SpatialInertia.SolidBoxWithMass(2.0, 0.4, 0.2, 0.1))
    tail = plant.AddRigidBody(
        "tail", SpatialInertia.SolidBoxWithMass(0.1, 0.05, 0.01, 0.5).Shift([0.0, 0.0, -0.25])
    )
    plant.AddJoint(
        RevoluteJoint("tail_roll", trunk.body_frame(), tail.body_frame(), [1.0, 0.0, 0.0])
    )
    plant.Finalize()
    sail = SectionLayout.strip(start=0.2, length=0.3, width=0.2, normal_B=(0.0, 1.0, 0.0))
    add_tail_force(builder, plant, "tail", sail, 1.2)
    with observe(builder, plant, rate=2000.0) as run:
        simulator = Simulator(builder.Build())
        simulator.get_mutable_integrator().set_target_accuracy(1e-7)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        plant.GetJointByName("tail_roll").set_angular_rate(context, 20.0)
        before = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs()
        simulator.AdvanceTo(0.2)
    change = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3)).get_coeffs() - before
    columns = [("tail_force_tail_moment", "truth_n_m"), ("tail_force_tail", "truth_n")]
    impulse = np.hstack(
        [trapezoid(run.log.vector(*names), run.log.time, axis=0) for names in columns]
    )
    assert np.linalg.norm(change[:3]) > 0.05
    # The trapezium rule at 0.5 ms on forces that change within 50 ms errs by some 1e-5 of them.
    assert impulse == pytest.approx(change, abs=2e-5)


def cart_pole():
    builder = DiagramBuilder()
    return builder, add_cart_pole(builder, 0.01)


def test_existing_log_is_refused_before_the_run(tmp_path):
    path = tmp_path / "run.parquet"
    path.touch()
    assert_refused(lambda: observe(*cart_pole(), log=path), UserError, "run.parquet")
    assert list(tmp_path.iterdir()) == [path]


def test_run_outside_the_block_is_refused():
    builder, plant = cart_pole()
    run = observe(builder, plant)
    assert_refused(Simulator(builder.Build()).Initialize, UserError, "observe", "with")
    assert_refused(lambda: run.log, UserError, "with")


def test_run_that_dies_leaves_a_journal(tmp_path):
    builder, plant = cart_pole()
    run = observe(builder, plant, log=tmp_path / "run.parquet")

    def interrupted():
        with run:
            Simulator(builder.Build()).AdvanceTo(0.1)
            raise RuntimeError("out of patience")

    with pytest.raises(RuntimeError, match="out of patience"):
        interrupted()
    assert [file.name for file in tmp_path.iterdir()] == ["run.parquet.journal"]
    assert_refused(lambda: run.log, UserError, "with")


def not_in_the_builder():
    observe(DiagramBuilder(), cart_pole()[1])


def abstract_signal():
    builder, plant = cart_pole()
    observe(builder, plant, signals={"poses": plant.get_body_poses_output_port()})


def signal_of_another_diagram():
    observe(*cart_pole(), signals={"state": cart_pole()[1].get_state_output_port()})


def signal_called_time():
    builder, plant = cart_pole()
    port = builder.AddSystem(ConstantVectorSource([1.0])).get_output_port()
    observe(builder, plant, signals={"time_s": port})


def observed_twice():
    builder, plant = cart_pole()
    observe(builder, plant)
    observe(builder, plant)


def not_finalised():
    builder = DiagramBuilder()
    observe(builder, builder.AddSystem(MultibodyPlant(0.01)))


@pytest.mark.parametrize(
    ("work", "named"),
    [
        (lambda: observe(*cart_pole(), base="chassis"), ["'chassis'", "world", "cart", "pole"]),
        (lambda: observe(*cart_pole(), rate=0.0), ["rate", "0"]),
        (lambda: observe(*cart_pole(), rate=float("nan")), ["rate", "nan"]),
        (lambda: observe(*cart_pole(), air_scale=-1.0), ["air_scale", "-1"]),
        (lambda: observe(*cart_pole(), settings={"width_m": np.zeros(2)}), ["JSON"]),
        (lambda: observe(*cart_pole(), settings={"tail": 5}), ["tail", "5"]),
        (not_in_the_builder, ["builder"]),
        (abstract_signal, ["'poses'", "'body_poses'"]),
        (signal_of_another_diagram, ["'state'"]),
        (signal_called_time, ["time_s"]),
        (observed_twice, ["observed"]),
        (not_finalised, ["finalised"]),
    ],
)
def test_what_cannot_be_observed_is_named(work, named):
    assert_refused(work, UserError, *named)


def test_plant_without_shapes_is_logged_and_not_replayed():
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.01))
    plant.AddRigidBody("brick", SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.1, 0.1))
    plant.Finalize()
    with observe(builder, plant) as run:
        Simulator(builder.Build()).AdvanceTo(0.1)
    assert run.log.vector("com", "truth_m")[-1, 2] == pytest.approx(
        -0.5 * 9.81 * 0.1**2, rel=0.11
    )  # one Euler step
    assert_refused(lambda: add_logged_run(DiagramBuilder(), run.log), LogError, run.log.name)


def test_log_whose_shapes_were_damaged_is_refused(swings):
    log, *_ = swings["discrete"]
    whole = log.extra
    damaged = [
        replace(log, extra={**whole, "scene": [entry]})
        for entry in ({"body": "pole"}, {**whole["scene"][0], "kind": "torus"}, "box")
    ]
    for run in damaged:
        work = partial(add_logged_run, DiagramBuilder(), run)
        assert_refused(work, LogError, "discrete.parquet")
    cut = replace(log, table=log.table.drop(columns="pose_pole_qw"))
    assert_refused(lambda: add_logged_run(DiagramBuilder(), cut), LogError, "pose_pole_qw")
