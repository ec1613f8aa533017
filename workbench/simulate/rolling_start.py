"""The state of a whole run just before its turn, from which runs at another tyre friction may start: for searches.

On the straight a car whose wheels roll hardly feels how much grip there would be. A search over friction therefore
drives the straight once. What it finds is no claim: that is made by runs from rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import Context

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario
from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.errors import UserError
from aerodima.workbench.stations.outcome_record import OutcomeRecord

ALIKE = {
    "velocity_x_truth_m_per_s": 0.03,
    "velocity_y_truth_m_per_s": 0.03,
    "roll_truth_rad": 0.005,
    "pitch_truth_rad": 0.01,
    "gyro_z_truth_rad_per_s": 0.01,
}
"""Largest differences between two frictions at which the straight of one may stand for that of the other."""


@dataclass(frozen=True, eq=False)
class RollingStart:
    """Plant, sensors, servo, driver and law at an instant, and what was recorded until then.

    Attributes:
        scenario: that was driven, with the friction while rolling.
        law: of the tail, if not the scenario's.
        time: s.
        state: of the diagram, group by group.
        history: of the loggers, see `OutcomeRecord`.
        motion: columns of a run log, those of `ALIKE`, at that instant.
    """

    scenario: Scenario
    law: TailLaw | None
    time: float
    state: tuple[FloatArray, ...]
    history: tuple[tuple[FloatArray, FloatArray], ...]
    motion: dict[str, float]

    @classmethod
    def of(cls, scenario: Scenario, law: TailLaw | None, context: Context, record: OutcomeRecord) -> RollingStart:
        """Of a run that goes on in this context of its diagram."""
        assert context.num_continuous_states() == context.num_abstract_states() == 0
        groups: Any = (context.get_discrete_state(k).value().copy() for k in range(context.num_discrete_state_groups()))
        table = record.table(context, math.inf)[0]
        motion = {name: float(table[name].iloc[-1]) for name in ALIKE}
        return cls(scenario, law, context.get_time(), tuple(groups), record.history(context), motion)

    @property
    def friction(self) -> float:
        """Of the tyres while rolling."""
        return self.scenario.car.tyre_friction

    def resembles(self, other: RollingStart) -> bool:
        """Whether the car is as fast, as level and as straight as in another one."""
        return all(abs(self.motion[name] - other.motion[name]) <= apart for name, apart in ALIKE.items())

    def restore(self, scenario: Scenario, law: TailLaw | None, context: Context, record: OutcomeRecord) -> None:
        """Puts a new run where this one was.

        Raises:
            UserError: the run differs in more than the tyre friction.
        """
        rolled = scenario.varied(car={"tyre_friction": self.friction})
        if rolled.resolved() != self.scenario.resolved() or law != self.law:
            raise UserError(f"{scenario.name}: a rolling start is for runs that differ in car.tyre_friction alone")
        context.SetTime(self.time)
        for index, values in enumerate(self.state):
            state: Any = values
            context.SetDiscreteState(index, state)
        record.restore(context, self.history)
