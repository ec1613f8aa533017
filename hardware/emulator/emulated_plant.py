"""The simulated car of the emulator: commands in, joints and sensors out, and a log of the truth in
the schema of a run.
"""

from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from aerodima.hardware.driving.run_journal import RunJournal
from aerodima.workbench.car.ak70 import TAIL_JOINTS
from aerodima.workbench.car.car_diagram import truth_signals
from aerodima.workbench.car.car_station import make_car_station, simulated_car
from aerodima.workbench.car.plant_ports import tail_rate_places
from aerodima.workbench.car.roll_estimator import RollEstimator
from aerodima.workbench.car.roll_filter import RollFilterSettings
from aerodima.workbench.core.array_types import FloatArray
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.recorder import RunRecorder, output_ports, recorded_columns, signals_of
from aerodima.workbench.logs.schema import run_metadata
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import CAR_PORTS, STATION_INPUTS, STATION_OUTPUTS
from aerodima.workbench.view.viewer import ChaseCamera

_PICTURE = 1.0 / 30.0
"""Time between two moves of the view's camera, s."""
_TRUTH_RATE = 100.0
"""Rate of the log of the truth, Hz, as of a drive's log; more rows would cost a fifth of a
processor."""
_INPUTS = (
    "steering_angle",
    "throttle",
    "planned_turn",
    "tail_pitch_command",
    "tail_roll_command",
    "state",
)


class EmulatedCar:
    """The station of a scenario with constant inputs that are set from outside, advanced step by
    step.

    The IMU of the car inside samples at every step: the chip of the emulated car, read at any time,
    then shows what was `imu.delay` before, as the simulated station does at the ticks of its
    controller. A real chip renews its data at `imu.rate` by its own clock, up to a period later.

    The columns of commands hold what reached the actuators: `planned_turn` and `controller_state`
    are known to the drive process only and stay 0.

    Args:
        scenario: scenario of the car.
        log: path of the Parquet file of the truth; a journal beside it grows while the emulator
            runs.
        facts: facts that go into the log's metadata under `extra`.
        meshcat: view that shows the car, followed from behind; None for no view.

    Attributes:
        has_tail: whether the car has tail motors and a sail.
    """

    def __init__(
        self,
        scenario: Scenario,
        log: Path,
        facts: Json,
        meshcat: Meshcat | None,
    ) -> None:
        builder = DiagramBuilder()
        station = make_car_station(_with_eager_imu(scenario), meshcat=meshcat)
        builder.AddSystem(station)
        self._sources: dict[str, Any] = {}
        self._values: dict[str, tuple[float, ...]] = {}
        for name in _INPUTS:
            fields = STATION_INPUTS.get(name)
            zeros = np.zeros(fields.size if fields else 1)
            source = builder.AddNamedSystem(name, ConstantVectorSource(zeros))
            self._sources[name] = source
            if fields:
                builder.Connect(source.get_output_port(), station.GetInputPort(name))
        settings = RollFilterSettings.from_scenario(scenario)
        estimator = RollEstimator.add_to_builder(builder, settings, station=station)
        sources = {name: source.get_output_port() for name, source in self._sources.items()}
        signals = signals_of(CAR_PORTS, output_ports(station, estimator) | sources)
        signals += truth_signals(station)
        metadata = run_metadata(scenario.resolved(), scenario.seed, extra=facts)
        # A disk that is asked to sync may block: the rows go to a thread.
        self._journal = RunJournal(log, recorded_columns(signals), metadata)
        RunRecorder.add_to_builder(
            builder, self._journal, signals, _TRUTH_RATE, scenario.simulation.step
        )
        self._simulator = Simulator(builder.Build())
        self._context: Any = self._simulator.get_mutable_context()
        self._simulator.Initialize()
        self._station_context: Any = station.GetMyContextFromRoot(self._context)
        read = (*STATION_OUTPUTS, "plant_state_truth")
        self._ports: dict[str, Any] = {name: station.GetOutputPort(name) for name in read}
        if meshcat is None:
            self._camera = None
        else:
            self._camera = ChaseCamera(station, meshcat)
        self._picture_due = 0.0
        self.has_tail = scenario.has_tail
        if self.has_tail:
            self._joints = _joint_places(simulated_car(station).plant)
        else:
            self._joints = []

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self._context.get_time())

    def command(self, name: str, *values: float) -> None:
        """Sets what an input port of the station gets from now on, in its units."""
        if self._values.get(name) == values:
            return
        self._values[name] = values
        source = self._sources[name]
        source.get_mutable_source_value(
            source.GetMyMutableContextFromRoot(self._context)
        ).SetFromVector(values)

    def advance(self, time: float) -> None:
        """Simulates up to `time`, s."""
        self._simulator.AdvanceTo(time)
        if self._camera is not None and time >= self._picture_due:
            self._picture_due = time + _PICTURE
            self._camera.follow(self._context)

    def joints(self) -> FloatArray:
        """Returns (4,) angles of pitch and roll (rad), then their rates (rad/s), at present."""
        return self.output("plant_state_truth")[self._joints]

    def output(self, name: str) -> FloatArray:
        """Returns the value of a vector port of the station."""
        return np.array(self._ports[name].Eval(self._station_context))

    def close(self) -> None:
        """Ends the log."""
        self._journal.close()


def _joint_places(plant: Any) -> list[int]:
    """Returns the indices of the angles, then of the rates, of pitch and roll in the plant's
    state.
    """
    angles = [plant.GetJointByName(name).position_start() for name in TAIL_JOINTS]
    return angles + tail_rate_places(plant)


def _with_eager_imu(scenario: Scenario) -> Scenario:
    """Returns the scenario with an IMU sample at every step. A sample is seen after the step that
    follows it, so the stepping itself is one step of the delay.
    """
    step = scenario.simulation.step
    imu = scenario.imu.model_copy(
        update={"rate": 1.0 / step, "delay": max(0.0, scenario.imu.delay - step)}
    )
    return scenario.model_copy(update={"imu": imu})
