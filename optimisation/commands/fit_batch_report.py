"""What the commands of `aerodima fit` share: a batch with its report, tables, choices, messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerodima.workbench.cli.options import Anew, Workers

if TYPE_CHECKING:
    import pandas as pd

    from aerodima.optimisation.identify.fit_batch import BatchResult
    from aerodima.optimisation.identify.fit_pipeline import FitResult

    Extra = tuple[dict[str, pd.DataFrame], list[str]]
    """Tables by name, and a line for each that is left out."""
    Tables = Callable[[list[FitResult], Path], Extra]


Logs = Annotated[list[Path], typer.Argument(help="Logs (Parquet), or data files.")]
Out = Annotated[Path, typer.Option(help="Folder for CSV, YAML, PNG and report.html.")]


@dataclass(frozen=True)
class BatchOptions:
    """Which files are fitted, and where the results go."""

    logs: Logs
    out: Out
    workers: Workers = 2
    force: Anew = False


def fit_batch(
    title: str,
    work: Callable[[str], FitResult],
    batch: BatchOptions,
    settings: dict[str, Any],
    tables: Tables | None = None,
) -> BatchResult:
    """Fits all logs, writes the report, shows a summary; exit status 2 when a log failed or something was left out.

    Args:
        tables: makes further tables of the report from the results, and says what it left out; may write files into
            the folder.
    """
    from aerodima.optimisation.identify.fit_batch import fit_logs
    from aerodima.optimisation.identify.fit_report import write_report
    from aerodima.workbench.batch.row_store import terminal

    logs, out = batch.logs, batch.out
    fitted = fit_logs(work, logs, out, settings=settings, workers=batch.workers, force=batch.force, progress=terminal())
    if fitted.reused:
        typer.echo(f"{fitted.reused} of {len(logs)} were fitted before")
    extra, left_out = _further_tables(tables, fitted.results, out)
    write_report(out, title, fitted.results, failed=fitted.failed, tables=extra, notes=left_out)
    warn(fitted.failed)
    show(fitted.results)
    finish(out, fitted.failed, len(logs), left_out)
    return fitted


def _further_tables(
    tables: Tables | None, results: list[FitResult], out: Path
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """What can be made of the results; what cannot is a line, and costs nothing else."""
    from aerodima.workbench.errors import UserError

    if tables is None or not results:
        return {}, []
    try:
        return tables(results, out)
    except UserError as error:
        return {}, [f"tables over the logs are left out: {error}"]


def averages(results: list[FitResult], out: Path) -> Extra:
    """All averages of every parameter over the logs."""
    from aerodima.optimisation.identify.coefficient_averages import averages_table

    return {"averages": averages_table(results)}, []


def static_tables(results: list[FitResult], out: Path) -> Extra:
    """Coefficient files of what the logs span, and all averages per tail, axis, angle and wind speed."""
    from dataclasses import replace

    from aerodima.optimisation.identify.coefficient_averages import averages_table, node_angle, static_sets, write_sets

    sets, left_out = static_sets(results)
    for path in write_sets(out, sets):
        typer.echo(f"wrote {path}")
    nodes = [replace(r, facts={**r.facts, "angle_deg": node_angle(r)}) for r in results]
    return {"averages": averages_table(nodes, ("tail", "axis", "angle_deg", "wind_speed_m_per_s"))}, left_out


def robot_tables(results: list[FitResult], out: Path) -> Extra:
    """A coefficient file of the bins, and all averages."""
    from aerodima.optimisation.identify.coefficient_averages import robot_tail_set, write_sets

    found = robot_tail_set(results)
    for path in write_sets(out, {"robot_tail_bins": found} if found else {}):
        typer.echo(f"wrote {path}")
    return averages(results, out)


_MOST_SHOWN = 20


def show(results: list[FitResult]) -> None:
    """The first results in words."""
    from aerodima.optimisation.identify.fit_report import format_estimate

    for result in results[:_MOST_SHOWN]:
        values = ", ".join(f"{e.name} {format_estimate(e, unit=True)}" for e in result.free)
        typer.echo(f"{Path(result.name).name}: {values}")
        for warning in result.warnings:
            typer.echo(f"  warning: {warning}")
    if len(results) > _MOST_SHOWN:
        warned = sum(bool(result.warnings) for result in results[_MOST_SHOWN:])
        told = f", {warned} of them with warnings" if warned else ""
        typer.echo(f"... and {len(results) - _MOST_SHOWN} more in fits.csv{told}")


def warn(failed: dict[str, str]) -> None:
    """One line per log that failed."""
    for name, reason in failed.items():
        typer.echo(f"error: {name}: {reason.removeprefix(f'{name}: ')}", err=True)


def finish(out: Path, failed: dict[str, str], total: int, left_out: Sequence[str] = ()) -> None:
    """Names the report; exit status 2 when a log failed or something was left out."""
    typer.echo(f"wrote {out / 'report.html'}")
    for line in left_out:
        typer.echo(f"error: {line}", err=True)
    if failed:
        others = "; the others are done" if len(failed) < total else ""
        typer.echo(f"error: {len(failed)} of {total} could not be fitted{others}", err=True)
    if failed or left_out:
        raise typer.Exit(2)


def choice(flag: str, given: str, allowed: tuple[str, ...]) -> str:
    """`given`, when it is one of the allowed words; FitError otherwise."""
    from aerodima.workbench.errors import FitError

    if given not in allowed:
        raise FitError(f"{flag} {given}: allowed: {', '.join(allowed)}")
    return given


def bounds_of(given: list[str] | None) -> tuple[tuple[str, float, float], ...]:
    """`name=low,high` as name and two numbers; FitError where that cannot be read."""
    from aerodima.workbench.errors import FitError

    found = []
    for text in given or []:
        name, _, numbers = text.partition("=")
        try:
            low, high = (float(number) for number in numbers.split(","))
        except ValueError:
            raise FitError(f"--bound {text}: write it as name=lowest,highest") from None
        if not low < high:
            raise FitError(f"--bound {text}: the lowest must be below the highest")
        found.append((name, low, high))
    return tuple(found)
