"""The driver as a Drake system: plays the schedule of a manoeuvre into the station."""

import math

from pydrake.systems.framework import Context, DiagramBuilder, DiscreteValues, LeafSystem, System

from aerodima.workbench.config.range_check import check_range
from aerodima.workbench.controllers.manoeuvre import DriverInput, Schedule
from aerodima.workbench.systems.discrete_vector import DiscreteVector
from aerodima.workbench.systems.event_order import Stage, declare_ticks, nominal_time, stage_before


class TurnDriver(LeafSystem):
    """Steering, throttle and announced turn of a schedule, sampled at a fixed rate and held in between.

    Drives every manoeuvre of `aerodima.workbench.controllers.manoeuvre`: the simulated turn, the car's AUTO sequence,
    straight line and slalom. Open loop: it looks at nothing but the time.

    Output ports:
        steering_angle (1): rad, positive to the left.
        throttle (1): -1 to 1.
        planned_turn (1): +1 left, -1 right, 0 none.

    Args:
        schedule: from `make_schedule(scenario)`.
        rate: Hz.
        stage: of its ticks, where it drives a simulated car (`aerodima.workbench.systems.event_order`).

    Raises:
        UserError: rate out of range.
    """

    def __init__(self, schedule: Schedule, rate: float = 100.0, stage: Stage | None = None) -> None:
        super().__init__()
        check_range("controller.rate", rate, 0.0, math.inf, "Hz", above_low=True)
        self.set_name("driver")
        self._schedule, self._rate = schedule, rate
        self._outputs = [
            DiscreteVector(self, [value], output=name)
            for name, value in zip(DriverInput._fields, schedule.at(0.0), strict=True)
        ]
        declare_ticks(self, rate, stage, self._tick)

    @classmethod
    def add_to_builder(
        cls, builder: DiagramBuilder, schedule: Schedule, rate: float = 100.0, *, station: System
    ) -> "TurnDriver":
        """Adds a driver and connects steering and throttle to the station."""
        driver = cls(schedule, rate, stage_before(station, Stage.DRIVER))
        builder.AddSystem(driver)
        for port in ("steering_angle", "throttle"):
            builder.Connect(driver.GetOutputPort(port), station.GetInputPort(port))
        return driver

    def _tick(self, context: Context, discrete_state: DiscreteValues) -> None:
        inputs = self._schedule.at(nominal_time(context.get_time(), self._rate))
        for output, value in zip(self._outputs, inputs, strict=True):
            output.write(discrete_state, [value])
