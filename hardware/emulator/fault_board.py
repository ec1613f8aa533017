"""Which faults of the script are on at an instant."""

from __future__ import annotations

import math

from aerodima.hardware.emulator.event_log import EventLog
from aerodima.hardware.emulator.fault_script import Clock, Fault, FaultEntry, Script


class FaultBoard:
    """Faults by the clock of the script.

    Attributes:
        time: s on the script's clock; negative before it runs.
    """

    def __init__(self, script: Script, events: EventLog) -> None:
        self._script = script
        self._events = events
        self._begin: float | None = None
        self._met = dict.fromkeys(range(len(script.faults)), 0)
        self._on: set[int] = set()
        self.time = -math.inf

    def begin(self, clock: Clock, now: float) -> None:
        """What a clock counts from has come; starts the script if that clock is its own, for good."""
        if clock == self._script.clock and self._begin is None:
            self._begin = now
            self._events.add("script_begins", clock=clock)

    def look(self, now: float) -> None:
        """Switches faults on and off by the clock, and notes it."""
        if self._begin is None:
            return
        self.time = now - self._begin
        for index, entry in enumerate(self._script.faults):
            spent = entry.count is not None and self._met[index] >= entry.count
            on = entry.time <= self.time < entry.time + (entry.duration or math.inf) and not spent
            if on and index not in self._on:
                self._on.add(index)
                self._note("fault_on", entry)
            elif not on and index in self._on:
                self._on.remove(index)
                self._note("fault_off", entry)

    def entry(self, fault: Fault, part: str | None = None) -> FaultEntry | None:
        """The entry of a fault that is on; None while it is not."""
        for index in self._on:
            entry = self._script.faults[index]
            if entry.fault is fault and entry.part == part:
                return entry
        return None

    def meets(self, fault: Fault, part: str | None = None) -> bool:
        """Whether a fault is on; counts as one of its times."""
        for index in self._on:
            entry = self._script.faults[index]
            if entry.fault is fault and entry.part == part:
                self._met[index] += 1
                if entry.count is not None and self._met[index] >= entry.count:
                    self._on.remove(index)
                    self._note("fault_off", entry)
                return True
        return False

    def _note(self, event: str, entry: FaultEntry) -> None:
        self._events.add(event, fault=entry.fault.value, part=entry.part, script_time_s=entry.time)
