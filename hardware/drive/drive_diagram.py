"""The real car as a Drake system with the ports of the station, and the drive as a diagram in real time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, LeafSystem, State

from aerodima.hardware.car.wiring import CarCommand, CarReading
from aerodima.hardware.drive.car_guard import CarGuard
from aerodima.hardware.drive.plain_loop import PERIOD, WRITE_DELAY
from aerodima.hardware.drive.run_journal import LINK_COLUMNS, RunJournal
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import STATION_INPUTS, STATION_OUTPUTS
from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.logs.recorder import RunRecorder
from aerodima.workbench.simulate.car_run import assemble
from aerodima.workbench.systems.system_ports import DiscreteVector, vector_of


class CarInterface(LeafSystem):
    """Reads and writes the car once per 10 ms; never waits for a device.

    It reads in an unrestricted update, which Drake runs before the controllers' discrete updates of the same instant
    (as the simulated sensors do), and writes `WRITE_DELAY` later: a command is made of the readings of its own tick.
    One update for both would cost a tick of 10 ms. The outputs are discrete state, so evaluating them costs nothing and
    touches nothing. Faults and ages are on `status`; what follows from them is the guard's (`CarGuard`), and the
    emergency stop stays there until it is reset by hand. A diagram with this system runs at real-time rate 1; every
    reading tells the guard how late it is.

    Input and output ports: exactly `STATION_INPUTS` and `STATION_OUTPUTS` of `aerodima.workbench.config.signal_table`.

    Args:
        guard: of the started wiring; a run begins with its last reading on the outputs.
    """

    def __init__(self, guard: CarGuard) -> None:
        super().__init__()
        self.set_name("car_interface")
        self._guard = guard
        self._start: float | None = None
        self._ports = {name: self.DeclareVectorInputPort(name, fields.size) for name, fields in STATION_INPUTS.items()}
        self._values = {
            name: DiscreteVector(self, np.zeros(fields.size), output=name) for name, fields in STATION_OUTPUTS.items()
        }
        self.DeclareInitializationDiscreteUpdateEvent(self._initialise)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=PERIOD, offset_sec=0.0, update=self._read)
        self.DeclarePeriodicPublishEvent(PERIOD, WRITE_DELAY, self._write)

    @property
    def start(self) -> float | None:
        """Time 0 of the run on `time.monotonic`, s; None before the first reading."""
        return self._start

    def _initialise(self, context: Context, discrete_state: DiscreteValues) -> None:
        del context
        self._show(self._guard.reading, discrete_state)

    def _read(self, context: Context, state: State) -> None:
        now = time.monotonic()
        if self._start is None:
            self._start = now - context.get_time()
        self._show(self._guard.read(now, self._start + context.get_time()), state.get_mutable_discrete_state())

    def _show(self, reading: CarReading, discrete_state: DiscreteValues) -> None:
        for name, value in self._values.items():
            value.write(discrete_state, getattr(reading, name))

    def _write(self, context: Context) -> EventStatus:
        steering, throttle, pitch, roll = (self._command(context, name) for name in STATION_INPUTS)
        self._guard.write(CarCommand(float(steering[0]), float(throttle[0]), pitch, roll), time.monotonic())
        return EventStatus.Succeeded()

    def _command(self, context: Context, name: str) -> np.ndarray:
        values = vector_of(self._ports[name], context)
        return np.array(values)


class LinkTimes(LeafSystem):
    """The columns of a drive that no station has: `LINK_COLUMNS` on one port.

    Output ports:
        links (3): s, on the clock of the run.
    """

    def __init__(self, links: Callable[[float], np.ndarray], start: Callable[[], float | None]) -> None:
        super().__init__()
        self.set_name("link_times")
        self._links, self._start = links, start
        self.DeclareVectorOutputPort("links", len(LINK_COLUMNS), self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        start = self._start()
        output.SetFromVector(self._links(time.monotonic() - context.get_time() if start is None else start))


class DiagramRun:
    """As `aerodima.hardware.drive.plain_loop.run_loop` with an `AutoPilot`, in a Drake `Simulator` at real-time rate 1.

    Building takes a second or more, in which no loop turns: it is done before the motors are on.
    """

    def __init__(
        self,
        guard: CarGuard,
        scenario: Scenario,
        journal: RunJournal,
        links: Callable[[float], np.ndarray],
        law: TailLaw | None = None,
        real_time_rate: float = 1.0,
    ) -> None:
        self._guard, self._journal = guard, journal
        self._stopped = math.nan
        interface = CarInterface(guard)
        car = assemble(scenario, interface=lambda _: interface, tail_law=law)
        times = car.builder.AddSystem(LinkTimes(links, lambda: interface.start))
        signals = [*car.signals, (times.get_output_port(), list(LINK_COLUMNS))]
        RunRecorder.add_to_builder(car.builder, journal, signals, 1.0 / PERIOD)
        self._simulator = Simulator(car.builder.Build())
        self._simulator.set_target_realtime_rate(real_time_rate)
        self._simulator.set_monitor(self._look)

    def run(self, length: float) -> float:
        """Drives for `length` s, or until the car has stopped.

        Returns:
            When the guard began to stop, s after the start; NaN if it did not.
        """
        self._simulator.Initialize()
        self._simulator.AdvanceTo(length)
        return self._stopped

    def _look(self, context: Context) -> EventStatus:
        guard = self._guard
        if self._journal.error:
            guard.stop(self._journal.error, time.monotonic())
        if math.isnan(self._stopped) and guard.stopping:
            self._stopped = context.get_time()
        if guard.finished:
            return EventStatus.ReachedTermination(self._simulator.get_system(), guard.reason)
        return EventStatus.DidNothing()
