"""The live view of a run: its Meshcat, its pace and its progress."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, EventStatus

Progress = Callable[[float, float], None]
"""Function that is called with the time of the run (s) and its length (s)."""
Check = Callable[[Context], None]
"""Function that raises when the run must not go on."""
PROGRESS_PERIOD = 0.1
"""Time of the run between two calls of the progress without a check, s."""
CHECK_PERIOD = 0.02
"""Time of the run between two calls with a check, s."""


@dataclass(frozen=True)
class LiveView:
    """Meshcat that shows the run, its pace (0 as fast as possible, 1 in real time), and the
    function that receives its progress.
    """

    meshcat: Meshcat | None = None
    real_time_rate: float = 0.0
    progress: Progress | None = None

    def run(
        self,
        simulator: Simulator,
        length: float,
        *,
        margin: float = 0.0,
        check: Check | None = None,
    ) -> None:
        """Simulates from time 0 to `length` + `margin`, s."""
        self.begin(simulator, length, check)
        simulator.AdvanceTo(length + margin)

    def begin(self, simulator: Simulator, length: float, check: Check | None = None) -> None:
        """Initialises a run of `length` s."""
        simulator.set_target_realtime_rate(self.real_time_rate)
        if self.progress is not None or check is not None:
            simulator.set_monitor(self._monitor(length, check))
        simulator.Initialize()

    def _monitor(self, length: float, check: Check | None) -> Callable[[Context], EventStatus]:
        last = -np.inf
        period = PROGRESS_PERIOD if check is None else CHECK_PERIOD

        def monitor(context: Context) -> EventStatus:
            nonlocal last
            time = context.get_time()
            if time - last >= period:
                last = time
                if check is not None:
                    check(context)
                if self.progress is not None:
                    self.progress(time, length)
            return EventStatus.DidNothing()

        return monitor
