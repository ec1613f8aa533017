"""Drake diagrams that drive the car, a tick at a time: the sequence of a scenario, or systems
of the user.
"""

import time
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem, State

from aerodima.hardware.car.wiring import PERIOD, UNSOUND, CarCommand, CarReading
from aerodima.hardware.driving.plain_loop import WRITE_DELAY, Pilot, PilotStep
from aerodima.workbench.car.car_diagram import Build, assemble
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.port_wiring import DiscreteVector, vector_of
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import STATION_INPUTS, STATION_OUTPUTS

_WARM_UP_TICKS = 3
"""Number of ticks that are tried before the motors are on."""


class CarInterface(LeafSystem):
    """Stand-in for the plant of a simulated car: it outputs the readings and has the commands on
    its input ports.

    A reading is shown in an unrestricted update, which Drake runs before the controllers' discrete
    updates of the same instant (as the simulated sensors do): a command is made of the readings of
    its own tick. The outputs are discrete state, so evaluating them costs nothing and touches
    nothing.

    Input and output ports: exactly `STATION_INPUTS` and `STATION_OUTPUTS` of
    `aerodima.workbench.scenario.signal_table`.

    Attributes:
        reading: reading that is output from the next tick on.
    """

    def __init__(self) -> None:
        super().__init__()
        self.set_name("car_interface")
        self.reading = CarReading()
        self._ports = {
            name: self.DeclareVectorInputPort(name, fields.size)
            for name, fields in STATION_INPUTS.items()
        }
        self._values = {
            name: DiscreteVector(self, fields.zeros(), output=name)
            for name, fields in STATION_OUTPUTS.items()
        }
        self.DeclareInitializationDiscreteUpdateEvent(self._show)
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            period_sec=PERIOD, offset_sec=0.0, update=self._read
        )

    def _read(self, context: Context, state: State) -> None:
        self._show(context, state.get_mutable_discrete_state())

    def _show(self, context: Context, discrete_state: DiscreteValues) -> None:
        del context
        for name, value in self._values.items():
            value.write(discrete_state, getattr(self.reading, name))

    def command(self, context: Context) -> CarCommand:
        """Returns the command on the input ports."""
        steering, throttle, pitch, roll = (
            np.array(vector_of(self._ports[name], context)) for name in STATION_INPUTS
        )
        return CarCommand(float(steering[0]), float(throttle[0]), pitch, roll)


class DiagramPilot(Pilot):
    """A diagram around the car's ports that advances by one tick at a time, with discrete and
    continuous states.

    Building takes a second or more without a loop, so it is done before the motors are on. Commands
    are those of the instant at which they leave, `WRITE_DELAY` after the tick.

    Args:
        law: tail law in place of the scenario's.
        build: function that adds the systems that drive, in place of driver and tail law.

    Attributes:
        columns: names of what `build` exports or logs, in the order of `PilotStep.own`.
    """

    def __init__(
        self, scenario: Scenario, law: TailLaw | None = None, build: Build | None = None
    ) -> None:
        self._interface = CarInterface()
        car = assemble(
            scenario, interface=lambda _: self._interface, tail_law=law, minimal=True, build=build
        )
        self.columns = [name for _, names in car.user_signals for name in names]
        named: dict[str, Any] = {names[0]: port for port, names in car.signals}
        self._ports = [
            named["planned_turn"],
            named["controller_state"],
            *(port for port, _ in car.user_signals),
        ]
        self._diagram = car.builder.Build()
        self._simulator = Simulator(self._diagram)
        self._simulator.Initialize()

    def warm_up(self, reading: CarReading) -> float:
        """Runs the first ticks on a copy of the state, so that no tick is the very first one while
        the car drives.

        Returns:
            Time of the slowest tick except the first, s.

        Raises:
            HardwareError: a command that is not sound. Exceptions of the systems, such as for a
                port without connection, pass through.
        """
        simulator = self._simulator
        times = []
        self._simulator = Simulator(self._diagram, simulator.get_context().Clone())
        self._simulator.Initialize()
        for tick in range(_WARM_UP_TICKS):
            begin = time.monotonic()
            step = self.step(tick * PERIOD, reading)
            times.append(time.monotonic() - begin)
            if not step.command.sound:
                raise HardwareError(
                    f"the controller commands {UNSOUND} before the car is armed: {step.command}"
                )
        self._simulator = simulator
        return max(times[1:])

    def start(self) -> PilotStep:
        """Implements `Pilot`."""
        root = self._simulator.get_context()
        command = self._interface.command(self._interface.GetMyContextFromRoot(root))
        plan, state, *own = (
            port.Eval(port.get_system().GetMyContextFromRoot(root)) for port in self._ports
        )
        return PilotStep(
            command, float(plan[0]), int(state[0]), np.concatenate(own) if own else None
        )

    def step(self, time: float, reading: CarReading) -> PilotStep:
        """Implements `Pilot`."""
        self._interface.reading = reading
        self._simulator.AdvanceTo(time + WRITE_DELAY)
        return self.start()
