"""`aerodima fit ...`: from logs and tables to coefficients with intervals."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from optimisation.fit_batch import BatchResult
    from optimisation.pipeline import FitResult

Logs = Annotated[list[Path], typer.Argument(help="Logs (Parquet), or data files.")]
Out = Annotated[Path, typer.Option(help="Folder for CSV, YAML, PNG and report.html.")]
Workers = Annotated[int, typer.Option(help="Worker processes, one BLAS thread each.")]
Force = Annotated[bool, typer.Option("--force", help="Drop earlier results in the folder.")]
Seeds = Annotated[int, typer.Option(help="Random starts beside the published seed.", min=0, max=1000)]


def register(app: typer.Typer) -> None:
    """Adds the group `fit`."""
    group = typer.Typer(no_args_is_help=True, help="Fit coefficients to logs and tables.")
    group.callback()(_group)
    group.command()(static)
    group.command()(friction)
    group.command("added-mass")(added_mass)
    group.command("robot-tail")(robot_tail)
    group.command()(springs)
    group.command()(throttle)
    group.command()(published)
    app.add_typer(group, name="fit")


def _group() -> None:
    """Fit coefficients to logs and tables: value, 95 % interval, what the data do not determine."""


def static(
    logs: Logs,
    out: Out,
    bounds: Annotated[str, typer.Option(help="wide, or printed (Tables 4.10 and 10.1-10.5).")] = "wide",
    freeze: Annotated[list[str] | None, typer.Option(help="cd, cl, psi3 or current keeps its published seed.")] = None,
    rest: Annotated[tuple[float, float] | None, typer.Option(help="Start and end of the rest (wind off), s.")] = None,
    seeds: Seeds = 0,
    workers: Workers = 2,
    force: Force = False,
) -> None:
    """C_D, C_L, psi3 and holding current of static holds.

    Example: aerodima fit static logs/*.parquet --out fits
    """
    from optimisation.identify.log_fits import fit_static_log

    chosen: Any = _choice("--bounds", bounds, ("wide", "printed"))
    settings = {"fit": "static", "bounds": bounds, "freeze": sorted(freeze or []), "seeds": seeds, "rest": rest}
    work = partial(fit_static_log, bounds=chosen, frozen=tuple(freeze or ()), random_seeds=seeds, rest=rest)
    _batch("Static fits", work, logs, out, settings, workers, force, _write_static_sets)


def friction(
    logs: Logs,
    out: Out,
    stribeck: Annotated[bool, typer.Option("--stribeck", help="Also a breakaway torque that dies out.")] = False,
    workers: Workers = 2,
    force: Force = False,
) -> None:
    """Coulomb and viscous friction of bar swings, or of robot swings.

    Example: aerodima fit friction bar_*.parquet --out fits
    """
    from optimisation.identify.log_fits import fit_friction_log

    settings = {"fit": "friction", "stribeck": stribeck}
    _batch("Friction", partial(fit_friction_log, stribeck=stribeck), logs, out, settings, workers, force, _averages)


def added_mass(logs: Logs, out: Out, workers: Workers = 2, force: Force = False) -> None:
    """Added mass of swings, and the quasi-steady model against the one with added mass: position, reactions, verdict.

    Example: aerodima fit added-mass flick_*.parquet --out fits
    """
    from optimisation.identify.log_fits import fit_added_mass_log

    settings = {"fit": "added-mass"}
    _batch("Added mass: QSS against QSS-AM", fit_added_mass_log, logs, out, settings, workers, force, _compared)


def robot_tail(
    logs: Logs,
    out: Out,
    shape: Annotated[str, typer.Option(help="C_N as constant, line or bins over the relative speed.")] = "bins",
    workers: Workers = 2,
    force: Force = False,
) -> None:
    """C_N of the robot tail from its swings.

    Example: aerodima fit robot-tail swing_*.parquet --shape line --out fits
    """
    from optimisation.identify.log_fits import fit_robot_tail_log

    chosen: Any = _choice("--shape", shape, ("constant", "line", "bins"))
    settings = {"fit": "robot-tail", "shape": shape}
    work = partial(fit_robot_tail_log, shape=chosen)
    _batch("Robot tail", work, logs, out, settings, workers, force, _write_robot_set)


def springs(logs: Logs, out: Out, workers: Workers = 1, force: Force = False) -> None:
    """Spring rates from CSV files with displacement_m and force_n.

    Example: aerodima fit springs front_tyre.csv rear_tyre.csv --out fits
    """
    from optimisation.identify.log_fits import fit_spring_file

    _batch("Spring rates", fit_spring_file, logs, out, {"fit": "springs"}, workers, force)


def throttle(
    logs: Logs,
    out: Out,
    window: Annotated[float, typer.Option(help="Length of the steady end of a part, s.", min=0.1)] = 1.0,
    drift: Annotated[float, typer.Option(help="Largest change of speed over it, of the mean.", min=0.0)] = 0.03,
) -> None:
    """Throttle to steady speed, one line through the steady parts of all drives.

    Example: aerodima fit throttle drive_1.parquet drive_2.parquet --out fits
    """
    import pandas as pd

    from optimisation.identify.throttle import SteadyRule, fit_throttle, read_drive, steady_points
    from optimisation.report import write_report
    from workbench.errors import UserError

    rule = SteadyRule(window=window, drift=drift)
    points, failed = [], {}
    for path in logs:
        try:
            found = steady_points(read_drive(path), rule, str(path))
        except UserError as error:
            failed[str(path)] = str(error)
            continue
        if not found:
            failed[str(path)] = "no steady part: no throttle was held until the speed settled"
        points += found
    _warn(failed)
    result = fit_throttle(points)
    write_report(out, "Throttle to speed", [result], failed=failed, tables={"steady_points": pd.DataFrame(points)})
    _show([result])
    _finish(out, failed, len(logs))


def published(
    out: Out,
    seeds: Annotated[int, typer.Option(help="Random starts for the rig constants.", min=0, max=100)] = 2,
) -> None:
    """Recompute what the published tables allow: rig constants, averages, errata.

    Example: aerodima fit published --out fits
    """
    from optimisation.identify.published_check import check_published
    from optimisation.report import write_report

    found = check_published(seeds)
    tables = {
        "currents_by_cell": found.constants.by_cell,
        "current_outliers": found.constants.outliers,
        "weighted_averages": found.averages,
        "static_cells": found.cells,
        "flags": found.flag_table,
    }
    write_report(
        out, "Published tables", [found.constants.fit, found.robot_tail_line], tables=tables, notes=found.notes()
    )
    for note in found.notes():
        typer.echo(note)
    typer.echo(f"wrote {out / 'report.html'}")


def _batch(
    title: str,
    work: Callable[[str], FitResult],
    logs: list[Path],
    out: Path,
    settings: dict[str, Any],
    workers: int,
    force: bool,
    tables: Callable[[list[FitResult], Path], dict[str, Any]] | None = None,
) -> BatchResult:
    """Fits all logs, writes the report, shows a summary; exit status 2 when a log failed."""
    from optimisation.fit_batch import fit_logs
    from optimisation.report import write_report

    with typer.progressbar(length=len(logs), label="fitting", file=sys.stderr) as bar:
        batch = fit_logs(
            work,
            logs,
            out,
            settings=settings,
            workers=workers,
            force=force,
            progress=lambda done, _: bar.update(done - bar.pos),
        )
    if batch.reused:
        typer.echo(f"{batch.reused} of {len(logs)} were fitted before")
    extra = tables(batch.results, out) if tables is not None and batch.results else {}
    write_report(out, title, batch.results, failed=batch.failed, tables=extra)
    _warn(batch.failed)
    _show(batch.results)
    _finish(out, batch.failed, len(logs))
    return batch


def _averages(results: list[FitResult], out: Path) -> dict[str, Any]:
    """All averages of every parameter over the logs (thesis eqs. 4.29-4.31, and robust ones)."""
    from dataclasses import asdict

    import numpy as np
    import pandas as pd

    from optimisation.identify.aggregate import aggregate

    rows = []
    for name in dict.fromkeys(e.name for result in results for e in result.free if not e.name.startswith("start_")):
        found = [(result[name].value, result.cost) for result in results if result[name].identifiable]
        if found:
            values, costs = (np.array(column) for column in zip(*found, strict=True))
            rows.append({"parameter": name, **asdict(aggregate(values, 2.0 * np.maximum(costs, 1e-12)))})
    return {"averages": pd.DataFrame(rows)}


def _compared(results: list[FitResult], out: Path) -> dict[str, Any]:
    """QSS against QSS-AM per log, and the averages per tail, axis and wind speed."""
    import pandas as pd

    table = pd.DataFrame(
        [{"log": Path(r.name).name, "added_mass_kg": r["added_mass"].value, **r.facts} for r in results]
    )
    cells = table.groupby(["tail", "axis", "wind_speed_m_per_s"])
    numbers = ["added_mass_kg", "potential_flow_kg", "angle_rms_qss_rad", "angle_rms_qss_am_rad", "most_reynolds"]
    return {"qss_against_qss_am": table, "by_wind_speed": cells[numbers].median().reset_index()}


def _write_static_sets(results: list[FitResult], out: Path) -> dict[str, Any]:
    from optimisation.identify.surfaces import static_sets, write_sets

    for path in write_sets(out, static_sets(results)):
        typer.echo(f"wrote {path}")
    return {}


def _write_robot_set(results: list[FitResult], out: Path) -> dict[str, Any]:
    from optimisation.identify.surfaces import robot_tail_set, write_sets

    found = robot_tail_set(results)
    for path in write_sets(out, {"robot_tail_bins": found} if found else {}):
        typer.echo(f"wrote {path}")
    return _averages(results, out)


_MOST_SHOWN = 20


def _show(results: list[FitResult]) -> None:
    from optimisation.report import in_words

    for result in results[:_MOST_SHOWN]:
        values = ", ".join(f"{e.name} {in_words(e)}" + (f" {e.unit}" if e.unit != "1" else "") for e in result.free)
        typer.echo(f"{Path(result.name).name}: {values}")
    if len(results) > _MOST_SHOWN:
        typer.echo(f"... and {len(results) - _MOST_SHOWN} more in fits.csv")


def _warn(failed: dict[str, str]) -> None:
    for name, reason in failed.items():
        typer.echo(f"error: {name}: {reason.removeprefix(f'{name}: ')}", err=True)


def _finish(out: Path, failed: dict[str, str], total: int) -> None:
    typer.echo(f"wrote {out / 'report.html'}")
    if failed:
        typer.echo(f"error: {len(failed)} of {total} could not be fitted; the others are done", err=True)
        raise typer.Exit(2)


def _choice(flag: str, given: str, allowed: tuple[str, ...]) -> str:
    """`given`, when it is one of the allowed words; FitError otherwise."""
    from optimisation.errors import FitError

    if given not in allowed:
        raise FitError(f"{flag} {given}: allowed: {', '.join(allowed)}")
    return given
