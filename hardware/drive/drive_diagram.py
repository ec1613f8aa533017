"""The real car as a Drake system with the ports of the station, and a pilot whose driver and tail law are systems."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem, State

from aerodima.hardware.car.wiring import CarCommand, CarReading
from aerodima.hardware.drive.car_guard import CarGuard
from aerodima.hardware.drive.plain_loop import PERIOD, WRITE_DELAY, Pilot, PilotStep
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.config.signal_table import STATION_INPUTS, STATION_OUTPUTS
from aerodima.workbench.controllers.tail_law import TailLaw
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

    def __init__(self, guard: CarGuard | DiagramPilot) -> None:
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
        self._guard.write(self.command(context), time.monotonic())
        return EventStatus.Succeeded()

    def command(self, context: Context) -> CarCommand:
        """What stands on the input ports."""
        steering, throttle, pitch, roll = (np.array(vector_of(self._ports[name], context)) for name in STATION_INPUTS)
        return CarCommand(float(steering[0]), float(throttle[0]), pitch, roll)


class DiagramPilot(Pilot):
    """The sequence of a scenario and its tail law as the systems of a simulated run, a tick of their diagram at a time.

    Building takes a second or more, in which no loop turns: it is done before the motors are on. To the interface in
    its diagram the pilot stands where the guard of a car would.

    Attributes: reading: of the tick, as the loop has it.
    """

    def __init__(self, scenario: Scenario, law: TailLaw | None = None) -> None:
        self.reading = CarReading()
        self._interface = CarInterface(self)
        car = assemble(scenario, interface=lambda _: self._interface, tail_law=law, lean=True)
        self._ports: dict[str, Any] = {names[0]: port for port, names in car.signals}
        self._simulator = Simulator(car.builder.Build())
        self._simulator.Initialize()

    def read(self, now: float, due: float | None = None) -> CarReading:
        """The reading of the tick, to the interface."""
        del now, due
        return self.reading

    def write(self, command: CarCommand, now: float) -> None:
        """Nothing: the loop takes the command and passes it on."""

    def start(self) -> PilotStep:
        """See `Pilot`."""
        root = self._simulator.get_context()
        command = self._interface.command(self._interface.GetMyContextFromRoot(root))
        ports = (self._ports["planned_turn"], self._ports["controller_state"])
        plan, state = (port.Eval(port.get_system().GetMyContextFromRoot(root))[0] for port in ports)
        return PilotStep(command, float(plan), int(state))

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """See `Pilot`."""
        self.reading = reading
        self._simulator.AdvanceTo(time + 0.5 * PERIOD)
        return self.start()
