"""The real car as a Drake system with the ports of the station, for `make_car_station(scenario, interface=...)`."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, EventStatus, LeafSystem, State

from aerodima.hardware.car.wiring import CarCommand, CarReading
from aerodima.hardware.drive.car_guard import CarGuard
from aerodima.hardware.drive.plain_loop import PERIOD, WRITE_DELAY
from aerodima.workbench.config.signal_table import STATION_INPUTS, STATION_OUTPUTS
from aerodima.workbench.stations.car_station import InterfaceFactory
from aerodima.workbench.systems.discrete_vector import DiscreteVector


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
        values: Any = self._ports[name].Eval(context)
        return np.array(values)


def interface_to(guard: CarGuard) -> InterfaceFactory:
    """The factory that `make_car_station` and `assemble` take."""
    return lambda scenario: CarInterface(guard)
