"""`aerodima doctor`: what this machine has of what the workbench can use, and how to get what is missing.

Each check looks at one thing and says in a line what it found. Only what every job needs is `required`; all else names
the job that would go without it.
"""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

import typer

from aerodima.workbench.cli.options import CHECKS
from aerodima.workbench.errors import UserError
from aerodima.workbench.realtime import permitted
from aerodima.workbench.resources import models_dir


def register(app: typer.Typer) -> None:
    """Adds the command."""
    app.command(rich_help_panel=CHECKS)(doctor)


def doctor() -> None:
    """Check Python, Drake, solvers, extras, browser, CAN, serial ports and disk; says how to get what is missing."""
    from aerodima.workbench.cli.doctor_commands import examine

    findings = examine()
    for finding in findings:
        mark = "ok  " if finding.ok else ("FAIL" if finding.required else "none")
        typer.echo(f"{mark} {finding.subject + ':':<18} {finding.found}")
        if finding.remedy:
            typer.echo(f"     {'':<18} -> {finding.remedy}")
    broken = [finding.subject for finding in findings if finding.required and not finding.ok]
    if broken:
        raise UserError(f"nothing works without: {', '.join(broken)}")
    typer.echo("everything needed for simulation, fits and reports is there")


OLDEST_PYTHON = (3, 11)
OLDEST_DRAKE = (1, 51)
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox")
SMALLEST_DISK = 1e9
"""Free bytes below which logs and reports of a day's work may not fit; a turn's log has 2 MB, its replay 4 MB."""

EXTRAS = {
    "hardware": (("serial", "the Teensy and CAN adapters on serial ports"),),
    "logs": (("h5py", "MAT files of version 7.3"), ("mcap", "MCAP logs")),
    "console": (("starlette", "the operator's page"), ("uvicorn", "the operator's page")),
    "notebooks": (("nbclient", "the notebooks"),),
    "bench": (("casadi", "comparing in `make bench`"), ("mujoco", "comparing in `make bench`")),
}
"""Extra -> the modules it brings and what they are for."""

_ARPHRD_CAN = "280"
"""Type of a CAN interface in /sys/class/net/*/type (linux/if_arp.h)."""


@dataclass(frozen=True)
class Finding:
    """One line of the doctor.

    Attributes:
        subject: what was looked at.
        found: what is there, with its version or place.
        ok: whether it is as it should be.
        required: whether nothing works without it.
        remedy: how to mend it; empty when it is ok.
    """

    subject: str
    found: str
    ok: bool
    required: bool = False
    remedy: str = ""


def examine() -> list[Finding]:
    """Everything that can be looked at without changing anything; takes a second or two, for importing Drake."""
    checks: tuple[Callable[[], list[Finding]], ...] = (
        _python,
        _drake,
        _solvers,
        _models,
        _extras,
        _browser,
        _graphviz,
        _compiler,
        _can,
        _serial,
        _realtime,
        _disk,
    )
    return [finding for check in checks for finding in check()]


def _python() -> list[Finding]:
    found = ".".join(map(str, sys.version_info[:3]))
    wanted = ".".join(map(str, OLDEST_PYTHON))
    ok = sys.version_info[:2] >= OLDEST_PYTHON
    return [Finding("Python", found, ok, True, "" if ok else f"install Python {wanted} or newer")]


def _drake() -> list[Finding]:
    try:
        importlib.import_module("pydrake.all")
        found = version("drake")
    except (ImportError, PackageNotFoundError) as error:
        return [Finding("Drake", str(error), False, True, "pip install 'drake>=1.51'")]
    ok = tuple(map(int, found.split(".")[:2])) >= OLDEST_DRAKE
    return [Finding("Drake", found, ok, True, "" if ok else "pip install 'drake>=1.51'")]


