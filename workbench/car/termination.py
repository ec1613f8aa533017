"""End of a run of the car: it has flipped, or its turn is over."""

import math
from collections.abc import Iterator
from typing import Any

from pydrake.systems.framework import (
    Context,
    Diagram,
    EventStatus,
    LeafSystem,
)

from aerodima.workbench.car.car_station import simulated_car
from aerodima.workbench.car.verdict import is_beyond_flip
from aerodima.workbench.control.manoeuvre import (
    run_time,
    turn_length,
    turn_start,
)
from aerodima.workbench.core.elementwise import rotation_rows
from aerodima.workbench.core.event_order import EVENT_OFFSET, nominal_time, row_period, step_instant
from aerodima.workbench.core.port_wiring import vector_of
from aerodima.workbench.scenario.scenario import Scenario

_TIME_MARGIN = 1e-9
"""Rounding of a time, s."""
CHECK_RATE = 50.0
"""Rate, Hz, at which a trial is checked for a certain outcome; its table ends at the row of the
flip all the same."""
STOPPED = "stopped_at_flip_s"
"""Key in `extra` of a log that ends at a flip: the time of its last row, s."""


def check_times(scenario: Scenario, first: float) -> Iterator[float]:
    """Yields the times at which a trial is checked, s, not before `first`: after the rows of the
    instant and before the plant's step.
    """
    rate = min(CHECK_RATE, scenario.simulation.log_rate)
    end = run_time(scenario)
    if first < end:
        yield from (
            time_after_rows(scenario, k / rate)
            for k in range(math.ceil(first * rate), math.ceil(end * rate))
        )


def time_after_rows(scenario: Scenario, time: float) -> float:
    """Returns the time at which the rows of an instant are written and the plant has not stepped,
    s.
    """
    instant = step_instant(time, scenario.simulation.step)
    if instant is None:
        return time * (1.0 - 0.5 * EVENT_OFFSET)
    return instant


def turn_end(scenario: Scenario) -> float:
    """Returns the time at which the wheels are straight again after the last turn, s; the end of
    the run where no schedule gives that time.
    """
    manoeuvre = scenario.manoeuvre
    if manoeuvre.kind not in ("turn", "auto_turn"):
        return run_time(scenario)
    servo = scenario.servo
    slack = 1.0 / servo.frame_rate + 1.0 / scenario.simulation.log_rate + _TIME_MARGIN
    several: dict[str, Any] = {}
    if manoeuvre.kind == "turn":
        several = {"repeats": manoeuvre.turns, "gap": manoeuvre.turn_gap}
    length: float = turn_length(
        servo.rate,
        manoeuvre.steer_angle,
        manoeuvre.turn_hold,
        manoeuvre.first_angle,
        manoeuvre.first_hold,
        **several,
    )
    return turn_start(scenario) + length + slack


class FlipWatch(LeafSystem):
    """Stops a run once the car has flipped.

    Input ports:
        plant_state: state [q; v] of the plant.

    Args:
        station: simulated station.
        rate: rate of the checks, Hz.
        stop_after: time from which a flipped car ends the run, s.
    """

    def __init__(self, station: Diagram, rate: float, stop_after: float) -> None:
        super().__init__()
        plant = simulated_car(station).plant
        self._quaternion = plant.GetBodyByName("chassis").floating_positions_start()
        self._stop_after = stop_after
        self._rate = rate
        self._flipped = False
        self.stopped: float | None = None
        self._state = self.DeclareVectorInputPort("plant_state", plant.num_multibody_states())
        self.DeclarePeriodicPublishEvent(row_period(rate, plant.time_step()), 0.0, self._update)

    def facts(self) -> dict[str, float]:
        """Returns when the watch ended the run, if it did, for `extra` of the log."""
        if self.stopped is None:
            return {}
        return {STOPPED: self.stopped}

    def _update(self, context: Context) -> EventStatus:
        state = vector_of(self._state, context)
        self._flipped = self._flipped or quaternion_flipped(
            state[self._quaternion : self._quaternion + 4].tolist()
        )
        time = nominal_time(context.get_time(), self._rate)
        if not (self._flipped and time >= self._stop_after):
            return EventStatus.Succeeded()
        self.stopped = time
        return EventStatus.ReachedTermination(self, "the car has flipped")


def quaternion_flipped(quaternion: Any) -> Any:
    """Returns whether a body of this orientation w, x, y, z has tilted beyond the angle of a flip;
    for arrays row by row.
    """
    return is_beyond_flip(rotation_rows(quaternion)[2][2])
