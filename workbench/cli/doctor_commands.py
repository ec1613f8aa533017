"""`aerodima doctor`: checks of this machine, and how to get what is missing.

Each check prints a line with what it found. Only what every job needs is `required`; every
other check names the job that needs what it looks for.
"""

import importlib
import os
import platform
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from glob import glob
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import typer

from aerodima import workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.extras import install_command, packages_of_extras
from aerodima.workbench.core.realtime import permitted
from aerodima.workbench.core.resources import models_dir

MIN_DRAKE = (1, 51)
"""Oldest version of Drake that the workbench runs on."""
MIN_DISK = 1e9
"""Free bytes below which logs and reports of a day's work may not fit; a turn's log has 2 MB, its
replay 4 MB."""
USES_OF_EXTRAS = {
    "calibration": "`aerodima calibrate`",
    "console": "the operator's page",
    "hardware": "the real car and the emulated one",
    "logs": "MAT files of version 7.3, MCAP logs and their scene, bags of ROS",
    "notebooks": "the notebooks",
    "search": "compiled steps of reduced cars, 80 times faster",
    "video": "MP4 videos",
}
"""Jobs or files that need each extra."""
PROGRAMS = {
    "browser": (
        ("chromium", "chromium-browser", "google-chrome", "firefox"),
        "install chromium, or replay elsewhere",
    ),
    "graphviz": (("dot",), "install graphviz; block diagrams of notebooks are text without it"),
    "C++ compiler": (
        (os.environ.get("CXX", "g++"),),
        "install g++, which compiles the firmware of the emulated car",
    ),
}
"""Programs of which each subject needs one, and the advice if there is none."""
_ARPHRD_CAN = "280"
"""Type of a CAN interface in /sys/class/net/*/type (linux/if_arp.h)."""


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command(rich_help_panel=cli.CHECKS)(doctor)


def doctor() -> None:
    """Check what this machine has, and say how to get the rest.

    Python, Drake, solvers, extras, browser, CAN, serial ports and disk. Exits with 1 when a
    required one is missing.

    Example: aerodima doctor
    """
    findings = examine()
    for finding in findings:
        mark = "ok" if finding.ok else "FAIL" if finding.required else "none"
        typer.echo(f"{mark:<4} {finding.subject + ':':<18} {finding.found}")
        if finding.advice and not finding.ok:
            typer.echo(f"     {'':<18} -> {finding.advice}")
    broken = [finding.subject for finding in findings if finding.required and not finding.ok]
    if broken:
        typer.echo(f"nothing works without: {', '.join(broken)}", err=True)
        raise typer.Exit(cli.Status.NO)
    typer.echo("everything needed for simulation, fits and reports is there")


@dataclass(frozen=True)
class Finding:
    """One line of the doctor.

    Attributes:
        subject: what was checked.
        found: what is there, with its version or place.
        ok: whether it is as it should be.
        advice: how to fix it when it is not.
        required: whether nothing works without it.
    """

    subject: str
    found: str
    ok: bool
    advice: str = ""
    required: bool = False


def examine() -> list[Finding]:
    """Examine what can be seen without changing anything; importing Drake takes a second or two."""
    return [
        Finding("Python", platform.python_version(), True),
        _drake(),
        *_solvers(),
        _models(),
        *_extras(),
        *_programs(),
        _can(),
        _serial(),
        _realtime(),
        _disk(),
    ]


def _drake() -> Finding:
    try:
        importlib.import_module("pydrake.all")
        found = version("drake")
        ok = tuple(map(int, found.split(".")[:2])) >= MIN_DRAKE
    except (ImportError, PackageNotFoundError) as error:
        found = str(error)
        ok = False
    return Finding("Drake", found, ok, "pip install 'drake>=1.51'", True)


def _solvers() -> Iterator[Finding]:
    try:
        from pydrake.solvers import ClarabelSolver, IpoptSolver, SnoptSolver
    except ImportError:
        return  # reported by the check of Drake
    for solver, use in (
        (SnoptSolver(), "static fits, swing optimisation"),
        (IpoptSolver(), "swing optimisation, second opinion"),
        (ClarabelSolver(), "fits of swings"),
    ):
        ok = solver.available() and solver.enabled()
        found = f"for {use}" if ok else "not in this Drake"
        advice = "use a Drake wheel from PyPI; builds of one's own may lack it"
        yield Finding(f"solver {solver.solver_id().name()}", found, ok, advice)


def _models() -> Finding:
    try:
        workbench.load_scenario("turn_swing")
        return Finding("models", str(models_dir()), True)
    except UserError as error:
        return Finding("models", str(error), False, "reinstall the package", True)


def _extras() -> Iterator[Finding]:
    for extra, packages in packages_of_extras().items():
        missing = "".join(f"; no {package}" for package in packages if not _is_installed(package))
        found = f"for {USES_OF_EXTRAS.get(extra, 'other versions')}{missing}"
        yield Finding(f"extra {extra}", found, not missing, install_command(extra))


def _is_installed(package: str) -> bool:
    try:
        return bool(version(package))
    except PackageNotFoundError:
        return False


def _programs() -> Iterator[Finding]:
    for subject, (names, advice) in PROGRAMS.items():
        paths = [path for path in map(shutil.which, names) if path is not None]
        found = paths[0] if paths else f"no {' or '.join(names)} on the path"
        yield Finding(subject, found, bool(paths), advice)


def _can() -> Finding:
    types = sorted(Path("/sys/class/net").glob("*/type"))
    interfaces = [path.parent.name for path in types if path.read_text().strip() == _ARPHRD_CAN]
    return Finding(
        "CAN interface",
        ", ".join(interfaces) or "none",
        bool(interfaces),
        "for a real car: docs/deployment.md; simulation and the emulated car need none",
    )


def _serial() -> Finding:
    ports = [*glob("/dev/ttyACM*"), *glob("/dev/ttyUSB*")]
    closed = [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    found = ", ".join(ports) or "none"
    if closed:
        found = f"no permission for {', '.join(closed)}"
    return Finding(
        "serial ports",
        found,
        bool(ports) and not closed,
        "for a real car: plug in the Teensy; add yourself to the group `dialout` and log in again",
    )


def _realtime() -> Finding:
    rights = zip(("priority", "locked memory"), permitted(), strict=True)
    refused = [name for name, is_permitted in rights if not is_permitted]
    return Finding(
        "real time",
        f"not permitted: {', '.join(refused)}" if refused else "permitted",
        not refused,
        "for a real car: hardware/deploy/95-aerodima.conf has the limits to set",
    )


def _disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free
    return Finding(
        "disk",
        f"{free / 1e9:.1f} GB free in {Path.cwd()}",
        free >= MIN_DISK,
        f"free some: runs stop when it is full; wanted {MIN_DISK / 1e9:g} GB",
    )
