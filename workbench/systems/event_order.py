"""In which order the parts of a simulated car act at one instant: the same at every frame, step size and rate.

Drake computes the k-th time of a periodic event as offset + k * period. Events of different periods that should meet
then miss each other by one unit in the last place, here by one side and there by the other, and with the time of two
events their order turns: a command would act on the plant's step of its own instant at one frame and on the next one
at another. So no two parts that read each other meet at all. The period of everything that stands around a discrete
plant is shorter than its rate says by a share of `LEAD` per stage: what the rate calls t happens at t (1 - n LEAD), in
the order of the stages, and the plant steps last. The share is millions of times larger than the rounding and makes
20 ns of 20 s; what a part calls its time is the nominal one, k / rate.

At time 0 all this is done by the initialisation of the simulator, sensors first.

A plant that moves continuously has no step to come before: there, and on the real car, parts of one rate act at the
same times anyway, in Drake's own order (publish, unrestricted updates, discrete updates).
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from pydrake.systems.framework import Context, Diagram, DiscreteValues, LeafSystem, System

LEAD = 1e-9
"""Share of the time by which one stage comes before the next."""


class Stage(IntEnum):
    """Who acts at one instant before the plant steps; the larger, the earlier.

    The controller does not come after the driver: it sees what the driver did one tick before, as on the car, where
    both read first and write afterwards. At one rate both act in the controller's stage: Drake computes all discrete
    updates of an instant from the state before it.
    """

    WIND = 6
    SENSOR = 5
    CONTROLLER = 4
    DRIVER = 3
    SERVO = 2
    RECORD = 1


def period_of(rate: float, stage: Stage) -> float:
    """Period (s) to declare in Drake for a part of `stage` that acts `rate` times per second before the plant steps."""
    return (1.0 - stage * LEAD) / rate


def nominal_time(time: float, rate: float) -> float:
    """The instant k / rate that an event at `time` s stands for, s."""
    return round(time * rate) / rate


def step_instant(time: float, step: float) -> float | None:
    """The instant (s) of the plant's step at `time`, with the bits that Drake computes; None between two steps.

    What publishes at the same bits shows what a row of `Stage.RECORD` would: the plant before its step.
    """
    instant = round(time / step) * step
    return instant if math.isclose(instant, time, rel_tol=LEAD) else None


def declare_ticks(
    system: LeafSystem, rate: float, stage: Stage | None, update: Callable[[Context, DiscreteValues], Any]
) -> None:
    """Declares a discrete update at 0, 1/rate, 2/rate ... s.

    Args:
        system: under construction.
        rate: Hz.
        stage: before the step of a discrete plant; None where no plant steps.
        update: called with the context and the discrete values to be set.
    """
    if stage is None:
        system.DeclarePeriodicDiscreteUpdateEvent(1.0 / rate, 0.0, update)
        return
    period = period_of(rate, stage)
    system.DeclareInitializationDiscreteUpdateEvent(update)
    system.DeclarePeriodicDiscreteUpdateEvent(period, period, update)


def stage_before(station: System, stage: Stage) -> Stage | None:
    """The stage of a part beside this station; None beside one that has no plant to come before, that of the car."""
    return stage if isinstance(station, Diagram) and station.HasSubsystemNamed("plant") else None