def _solvers() -> list[Finding]:
    try:
        from pydrake.solvers import ClarabelSolver, IpoptSolver, SnoptSolver
    except ImportError:
        return []  # told by the check of Drake
    findings = []
    for solver, use in (
        (SnoptSolver(), "static fits, swing optimisation"),
        (IpoptSolver(), "swing optimisation, second opinion"),
        (ClarabelSolver(), "fits of swings"),
    ):
        ok = solver.available() and solver.enabled()
        name = f"solver {solver.solver_id().name()}"
        remedy = "" if ok else "use a Drake wheel from PyPI; builds of one's own may lack it"
        findings.append(Finding(name, f"for {use}" if ok else "not in this Drake", ok, False, remedy))
    return findings


def _models() -> list[Finding]:
    from aerodima.workbench.config.scenario import load_scenario

    try:
        load_scenario("turn_swing")
    except UserError as error:
        return [Finding("models", str(error), False, True, "reinstall the package")]
    return [Finding("models", str(models_dir()), True, True)]


def _extras() -> list[Finding]:
    findings = []
    for extra, modules in EXTRAS.items():
        missing = [f"{module} ({use})" for module, use in modules if find_spec(module) is None]
        remedy = f"pip install 'aerodima-workbench[{extra}]'" if missing else ""
        found = "not there: " + ", ".join(missing) if missing else "installed"
        findings.append(Finding(f"extra {extra}", found, not missing, False, remedy))
    return findings


def _browser() -> list[Finding]:
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    remedy = "" if found else "open replays on another machine, or install chromium"
    return [Finding("browser", found or "none of " + ", ".join(BROWSERS), found is not None, False, remedy)]


def _graphviz() -> list[Finding]:
    found = shutil.which("dot")
    remedy = "" if found else "install graphviz; `aerodima diagram` writes .dot files without it"
    return [Finding("graphviz", found or "no `dot` on the path", found is not None, False, remedy)]


def _compiler() -> list[Finding]:
    found = shutil.which(os.environ.get("CXX", "g++"))
    remedy = "" if found else "install g++; the emulated car compiles the Teensy's firmware with it"
    return [Finding("C++ compiler", found or "no g++ on the path", found is not None, False, remedy)]


def _can() -> list[Finding]:
    interfaces = [path.parent.name for path in Path("/sys/class/net").glob("*/type") if _is_can(path)]
    if not interfaces:
        remedy = "for a real car: docs/deployment.md; simulation and the emulated car need none"
        return [Finding("CAN interface", "none", False, False, remedy)]
    return [Finding("CAN interface", ", ".join(sorted(interfaces)), True)]


def _is_can(path: Path) -> bool:
    try:
        return path.read_text().strip() == _ARPHRD_CAN
    except OSError:
        return False


def _serial() -> list[Finding]:
    ports = sorted({*Path("/dev").glob("ttyACM*"), *Path("/dev").glob("ttyUSB*")})
    if not ports:
        return [Finding("serial ports", "none", False, False, "for a real car: plug in the Teensy")]
    closed = [str(port) for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    if closed:
        remedy = "add yourself to the group `dialout` and log in again"
        return [Finding("serial ports", "no permission for " + ", ".join(closed), False, False, remedy)]
    return [Finding("serial ports", ", ".join(map(str, ports)), True)]


def _realtime() -> list[Finding]:
    priority, memory = permitted()
    found = f"priority {'may be had' if priority else 'is not permitted'}, locked memory {'too' if memory else 'not'}"
    if not priority:
        found = found.replace(", locked memory not", ", nor locked memory").replace("memory too", "memory may be had")
    remedy = "" if priority and memory else "for a real car: `aerodima install-files FOLDER` writes the limits to set"
    return [Finding("real time", found, priority and memory, False, remedy)]


def _disk() -> list[Finding]:
    free = shutil.disk_usage(Path.cwd()).free
    ok = free >= SMALLEST_DISK
    remedy = "" if ok else f"free some: runs stop when it is full; wanted {SMALLEST_DISK / 1e9:g} GB"
    return [Finding("disk", f"{free / 1e9:.1f} GB free in {Path.cwd()}", ok, False, remedy)]
