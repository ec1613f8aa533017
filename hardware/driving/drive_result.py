"""Options of a drive, and how it ended."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

HOUR = 3600.0
"""Length of the longest drive by radio, s."""


@dataclass(frozen=True)
class DriveResult:
    """End of a drive.

    Attributes:
        reason: `RUN_OVER`, or the reason why the drive was stopped.
        orderly: whether the run came to its end, or the operator ended it without an emergency and
            reported until then; False if no log was written.
        log: path of the run log, elsewhere than asked for if that place took none; None if none was
            written.
        signal: number of the signal that ended the drive; 0 for none.
        traffic_error: reason why the log of the CAN traffic is not complete; empty if it is, or if
            there is none.
        ending: account of how the tail was held and when its motors went off; empty for motors that
            were never on.
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
        log: path of the run log to write.
        force: whether to replace an existing log.
        dry_run: whether never to arm; the sequence then runs with the car switched off.
        with_drake: whether the sequence is a diagram in Drake's simulator; otherwise the plain loop
            runs it.
        confirm: function that asks somebody beside the car whether it may be armed; None arms
            without asking.
        wait_for_operator: time within which the operator must choose AUTO, MANUAL or CONTROL, out
            of IDLE, s.
        law_name: name, for the log, of a tail law that the scenario does not name; empty for one
            that it names.
    """

    log: str | Path
    force: bool = False
    dry_run: bool = False
    with_drake: bool = True
    confirm: Callable[[], bool] | None = None
    wait_for_operator: float = HOUR
    law_name: str = ""
