"""Options that commands of all packages share; `grouped`: a command takes several as one value; completion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from aerodima.workbench.resources import models_dir

RUNS = "Run the car and look at runs"
SWINGS = "Find swings and vary numbers"
COEFFICIENTS = "Coefficients, from rig to fit"
THESIS = "Calibrate, and compare with the thesis"
CAR = "Drive the real or the emulated car"
CHECKS = "Look into models and installation"

SECTIONS = (RUNS, SWINGS, COEFFICIENTS, THESIS, CAR, CHECKS)


def _shipped(folder: str) -> Callable[[str], list[str]]:
    """Completion: offers the names of the files of a folder of `models/`."""

    def complete(incomplete: str) -> list[str]:
        return sorted(path.stem for path in (models_dir() / folder).glob(f"{incomplete}*.yaml"))

    return complete


complete_scenario, complete_swing = _shipped("scenarios"), _shipped("swings")
_SCENARIO = "Scenario file (YAML), or the name of one that ships."
ScenarioArgument = Annotated[str, typer.Argument(help=_SCENARIO, autocompletion=complete_scenario)]
ScenarioOption = Annotated[str, typer.Option(help=_SCENARIO, autocompletion=complete_scenario)]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", help="Override such as car.com_height=0.21 or manoeuvre.speed=4.5; may be repeated."),
]
SwingScenarioOption = Annotated[
    str | None,
    typer.Option(
        help="Scenario of the turn; by default that of the swing file, at the speed and grip it claims, or turn_swing.",
        autocompletion=complete_scenario,
    ),
]
SwingArgument = Annotated[
    str, typer.Argument(help="Swing file (YAML), or the name of one that ships.", autocompletion=complete_swing)
]
SwingOption = Annotated[
    str | None,
    typer.Option(help="Swing file (YAML) to play, or the name of one that ships.", autocompletion=complete_swing),
]
OtherCar = Annotated[bool, typer.Option("--other-car", help="Play a swing that was made for another car.")]
Law = Annotated[str | None, typer.Option(metavar="FILE:CLASS", help="Tail law of your own, such as my_law.py:MyLaw.")]
Build = Annotated[
    str | None,
    typer.Option(
        "--diagram", metavar="FILE:FUNCTION", help="What drives, as a Drake diagram of your own: my.py:build."
    ),
]
Html = Annotated[Path | None, typer.Option(help="Write the replay as one self-contained HTML file.")]
Live = Annotated[bool, typer.Option("--live", help="Show the run in Meshcat, in real time, while it goes on.")]
LogOut = Annotated[Path, typer.Option(help="Run log (Parquet) to write.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing output.")]
Anew = Annotated[bool, typer.Option("--force", help="Drop earlier results in the folder.")]
Workers = Annotated[int, typer.Option(help="Worker processes, one BLAS thread each.")]
Scheduler = Annotated[str | None, typer.Option(help="Dask scheduler to use instead, such as tcp://127.0.0.1:8786.")]
Ensemble = Annotated[str, typer.Option(help="Ensemble of cars: a name of models/calibration, or a file.")]


class Key(str):
    """In the annotation of an option: the key of the scenario that it sets."""

    __slots__ = ()


def settings_of(options: Any) -> list[str]:
    """Overrides of a scenario that a dataclass of options asks for: its fields with a `Key`, then those of `--set`."""
    given = [
        f"{key}={value}"
        for name, hint in get_type_hints(type(options), include_extras=True).items()
        for key in getattr(hint, "__metadata__", ())
        if isinstance(key, Key) and (value := getattr(options, name)) is not None
    ]
    return [*given, *(options.settings or ())]


@dataclass(frozen=True)
class WorkOptions:
    """Who computes the runs of a study, and whether it begins anew."""

    workers: Workers = 2
    scheduler: Scheduler = None
    force: Anew = False


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """The command with an option for every field of its parameters that are dataclasses, in their place."""
    parameters: list[Parameter] = []
    groups: dict[str, Any] = {}

    def add(name: str, kind: Any, default: Any) -> None:
        parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind))

    for name, kind in get_type_hints(command, include_extras=True).items():
        if is_dataclass(kind):
            groups[name] = kind
            hints = get_type_hints(kind, include_extras=True)
            for field in fields(kind):
                add(field.name, hints[field.name], Parameter.empty if field.default is MISSING else field.default)
        elif name != "return":
            add(name, kind, signature(command).parameters[name].default)

    @wraps(command)
    def call(**given: Any) -> None:
        made = {
            name: kind(**{field.name: given.pop(field.name) for field in fields(kind)}) for name, kind in groups.items()
        }
        command(**given, **made)

    call.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call


def command_group(app: typer.Typer, name: str, words: str, section: str | None = None) -> typer.Typer:
    """A group of commands in `app`, with its help text and section of the help page."""
    group = typer.Typer(no_args_is_help=True)
    group.callback(help=words)(lambda: None)
    app.add_typer(group, name=name, rich_help_panel=section)
    return group
