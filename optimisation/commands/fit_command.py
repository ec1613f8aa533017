"""`aerodima fit ...`: from logs and tables to coefficients with intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from aerodima import optimisation, workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import make_folder, write_atomically
from aerodima.workbench.core.errors import FitError, UserError
from aerodima.workbench.core.file_reading import Settings

if TYPE_CHECKING:
    import pandas as pd

    from aerodima.optimisation.identify.fit_options import FitOptions, Knowledge
    from aerodima.optimisation.identify.fit_result import FitResult
    from aerodima.optimisation.identify.huber import Loss

    Extra = tuple[dict[str, pd.DataFrame], list[str]]
    """Tables by name, and a line for each that is left out."""

Out = Annotated[Path, cli.written("Folder for CSV, YAML, PNG and report.html.")]
_MOST_SHOWN = 20
"""Largest number of fits that the terminal shows."""


@dataclass(frozen=True)
class LogFit:
    """Options of a fit of logs: logs, rig, unknowns, and the folder of the results."""

    logs: Annotated[list[Path], typer.Argument(help="Logs (Parquet).")]
    out: Out
    workers: cli.Workers = 2
    force: cli.Anew = False
    rig: Annotated[
        str, cli.named("Rig of the logs, if not their own", "scenarios/rig", typer.Option)
    ] = ""
    settings: cli.RigSettings = None
    free: Annotated[
        str,
        typer.Option(
            help="Constants and instrument errors that are unknowns, such as "
            "encoder_zero,current_delay."
        ),
    ] = ""
    constants: Annotated[
        str,
        cli.chosen("Of the rig: as its section uncertainty says, or exact.", "uncertain", "exact"),
    ] = "uncertain"
    loss: Annotated[
        str, cli.chosen("huber holds back samples that lie far off.", "squares", "huber")
    ] = "squares"
    bound: Annotated[
        list[str] | None,
        typer.Option("--bound", metavar="NAME=LOW,HIGH", help="Of a parameter; may be repeated."),
    ] = None

    def options(self, *kinds: str) -> FitOptions:
        """Returns the fit options for logs of some kinds; wrong ones are refused here, once and not
        for every log.
        """
        from aerodima.optimisation.identify.log_rig import named_rig
        from aerodima.optimisation.identify.rig_constants import constant_names, require_constants

        names = tuple(dict.fromkeys(name.strip() for name in self.free.split(",") if name.strip()))
        require_constants(names, {name for kind in kinds for name in constant_names(kind)})
        rig = self.rig, tuple(self.settings or ())
        named_rig(*rig)
        loss = cast("Loss", self.loss)
        known = cast("Knowledge", self.constants)
        return optimisation.FitOptions(loss, bounds_of(self.bound), *rig, names, known)

    def run(
        self,
        title: str,
        work: Callable[..., FitResult],
        options: FitOptions,
        tables: Callable[[list[FitResult], Path], Extra],
        **more: str,
    ) -> None:
        """Fits all logs, writes the report, shows a summary.

        Exit status: 3 when something was left out, 2 when every log failed.

        Args:
            title: title of the report.
            work: function that fits the log of a path, with `options` and the settings in `more`.
            options: options of all fits.
            tables: function that makes further tables, and files of a folder, from the results.
            more: settings of this fit alone.
        """
        from aerodima.optimisation.identify.fit_batch import fit_logs
        from aerodima.optimisation.identify.fit_report import write_report
        from aerodima.optimisation.identify.log_rig import named_rig
        from aerodima.workbench.batch.row_store import terminal_progress

        settings = {"fit": title, **more, **asdict(options)}
        if options.rig:  # what the file says, which may change
            settings["rig"] = named_rig(options.rig, options.settings)
        fitted = fit_logs(
            partial(work, options=options, **more),
            self.logs,
            self.out,
            settings=settings,
            workers=self.workers,
            force=self.force,
            progress=terminal_progress(),
        )
        results = fitted.results
        failed = fitted.failed
        number = len(self.logs)
        if fitted.reused:
            typer.echo(f"{fitted.reused} of {number} were fitted before")
        extra: dict[str, pd.DataFrame] = {}
        left_out: list[str] = []
        try:
            if results:
                extra, left_out = tables(results, self.out)
        except UserError as error:
            left_out = [f"tables over the logs are left out: {error}"]
        write_report(self.out, title, results, failed=failed, tables=extra, left_out=left_out)
        for name, reason in failed.items():
            typer.echo(f"error: {name}: {reason}", err=True)
        show(results)
        typer.echo(f"wrote {self.out / 'report.html'}")
        if failed:
            others = "; the others are done" if results else ""
            left_out.append(f"{len(failed)} of {number} could not be fitted{others}")
        for line in left_out:
            typer.echo(f"error: {line}", err=True)
        if left_out:
            raise typer.Exit(cli.Status.LEFT_OUT if results else cli.Status.WRONG)


def show(results: list[FitResult]) -> None:
    """Prints the first results, with their warnings."""
    for result in results[:_MOST_SHOWN]:
        values = ", ".join(
            f"{e.name} {optimisation.format_estimate(e, unit=True)}" for e in result.free
        )
        typer.echo(f"{Path(result.name).name}: {values}")
        for warning in result.warnings:
            typer.echo(f"  warning: {warning}")
    if len(results) > _MOST_SHOWN:
        warned = sum(bool(result.warnings) for result in results[_MOST_SHOWN:])
        typer.echo(
            f"... and {len(results) - _MOST_SHOWN} more in fits.csv, {warned} of them with warnings"
        )


def averages(results: list[FitResult], out: Path) -> Extra:
    """Computes all averages of every parameter over the logs."""
    from aerodima.optimisation.identify.coefficient_averages import averages_table

    return {"averages": averages_table(results)}, []


def static_tables(results: list[FitResult], out: Path) -> Extra:
    """Writes coefficient files of the tails and axes that the logs span; computes averages per
    tail, axis, angle and wind speed.
    """
    from aerodima.optimisation.identify.coefficient_averages import (
        averages_table,
        node_angle,
        static_sets,
        write_sets,
    )

    sets, left_out = static_sets(results)
    for path in write_sets(out, sets):
        typer.echo(f"wrote {path}")
    nodes = [replace(r, facts={**r.facts, "angle_deg": node_angle(r)}) for r in results]
    return {
        "averages": averages_table(nodes, ("tail", "axis", "angle_deg", "wind_speed_m_per_s"))
    }, left_out


def robot_tables(results: list[FitResult], out: Path) -> Extra:
    """Writes a coefficient file of the bins, and computes all averages."""
    from aerodima.optimisation.identify.coefficient_averages import robot_tail_set, write_sets

    bins = robot_tail_set(results)
    for path in write_sets(out, {"robot_tail_bins": bins} if bins else {}):
        typer.echo(f"wrote {path}")
    return averages(results, out)


def car_files(results: list[FitResult], out: Path, settings: Settings) -> Extra:
    """Writes each fitted car as a scenario file, and computes all averages.

    Args:
        results: results of the fits.
        out: folder of the scenario files.
        settings: overrides that the fits applied to the scenarios of the logs.
    """
    import yaml

    from aerodima.optimisation.identify.car_fit import CAR
    from aerodima.workbench.logs.schema import read_run_log

    for result in results:
        logged = read_run_log(result.name).scenario
        scenario = workbench.Scenario.from_dict(logged, result.name, settings)
        car = {e.name: e.value for e in result.estimates if e.name in CAR}
        path = out / f"{Path(result.name).stem}_car.yaml"
        text = yaml.safe_dump(scenario.varied(car=car).resolved(), sort_keys=False)
        write_atomically(path, text, True, FitError)
        typer.echo(f"wrote {path}")
    return averages(results, out)


def bounds_of(given: list[str] | None) -> tuple[tuple[str, float, float], ...]:
    """Reads `name=low,high` as name and two numbers; FitError where that cannot be read."""
    bounds = []
    for text in given or []:
        name, _, numbers = text.partition("=")
        try:
            low, high = map(float, numbers.split(","))
        except ValueError:
            raise FitError(f"--bound {text}: write it as name=lowest,highest") from None
        if not low < high:
            raise FitError(f"--bound {text}: the lowest must be below the highest")
        bounds.append((name, low, high))
    return tuple(bounds)


def register(app: typer.Typer) -> None:
    """Adds the group `fit`."""
    group = cli.command_group(app, "fit", "Fit coefficients to logs and tables.", cli.COEFFICIENTS)
    for command in (static, friction, added_mass, robot_tail, car, published):
        group.command()(command)


@cli.grouped
def static(batch: LogFit) -> None:
    """Fit C_D, C_L, psi3 and holding current to static holds.

    Drift and step of the readings go through all samples of rest and hold, by the loss; the hold is
    then fitted to seven means.

    Example: aerodima fit static logs/*.parquet --out fits --set maxon.torque_constant=0.40
    """
    from aerodima.optimisation.identify.static_fit import UNKNOWNS

    options = batch.options("static")
    options.require_known(list(UNKNOWNS))
    batch.run("Static fits", optimisation.fit_static_log, options, static_tables)


@cli.grouped
def friction(batch: LogFit) -> None:
    """Fit Coulomb and viscous friction to bar or robot swings.

    Example: aerodima fit friction bar_*.parquet --out fits
    """
    from aerodima.optimisation.identify.swing_coefficients import friction_parameters

    options = batch.options("bar_swing", "robot_swing")
    options.require_known([p.name for p in friction_parameters()])
    batch.run("Friction", optimisation.fit_friction_log, options, averages)


@cli.grouped
def added_mass(batch: LogFit) -> None:
    """Fit added mass to swings (thesis section 4.9).

    It is stated as a multiple of pi R^2 rho of potential flow, too.

    Example: aerodima fit added-mass flick_*.parquet --out fits
    """
    options = batch.options("swing")
    options.require_known(["added_mass"])
    batch.run("Added mass", optimisation.fit_added_mass_log, options, averages)


@cli.grouped
def robot_tail(
    batch: LogFit,
    shape: Annotated[
        str, cli.chosen("C_N over the relative speed.", "constant", "line", "bins")
    ] = "bins",
) -> None:
    """Fit C_N of the robot tail to its swings.

    Example: aerodima fit robot-tail swing_*.parquet --shape line --out fits
    """
    options = batch.options("robot_swing")
    batch.run("Robot tail", optimisation.fit_robot_tail_log, options, robot_tables, shape=shape)


def car(
    logs: Annotated[
        list[Path],
        typer.Argument(help="Logs of drives of the car, or of its simulation (Parquet)."),
    ],
    out: Out,
    workers: cli.Workers = 2,
    force: cli.Anew = False,
    settings: cli.Settings = None,
) -> None:
    """Fit tyres, centre of mass and delay of a car to its turn.

    Friction, slip, height of the centre of mass, delay of the steering and biases. A log needs
    speed, steering command, yaw rate and lateral acceleration; what it lacks is named. The fitted
    car is written as a scenario file.

    Example: aerodima fit car run.parquet --out fits --set car.mass=6.4
    """
    from aerodima.optimisation.identify.car_fit import fit_car_log

    options = optimisation.FitOptions(settings=tuple(settings or ()))
    workbench.Scenario.from_dict({}, settings=options.settings)
    tables = partial(car_files, settings=options.settings)
    LogFit(logs, out, workers, force).run("Cars", fit_car_log, options, tables)


def published(out: Out) -> None:
    """Recompute what the published tables allow.

    Rig constants, averages, errata.

    Example: aerodima fit published --out fits
    """
    from aerodima.optimisation.identify.fit_report import write_report
    from aerodima.optimisation.identify.published_check import check_published

    make_folder(out, FitError)
    fits, tables = check_published()
    write_report(out, "Published tables", fits, tables=tables)
    for quantity, value in tables["summary"].itertuples(index=False):
        typer.echo(f"{quantity}: {value:.4g}")
    typer.echo(f"wrote {out / 'report.html'}")
