"""Which CAN adapter, and how it is opened: python-can's interfaces behind one clear error each."""

from __future__ import annotations

import errno
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import can

from aerodima.workbench.errors import HardwareError

BITRATE = 1_000_000
"""bit/s of the tail motors (manual V1.0.8)."""


@dataclass(frozen=True)
class CanSettings:
    """A CAN bus as python-can names it.

    Attributes:
        interface: `socketcan`, `slcan`, `socketcand`, `virtual` or another interface of python-can. Empty: everything
            is read from python-can's own configuration file and environment, section `channel`.
        channel: `can0`, `/dev/ttyACM0`, ...
        bitrate: bit/s; for the interfaces that set it themselves (socketcan does not: `ip link` does).
        options: further arguments of the interface, such as `host` and `port` of socketcand.
    """

    interface: str
    channel: str
    bitrate: int = BITRATE
    options: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"CAN {self.interface or 'configuration'}:{self.channel}"


def open_bus(settings: CanSettings) -> can.BusABC:
    """Opens the adapter. Never configures a network interface and never asks for rights.

    Raises:
        HardwareError: unknown interface, missing device, missing permission, interface down, server not reached.
    """
    if not settings.interface:
        return _open(settings, {"config_context": settings.channel or None})
    if settings.interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise HardwareError(f"CAN interface {settings.interface!r} is unknown; allowed: {known}")
    arguments: dict[str, Any] = {
        "interface": settings.interface,
        "channel": settings.channel,
        "ignore_config": True,
        **settings.options,
    }
    if settings.interface == "socketcand":
        _reach(settings)
    elif settings.interface not in ("socketcan", "virtual"):
        arguments.setdefault("bitrate", settings.bitrate)
    return _open(settings, arguments)


def _open(settings: CanSettings, arguments: dict[str, Any]) -> can.BusABC:
    try:
        return can.Bus(**arguments)
    except can.CanInterfaceNotImplementedError as error:
        raise HardwareError(f"{settings}: this computer has no driver for it: {error}") from None
    except (can.CanError, OSError, ValueError, TypeError) as error:
        raise HardwareError(f"{settings}: cannot be opened: {_reason(error)}") from None


def _reach(settings: CanSettings) -> None:
    """One attempt with a time limit: python-can would retry for ten seconds at full CPU load."""
    host, port = settings.options.get("host"), settings.options.get("port")
    if not isinstance(host, str) or not isinstance(port, int):
        raise HardwareError(f"{settings}: needs the options host (text) and port (number)")
    try:
        socket.create_connection((host, port), timeout=2.0).close()
    except OSError as error:
        raise HardwareError(f"{settings}: no socketcand at {host}:{port}: {error}") from None


def _reason(error: BaseException) -> str:
    """What went wrong and what a user can do, from the first system error in the chain."""
    root: BaseException | None = error
    while root is not None and getattr(root, "errno", None) is None:
        root = root.__cause__ or root.__context__
    number = getattr(root, "errno", None)
    if number in (errno.EACCES, errno.EPERM):
        return "permission denied; is the user in the group that owns the device (often dialout)?"
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return "there is no such device; is the adapter plugged in, and the interface up?"
    if number == errno.EBUSY:
        return "another program uses it"
    return " ".join(str(root or error).split())
