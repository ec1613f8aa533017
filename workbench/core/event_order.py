"""Order of Drake's events: which part acts first at one instant."""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from pydrake.systems.framework import (
    Context,
    Diagram,
    DiscreteValues,
    LeafSystem,
    System,
)

EVENT_OFFSET = 1e-9
"""Fraction of the elapsed time by which one stage comes before the next."""


class EventPriority(IntEnum):
    """Priority of a part at one instant before the plant steps; the larger, the earlier.

    The controller does not come after the driver: it sees what the driver did one tick before, as
    on the car, where both read first and write afterwards. At one rate both act in the controller's
    stage: Drake computes all discrete updates of an instant from the state before it.
    """

    WIND = 5
    SENSOR = 4
    CONTROLLER = 3
    DRIVER = 2
    RECORD = 1


def period_of(rate: float, stage: EventPriority) -> float:
    """Returns the period (s) to declare in Drake for a part of `stage` that acts `rate` times per
    second before the plant steps.
    """
    return (1.0 - stage * EVENT_OFFSET) / rate


def row_period(rate: float, step: float) -> float:
    """Returns the period (s) of rows, at `rate` Hz, that show a discrete plant before its step of
    `step` s.

    Drake publishes before it updates. With a row every 1, 2, 4 ... steps, whose multiples have the
    same bits, row and step share one instant: a second instant would cost another search for the
    next event, and the inputs of the plant would be calculated twice.
    """
    steps = round(1.0 / (rate * step))
    shared = math.isclose(steps * rate * step, 1.0) and steps.bit_count() == 1
    if shared:
        return steps * step
    return period_of(rate, EventPriority.RECORD)


def nominal_time(time: float, rate: float) -> float:
    """Returns the instant k / rate that an event at `time` s stands for, s."""
    return round(time * rate) / rate


def step_instant(time: float, step: float) -> float | None:
    """Returns the instant (s) of the plant's step at `time`, with the bits that Drake computes;
    None between two steps.

    A system that publishes at exactly this instant shows what a row of `EventPriority.RECORD`
    would: the plant before its step.
    """
    instant = round(time / step) * step
    return instant if math.isclose(instant, time, rel_tol=EVENT_OFFSET) else None


def declare_ticks(
    system: LeafSystem,
    rate: float,
    stage: EventPriority | None,
    update: Callable[[Context, DiscreteValues], Any],
) -> None:
    """Declares a discrete update at 0, 1/rate, 2/rate ... s.

    Args:
        system: system under construction.
        rate: rate of the updates, Hz.
        stage: stage before the step of a discrete plant; None where no plant steps.
        update: function that is called with the context and the discrete values to be set.
    """
    if stage is None:
        system.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, update)
        return
    period = period_of(rate, stage)
    system.DeclareInitializationDiscreteUpdateEvent(update)
    system.DeclarePeriodicDiscreteUpdateEvent(period, period, update)


def priority_before(station: System, stage: EventPriority) -> EventPriority | None:
    """Returns the stage of a part beside this station; None beside a station without a plant to
    come before, that of the real car.
    """
    return stage if isinstance(station, Diagram) and station.HasSubsystemNamed("plant") else None
