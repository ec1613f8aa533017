"""The drive as a Drake diagram: station with the car's interface, driver, tail controller, recorder, in real time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem

from aerodima.hardware.drive.car_guard import CarGuard, Stage
from aerodima.hardware.drive.car_interface import CarInterface
from aerodima.hardware.drive.plain_loop import PERIOD
from aerodima.hardware.drive.run_journal import LINK_COLUMNS, RunJournal
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.logs.recorder import RunRecorder
from aerodima.workbench.simulate.car_run import assemble

_STOPPING = (Stage.HOLDING, Stage.EXITING, Stage.STOPPED)


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
        if math.isnan(self._stopped) and guard.stage in _STOPPING:
            self._stopped = context.get_time()
        if guard.finished:
            return EventStatus.ReachedTermination(self._simulator.get_system(), guard.reason)
        return EventStatus.DidNothing()
