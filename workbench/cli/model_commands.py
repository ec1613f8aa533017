"""Commands of the group `models`: models, tails, coefficients and diagrams."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from aerodima import workbench
from aerodima.workbench.cli import options as cli
from aerodima.workbench.core.atomic_write import refuse_existing, write_atomically
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.text_table import shown_value, text_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from aerodima.workbench.aero.tail_geometry import TailGeometry


def register(app: typer.Typer) -> None:
    """Add the commands."""
    models = cli.command_group(
        app, "models", "Look into models, tails, coefficients and diagrams.", cli.CHECKS
    )
    for command in (check, tail, diagram, range_of_motion, export):
        models.command()(command)
    coefficients = cli.command_group(
        models, "coefficients", "Look at sets of aerodynamic coefficients."
    )
    coefficients.command("list")(list_sets)
    coefficients.command()(plot)


def check(
    files: Annotated[
        list[Path] | None,
        typer.Argument(
            help="SDF or URDF files; all that ship when left out.",
            callback=cli.endings(".sdf", ".urdf"),
        ),
    ] = None,
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="First write the numbers of models/parameters into the SDF files."
        ),
    ] = False,
) -> None:
    """Check that models are physical and name their sources.

    They load, nothing that Drake would ignore is in them, and their numbers equal the parameters.
    Exits with 1 when a check fails.

    Example: aerodima models check
    """
    from aerodima.workbench.cli.model_check import (
        check_model_file,
        check_shipped_models,
        update_model_files,
    )

    for path in files or ():
        if not path.is_file():
            raise UserError(f"{path}: no such file")
    if update:
        for path in update_model_files():
            typer.echo(f"written {path}")
    if files:
        results = [result for path in files for result in check_model_file(path)]
    else:
        results = list(check_shipped_models())
    for result in results:
        typer.echo(f"{'ok  ' if not result.problems else 'FAIL'} {result.subject}")
    problems = [problem for result in results for problem in result.problems]
    if problems:
        typer.echo(f"{len(problems)} problem(s):\n  " + "\n  ".join(problems), err=True)
        raise typer.Exit(cli.Status.NO)


def tail(
    scenario: cli.ScenarioArgument = "turn_swing",
    file: Annotated[
        Path | None, typer.Option(help="Tail file (YAML) in place of the scenario's tail.")
    ] = None,
    settings: cli.Settings = None,
    out: Annotated[
        list[Path] | None,
        cli.written(
            "Picture (.png, .svg, .pdf), or tail file (.yaml); may be repeated.",
            *cli.PICTURES,
            ".yaml",
        ),
    ] = None,
    force: cli.Force = False,
) -> None:
    """Show areas, centres, mass and inertia of a tail.

    Example: aerodima models tail --out tail.yaml --out tail.png
    """
    for path in out or ():
        refuse_existing(path, force, UserError)
    car = workbench.load_scenario(scenario, settings or [])
    geometry = workbench.read_tail(file) if file else workbench.tail_geometry(car.tail)
    for line in tail_lines(geometry):
        typer.echo(line)
    for path in out or ():
        if path.suffix.lower() == ".yaml":
            typer.echo(f"tail: {workbench.write_tail(geometry, path, force=force)}")
        else:
            _write_picture(workbench.plot_tail(geometry), path, force)


def _write_picture(figure: Figure, out: Path, force: bool) -> None:
    kind = out.suffix[1:].lower()
    write_atomically(out, lambda path: figure.savefig(path, format=kind, dpi=130), force, UserError)
    typer.echo(f"picture: {out}")


def tail_lines(geometry: TailGeometry) -> list[str]:
    """Tabulate a tail: its plates, then the whole."""
    header = ["plate", "kind", "area_cm2", "centre_of_pressure_m", "sections"]
    plates = [
        [
            p.name,
            p.kind,
            shown_value(1e4 * p.area),
            _vector(p.centre_of_pressure),
            str(p.sections * len(p.pieces)),
        ]
        for p in geometry.plates
    ]
    whole = geometry.inertial
    numbers = [
        ["arm_m", shown_value(float(sum(geometry.arm.lengths)))],
        ["arm_mass_g", shown_value(1000 * geometry.arm_mass.mass)],
        ["mass_g", shown_value(1000 * whole.mass)],
        ["centre_of_mass_m", _vector(whole.com)],
        ["inertia_about_joints_kg_m2", _vector(geometry.inertia_about_joints.diagonal())],
    ]
    return [*text_table(header, plates), *text_table(["whole", geometry.name], numbers)]


def _vector(values: Iterable[float]) -> str:
    return " ".join(map(shown_value, map(float, values)))


def list_sets() -> None:
    """List the embedded sets with their measured range and source.

    Example: aerodima models coefficients list
    """
    for name in workbench.embedded_sets():
        coefficients = workbench.load_coefficients(name)
        low, high = coefficients.speed_range
        measured = f"{low:g}-{high:g} m/s"
        if coefficients.angle_range is not None:
            measured += (
                f", |gamma| {coefficients.angle_range[0]:.3f}-{coefficients.angle_range[1]:.3f} rad"
            )
        typer.echo(f"{name}: {coefficients.law_kind}, measured {measured}; {coefficients.source}")


def plot(
    file: Annotated[str, cli.named("Set of coefficients", "coefficients")],
    out: Annotated[Path | None, cli.PICTURE] = None,
    force: cli.Force = False,
) -> None:
    """Plot a set: curves with bands, measured and seed nodes.

    Example: aerodima models coefficients plot cheetah_tail_1_major --out tail_1.png
    """
    target = out or Path(f"{Path(file).stem}.png")
    _write_picture(workbench.plot_coefficients(workbench.load_coefficients(file)), target, force)


def diagram(
    scenario: cli.ScenarioArgument,
    out: Annotated[Path, cli.PICTURE] = Path("diagram.svg"),
    depth: Annotated[
        int, typer.Option(help="How many levels of nested diagrams are drawn.", min=1)
    ] = 2,
    settings: cli.Settings = None,
    force: cli.Force = False,
) -> None:
    """Draw the block diagram of a scenario; needs Graphviz.

    Example: aerodima models diagram turn_swing --depth 1 --out diagram.svg
    """
    built = workbench.assemble(workbench.load_scenario(scenario, settings or ())).builder.Build()
    picture = workbench.draw_diagram(built, depth)
    write_atomically(out, picture.render(out.suffix[1:].lower()), force, UserError)
    typer.echo(f"diagram: {out}")


def range_of_motion(
    scenario: cli.ScenarioArgument = "turn_swing",
    out: Annotated[Path, cli.PICTURE] = Path("range_of_motion.png"),
    settings: cli.Settings = None,
    force: cli.Force = False,
) -> None:
    """Draw where the tail is clear of the car and the ground.

    Rod and sail, over pitch and roll, against cage, deck, wheels and ground.

    Example: aerodima models range-of-motion --out range_of_motion.png
    """
    motion = workbench.make_range_of_motion(workbench.load_scenario(scenario, settings or ()))
    _write_picture(workbench.plot_range_of_motion(motion), out, force)


def export(
    scenario: cli.ScenarioArgument,
    form: Annotated[
        str,
        cli.chosen("Parameters of which program.", "bundle", "commonroad", "f1tenth_gym"),
    ] = "bundle",
    out: Annotated[
        Path | None,
        cli.written("File (.json, .yaml); standard output when left out.", ".json", ".yaml"),
    ] = None,
    settings: cli.Settings = None,
    force: cli.Force = False,
) -> None:
    """Write a scenario as one JSON bundle, or its car for another program.

    A bundle has every number and its swing; it needs no other file. The others are YAML: the
    parameters of the single-track models of f1tenth_gym and CommonRoad.

    Example: aerodima models export f1tenth --form f1tenth_gym --out car.yaml
    """
    import yaml

    from aerodima.workbench.car.single_track import commonroad_parameters, gym_parameters
    from aerodima.workbench.control.controller_bundle import make_bundle

    loaded = workbench.load_scenario(scenario, settings or ())
    if form == "bundle":
        text = json.dumps(make_bundle(loaded), indent=2) + "\n"
    else:
        compute = commonroad_parameters if form == "commonroad" else gym_parameters
        text = yaml.safe_dump(compute(loaded), sort_keys=False)
    if out is None:
        typer.echo(text, nl=False)
        return
    write_atomically(out, text, force, UserError)
    typer.echo(f"scenario: {out}")
