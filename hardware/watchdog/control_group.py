"""A control group of its own for the watchdog, below that of the service that has started the drive.

What ends the processes of one group, such as `systemd` when the drive's own is killed, then spares it. Only within our
service (hardware/commands/system_files.py), whose group is delegated to the user: elsewhere nothing is made.
"""

from __future__ import annotations

import os
from pathlib import Path

_NAME = "watchdog"


def leave_control_group(
    root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup"), asked: bool | None = None
) -> str:
    """Moves this process into the group `watchdog` below its own.

    Args:
        root: where the groups are. own: which group this process is in.
        asked: whether the service asks for it; by its environment when None.

    Returns:
        The new group; empty if it stays where it is.
    """
    if not (os.environ.get("AERODIMA_UNIT") == "1" if asked is None else asked):
        return ""
    try:
        lines = own.read_text(encoding="utf-8").splitlines()
        path = next(line.removeprefix("0::") for line in lines if line.startswith("0::"))
        group = root / path.lstrip("/") / _NAME
        group.mkdir(exist_ok=True)
        (group / "cgroup.procs").write_text(f"{os.getpid()}\n", encoding="ascii")
    except (OSError, StopIteration):
        return ""
    return str(group)
