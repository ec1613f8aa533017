"""`aerodima fit ...`: from logs and tables to coefficients with intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from aerodima.workbench.cli.options import COEFFICIENTS, Anew, Workers, grouped

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


LossOption = Annotated[str, typer.Option(help="squares, or huber: samples that lie far off are held back.")]


@dataclass(frozen=True)
class RigFitOptions(BatchOptions):
    """On which rig the logs were made, and what of it is an unknown."""

    rig: Annotated[
        str, typer.Option(help="Rig scenario the logs were made on: name or YAML file; default: the log's own.")
    ] = ""
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="section.key=value of the rig, over --rig; may be repeated.")
    ] = None
    free: Annotated[
        str, typer.Option(help="Constants and instrument errors that are unknowns: encoder_zero,current_delay, ...")
    ] = ""


@dataclass(frozen=True)
class SwingFitOptions(RigFitOptions):
    """Of the fits to swings."""

    loss: LossOption = "squares"
    bound: Annotated[
        list[str] | None, typer.Option("--bound", help="name=lowest,highest of a parameter; may be repeated.")
    ] = None


def register(app: typer.Typer) -> None:
    """Adds the group `fit`."""
    group = typer.Typer(no_args_is_help=True, help="Fit coefficients to logs and tables.")
    group.callback()(_group)
    group.command()(static)
    group.command()(friction)
    group.command("added-mass")(added_mass)
    group.command("robot-tail")(robot_tail)
    group.command()(published)
    app.add_typer(group, name="fit", rich_help_panel=COEFFICIENTS)


def _group() -> None:
    """Fit coefficients to logs and tables: value, 95 % interval, what the data do not determine."""


@grouped
def static(
    batch: RigFitOptions,
    bounds: Annotated[str, typer.Option(help="wide, or printed (Tables 4.10 and 10.1-10.5).")] = "wide",
    freeze: Annotated[list[str] | None, typer.Option(help="cd, cl, psi3 or current keeps its published seed.")] = None,
    rest: Annotated[tuple[float, float] | None, typer.Option(help="Start and end of the rest (wind off), s.")] = None,
    seeds: Annotated[int, typer.Option(help="Random starts beside the published seed.", min=0, max=1000)] = 0,
    drift: Annotated[str, typer.Option(help="Of the force sensor: linear, quadratic or exponential.")] = "linear",
    loss: Annotated[str, typer.Option(help="For the samples: squares, huber, or bisquare (bursts).")] = "squares",
) -> None:
    """C_D, C_L, psi3 and holding current of static holds.

    Drift and step of the readings go through all samples of rest and hold, by the loss; the hold is then fitted to
    seven means.

    Example: aerodima fit static logs/*.parquet --out fits --set maxon.torque_constant=0.40
    """
    from aerodima.optimisation.identify.hold_mean import DRIFTS, HOLD_LOSSES
    from aerodima.optimisation.identify.static_fit import UNITS, fit_static_log

    for name in freeze or []:
        choice("--freeze", name, tuple(UNITS))
    chosen: Any = choice("--bounds", bounds, ("wide", "printed"))
    drifts: Any = choice("--drift", drift, DRIFTS)
    hold_loss: Any = choice("--loss", loss, HOLD_LOSSES)
    options, more = _options(batch, ["static"], drift=drifts, hold_loss=hold_loss)
    settings = {"fit": "static", "bounds": bounds, "freeze": sorted(freeze or []), "seeds": seeds, "rest": rest}
    settings |= {key: value for key, value in more.items() if key not in ("loss", "bound")}
    work = partial(
        fit_static_log, bounds=chosen, frozen=tuple(freeze or ()), random_seeds=seeds, rest=rest, options=options
    )
    fit_batch("Static fits", work, batch, settings, static_tables)


@grouped
def friction(
    batch: SwingFitOptions,
    stribeck: Annotated[bool, typer.Option("--stribeck", help="Also a breakaway torque that dies out.")] = False,
) -> None:
    """Coulomb and viscous friction of bar swings, or of robot swings.

    Example: aerodima fit friction bar_*.parquet --out fits
    """
    from aerodima.optimisation.identify.swing_coefficients import fit_friction_log, friction_parameters

    options, chosen = _options(batch, ["bar_swing", "robot_swing"], batch.loss, batch.bound)
    options.require_known([p.name for p in friction_parameters(0.0, 0.0, stribeck)])
    work = partial(fit_friction_log, stribeck=stribeck, options=options)
    settings = {"fit": "friction", "stribeck": stribeck, **chosen}
    fit_batch("Friction", work, batch, settings, averages)


@grouped
def added_mass(
    batch: SwingFitOptions,
    seed: Annotated[
        list[str] | None,
        typer.Option(help="zero, potential-flow, table-4.12 (nearest wind), table-4.12-10, table-4.12-20, or kg."),
    ] = None,
    bounds: Annotated[str, typer.Option(help="wide, or printed (Table 4.12).")] = "wide",
) -> None:
    """Added mass of swings (thesis section 4.9), as a multiple of pi R^2 rho of potential flow too.

    Without --seed it starts from zero and from table-4.12.

    Example: aerodima fit added-mass flick_*.parquet --out fits
    """
    from aerodima.optimisation.identify.added_mass import BOUNDS, DEFAULT_SEEDS, fit_added_mass_log, require_seed

    seeds = tuple(dict.fromkeys(seed or DEFAULT_SEEDS))
    for name in seeds:
        require_seed(name)
    limits: Any = choice("--bounds", bounds, BOUNDS)
    options, chosen = _options(batch, ["swing"], batch.loss, batch.bound)
    options.require_known(["added_mass"])
    work = partial(fit_added_mass_log, seeds=seeds, bounds=limits, options=options)
    settings = {"fit": "added-mass", "seeds": list(seeds), "bounds": bounds, **chosen}
    title = "Added mass"
    fit_batch(title, work, batch, settings, averages)


@grouped
def robot_tail(
    batch: SwingFitOptions,
    shape: Annotated[str, typer.Option(help="C_N as constant, line or bins over the relative speed.")] = "bins",
) -> None:
    """C_N of the robot tail from its swings.

    Example: aerodima fit robot-tail swing_*.parquet --shape line --out fits
    """
    from aerodima.optimisation.identify.swing_coefficients import fit_robot_tail_log

    shaped: Any = choice("--shape", shape, ("constant", "line", "bins"))
    options, chosen = _options(batch, ["robot_swing"], batch.loss, batch.bound)
    work = partial(fit_robot_tail_log, shape=shaped, options=options)
    settings = {"fit": "robot-tail", "shape": shape, **chosen}
    fit_batch("Robot tail", work, batch, settings, robot_tables)


def _loss(name: str) -> Any:
    from aerodima.optimisation.identify.least_squares import LOSSES

    return choice("--loss", name, LOSSES)


def _options(
    batch: RigFitOptions, kinds: list[str], loss: str = "squares", bound: list[str] | None = None, **more: Any
) -> tuple[Any, dict[str, Any]]:
    """The `FitOptions` of a command for logs of some kinds, and what of them tells results apart but for defaults.

    What is wrong with rig, settings and constants is refused here, once and not for every log.
    """
    from aerodima.optimisation.identify.log_rig import FitOptions, constant_names, named_rig, require_constants

    names = tuple(dict.fromkeys(name.strip() for name in batch.free.split(",") if name.strip()))
    require_constants(names, list(dict.fromkeys(name for kind in kinds for name in constant_names(kind))))
    rig = batch.rig, tuple(batch.settings or ())
    named_rig(*rig)
    options = FitOptions(_loss(loss), bounds_of(bound), *rig, names, **more)
    told = {key: value for key, value in asdict(options).items() if value != getattr(FitOptions(), key)}
    return options, {"loss": loss, "bound": [list(entry) for entry in options.bounds], **told}


def published(
    out: Out,
    seeds: Annotated[int, typer.Option(help="Random starts for the rig constants.", min=0, max=100)] = 2,
) -> None:
    """Recompute what the published tables allow: rig constants, averages, errata.

    Example: aerodima fit published --out fits
    """
    from aerodima.optimisation.identify.fit_report import write_report
    from aerodima.optimisation.identify.published_check import check_published
    from aerodima.workbench.atomic_write import make_folder
    from aerodima.workbench.errors import FitError

    make_folder(out, FitError)
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
