"""Options of a drive, and how it ended."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

HOUR = 3600.0
"""s; the longest drive by radio."""


@dataclass(frozen=True)
class DriveResult:
    """End of a drive.

    Attributes:
        reason: `RUN_OVER`, or why it was stopped.
        orderly: the run came to its end, or the operator ended it without an emergency and reported
            until then.
        log: the run log, elsewhere than was asked for when that place took none; None when none was
            written.
        signal: number of the signal that ended it; 0 for none.
        traffic_error: why the log of the CAN traffic is not whole; empty if it is, or if there is
            none.
        ending: how the tail was held and when its motors went off; empty for motors that were
            never on.
    """

    reason: str
    orderly: bool
    log: Path | None
    signal: int = 0
    traffic_error: str = ""
    ending: str = ""


@dataclass(frozen=True)
class DriveOptions:
    """Options of a drive.

    Attributes:
        log: the run log to be written.
        force: replace it.
        dry_run: never arm; the sequence runs with the car switched off.
        with_drake: the diagram in Drake's simulator, otherwise the plain loop.
        confirm: asks somebody beside the car whether it may be armed; None arms without asking.
        wait_for_operator: s until the operator must have chosen AUTO or MANUAL, out of IDLE.
        law_name: for the log, of a tail law that the scenario does not name; empty for one that it
            names.
    """

    log: str | Path
    force: bool = False
    dry_run: bool = False
    with_drake: bool = True
    confirm: Callable[[], bool] | None = None
    wait_for_operator: float = HOUR
    law_name: str = ""
