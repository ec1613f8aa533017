"""One lock per device of the car: two programs never use it at the same time.

The lock is an advisory `flock` on a file beside the system's own lock files. The kernel frees it
when the last process that has it open has died, whatever killed it. A device of this computer is
locked by the name that was given and by what that name stands for, anything else by its address.
The lock is taken before the device is opened: opening a port can stop a car that drives.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import socket
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from aerodima.hardware.transport.can_adapter import CanSettings
from aerodima.workbench.core.errors import HardwareError
from aerodima.workbench.core.file_reading import read_json

_FOLDERS = ("/run/lock", "/var/lock", tempfile.gettempdir())
_UNKNOWN_WAIT = 1.0
"""Longest wait for a holder to say who it is, s."""
_POLL_PERIOD = 0.02
"""Time between two attempts to take a lock, s."""


def can_address(settings: CanSettings) -> str:
    """Returns the name by which the adapter of these settings is locked: its device, or interface
    and address.
    """
    if settings.interface == "slcan":
        return settings.channel.partition("@")[0]
    address = settings.channel
    host = settings.options.get("host")
    if host is not None:
        with contextlib.suppress(OSError):
            host = socket.gethostbyname(str(host))
        address = f"{host}:{settings.options.get('port', '')}:{address}"
    return f"{settings.interface}:{address}"


def lock_devices(devices: Iterable[str], holder: str) -> contextlib.ExitStack:
    """Takes the locks of devices, all or none; they are held until the stack is closed or this
    process dies.

    Args:
        devices: paths and addresses, as the ports file names them.
        holder: description of this program, for whoever is refused.

    Raises:
        HardwareError: another program has one of them; names device, program and process.
    """
    note = json.dumps(
        {"holder": holder, "pid": os.getpid(), "since": time.strftime("%Y-%m-%d %H:%M:%S")}
    ).encode()
    named = {name: device for device in devices for name in _names(device)}
    try:
        with contextlib.ExitStack() as locks:
            files = []
            for name in sorted(named):
                files.append(_take(_lock_file(name), named[name]))
                locks.callback(os.close, files[-1])
            for file in files:
                os.ftruncate(file, 0)
                os.pwrite(file, note, 0)
                locks.callback(os.ftruncate, file, 0)
            return locks.pop_all()
    except OSError as error:
        raise HardwareError(
            f"the locks of {', '.join(named.values())} cannot be taken: {error.strerror}"
        ) from None


def _names(device: str) -> set[str]:
    """Returns the names by which a device is known.

    A pseudo-terminal's number is soon given to another one: only its name counts.
    """
    if not device.startswith(("/", ".")) and not os.path.exists(device):
        return {device}
    named = os.path.join(os.path.realpath(os.path.dirname(device)), os.path.basename(device))
    real = os.path.realpath(device)
    if real.startswith("/dev/pts/"):
        return {named}
    return {named, real}


def _lock_file(name: str) -> Path:
    above = next(Path(place) for place in _FOLDERS if os.access(place, os.W_OK | os.X_OK))
    folder = above / "aerodima"
    with contextlib.suppress(FileExistsError):
        folder.mkdir()
        folder.chmod(0o1777)  # for every user of this computer
    digest = hashlib.sha256(name.encode()).hexdigest()
    return folder / f"{os.path.basename(name)[-40:]}.{digest[:12]}"


def _open(path: Path) -> int:
    """Opens a lock file, at first without O_CREAT, which the kernel refuses for files of others in
    a folder that all may write to.
    """
    while True:
        try:
            return os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except FileNotFoundError:
            with contextlib.suppress(FileExistsError):
                file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
                os.fchmod(file, 0o666)
                return file


def _take(path: Path, device: str) -> int:
    file = _open(path)
    begin = time.monotonic()
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            holder = _holder(path)
        if holder or time.monotonic() - begin > _UNKNOWN_WAIT:
            os.close(file)
            holder = holder or "another program"
            raise HardwareError(f"{device}: is in use by {holder}; nothing was opened")
        time.sleep(_POLL_PERIOD)


def _holder(path: Path) -> str:
    """Returns the holder of a lock, in words; empty while it has not said who it is."""
    try:
        note = read_json(path, HardwareError)
    except HardwareError:  # not written yet
        return ""
    if isinstance(note, dict) and _lives(note.get("pid")):
        return f"{note.get('holder')} (process {note['pid']}, since {note.get('since')})"
    return ""


def _lives(process_id: object) -> bool:
    """Returns whether the process exists and is neither dead nor a zombie."""
    if not isinstance(process_id, int):
        return False
    try:
        with open(f"/proc/{process_id}/stat", encoding="utf-8", errors="replace") as file:
            return file.read().rsplit(")", 1)[-1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False
    except OSError:
        return True
