"""A diagram of one's own: simulated, refused before the motors are on, broken while it drives, on
the emulated car.
"""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

from aerodima.hardware.car.wiring import PERIOD, WIRINGS, CarReading
from aerodima.hardware.console.emulated_car import emulated_car
from aerodima.hardware.driving.drive_diagram import DiagramPilot
from aerodima.hardware.driving.drive_session import RUN_OVER, drive
from aerodima.hardware.driving.run_journal import drive_columns
from aerodima.workbench.batch.simulation import simulate
from aerodima.workbench.cli.program import build_app
from aerodima.workbench.core.errors import HardwareError, UserError
from aerodima.workbench.logs.exporters import export_log
from aerodima.workbench.logs.schema import read_run_log
from aerodima.workbench.metrics.turn_metrics import metrics_of
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.view.replay_page import write_replay_html
from tests.hardware import own_diagram
from tests.hardware.driving.fake_wiring import quick_turn
from tests.hardware.driving.test_drive_session import Drive
from tests.hardware.emulator.emulator_process import undisturbed
from tests.refusals import assert_refused

SETTINGS = [
    "drive.governor=true",
    "manoeuvre.duration=4",
    "simulation.step=0.004",
    "simulation.log_rate=250",
]
SCENARIO = load_scenario("turn_swing", SETTINGS)


@pytest.fixture(scope="module")
def simulated():
    return simulate(SCENARIO, build=own_diagram.build)


@pytest.mark.slow
def test_simulation_runs_its_discrete_and_continuous_states_and_logs_them(simulated):
    assert simulated.extra["diagram"] == "build"
    steering, turned, way = (
        simulated.signal(name) for name in ("steering_command_rad", "turned_rad", "way_m")
    )
    assert simulated.time[steering > 0.1][[0, -1]] == pytest.approx([2.0, 2.4], abs=0.02)
    felt = np.trapezoid(simulated.signal("imu_gyro_z_rad_per_s"), simulated.time)
    assert turned[-1] == pytest.approx(felt, abs=0.01)  # a sum of the samples that the rows have
    assert way[-1] == pytest.approx(
        np.trapezoid(simulated.signal("speed_m_per_s"), simulated.time), rel=0.01
    )
    lifted = simulated.signal("tail_roll_command_position_rad") + math.pi / 2
    np.testing.assert_allclose(lifted, np.clip(2.0 * turned, 0.0, 1.0), atol=1e-12)
    assert metrics_of(simulated).outcome.result == "survived"


def test_diagram_on_the_car_gives_the_commands_of_its_tick():
    pilot = DiagramPilot(quick_turn(), build=own_diagram.build)
    assert pilot.columns == own_diagram.OWN
    reading = CarReading(imu=np.array([0, 0, 0, 0, 0, 0.5, 0, 0, 0.0]), speed=np.array([2.0]))
    assert pilot.warm_up(reading) > 0.0
    steps = [pilot.step(tick * PERIOD, reading) for tick in range(211)]
    ticks, turned, rates, way = np.array([step.own for step in steps]).T
    np.testing.assert_allclose(ticks, np.arange(211) * PERIOD, atol=1e-9)
    np.testing.assert_allclose(
        turned, 0.5 * PERIOD * np.arange(1, 212), rtol=1e-9
    )  # the rehearsal left nothing
    np.testing.assert_allclose(way, 2.0 * (np.arange(211) * PERIOD + 0.001), atol=1e-6)
    assert set(rates) == {0.5}
    assert [step.command.steering_angle for step in steps[199:202]] == [0.0, 0.2, 0.2]
    assert steps[50].command.tail_roll[0] == pytest.approx(-math.pi / 2 + 2.0 * turned[50])


@pytest.mark.parametrize(
    ("function", "said"),
    [
        ("no_throttle", "throttle"),
        ("nothing", "nothing"),
    ],
)
def test_turn_refuses_what_cannot_drive(function, said):
    result = CliRunner().invoke(
        build_app(), ["run", "turn_swing", "--diagram", f"{own_diagram.__file__}:{function}"]
    )
    assert result.exit_code == 2
    assert said in result.stderr
    assert "Traceback" not in result.stderr


def test_turn_shows_the_traceback_of_a_diagram_once_and_the_reason_in_one_line(
    tmp_path, monkeypatch
):
    monkeypatch.setenv(own_diagram.BROKE_FILE, str(tmp_path / "broke"))
    result = CliRunner().invoke(
        build_app(), ["run", "turn_swing", "--diagram", f"{own_diagram.__file__}:raises"]
    )
    assert result.exit_code == 2
    assert result.stderr.count("Traceback") == 1
    assert "in _raise" in result.stderr
    assert "car_run.py" not in result.stderr
    assert "ZeroDivisionError: in my controller" in result.stderr.splitlines()[-1]


def test_column_that_is_there_already_is_refused():
    def build(builder, station):
        own_diagram.build(builder, station)
        builder.ExportOutput(station.GetOutputPort("speed"), "speed_m_per_s")

    assert_refused(lambda: simulate(SCENARIO, build=build), UserError, "speed_m_per_s")


def drive_with(bench, build):
    return bench.run_with({}, build=build)


@pytest.fixture
def bench(tmp_path, monkeypatch):
    monkeypatch.setenv(own_diagram.BROKE_FILE, str(tmp_path / "broke"))
    return Drive(tmp_path, True, "manoeuvre.log_end=2.0")


@pytest.mark.realtime
def test_drive_logs_what_the_diagram_exports_and_how_long_it_takes(bench):
    assert drive_with(bench, own_diagram.build).reason == RUN_OVER
    bench.assert_safe()
    log = read_run_log(bench.log)
    assert list(log.table.columns) == [*drive_columns(), *own_diagram.OWN]
    assert (log.extra["diagram"], log.extra["slow_ticks"]) == ("build", 0)
    assert np.all(log.signal("controller_time_s")[1:] > 0.0)
    assert log.signal("tick_s")[-1] == pytest.approx(1.99)
    assert any("diagram" in text for text in bench.said)


@pytest.mark.realtime
def test_port_without_connection_is_found_before_the_motors_are_on(bench):
    assert_refused(lambda: drive_with(bench, own_diagram.unconnected), HardwareError, "imu")
    assert not [frame for _, frame in bench.bench.port.sent if frame.data.endswith(b"\xfc")]
    assert not list(bench.log.parent.glob("run*"))


@pytest.mark.emulated
@pytest.mark.slow
@pytest.mark.parametrize("wiring", WIRINGS)
def test_same_file_drives_the_emulated_car_and_everything_reads_its_log(
    tmp_path, wiring, simulated
):
    def driven(folder):
        with emulated_car(SCENARIO, wiring, folder / "car") as car:
            result = drive(
                own_diagram.build,
                SCENARIO,
                car.ports,
                folder / "run.parquet",
                wiring=wiring,
                arm=True,
            )
            assert (result.reason, result.orderly) == (RUN_OVER, True)
            assert len(car.events("off")) >= 2
        return read_run_log(result.log)

    log = undisturbed(driven, tmp_path)
    turned, planned = (run.signal("turned_rad")[-1] for run in (log, simulated))
    assert turned == pytest.approx(planned, abs=0.15)
    assert metrics_of(log).raw.max_yaw_rate_rad_per_s > 0.2
    page = write_replay_html(log, tmp_path / "run.html")
    assert all(name in page.read_text(encoding="utf-8") for name in own_diagram.OWN)
    export_log(log, tmp_path / "run.mcap", "mcap")
