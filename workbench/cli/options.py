"""Options that commands of all packages share, their completion, and exit statuses."""

import re
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from enum import IntEnum
from functools import wraps
from glob import glob
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperGroup

from aerodima.workbench.core.errors import UserError

RUNS = "Run the car and look at runs"
SWINGS = "Find swings and vary numbers"
COEFFICIENTS = "Coefficients, from rig to fit"
THESIS = "Calibrate, and compare with the thesis"
CAR = "Drive the real or the emulated car"
CHECKS = "Look into models and installation"

SECTIONS = (RUNS, SWINGS, COEFFICIENTS, THESIS, CAR, CHECKS)
PICTURES = (".png", ".svg", ".pdf")
"""Endings of a picture."""


class Status(IntEnum):
    """Exit statuses of the program; `docs/commands.md` says what each one means."""

    DONE = 0
    NO = 1
    WRONG = 2
    LEFT_OUT = 3
    BUG = 70  # EX_SOFTWARE of sysexits.h
    INTERRUPTED = 130  # 128 + SIGINT, as shells report it


def _defined(word: str) -> Callable[[str], list[str]]:
    """Make a completion: FILE:NAME of everything that Python files define with `word`, a class or
    def.
    """

    def complete(incomplete: str) -> list[str]:
        places = []
        for file in sorted(glob(f"{incomplete.partition(':')[0]}*.py")):
            text = Path(file).read_text("utf-8", "replace")
            places += [f"{file}:{name}" for name in re.findall(rf"^{word} (\w+)", text, re.M)]
        return places

    return complete


def _keys(kind: str) -> list[tuple[str, str]]:
    """List `section.key=`, with a value that is one of a few words, and description of the keys of
    `Scenario` or `RigScenario`.
    """
    from aerodima.workbench.scenario import rig_scenario

    keys = []
    for section, model in getattr(rig_scenario, kind).sections().items():
        for key, field in model.model_fields.items():
            words = get_args(field.annotation) or ("",)
            if field.annotation is bool:
                words = ("true", "false")
            for word in words:
                keys.append((f"{section}.{key}={word}", field.description or ""))
    return keys


def endings(*allowed: str) -> Callable[[typer.CallbackParam, Any], Any]:
    """Make the check that the files of an option have one of these endings."""

    def check(param: typer.CallbackParam, value: Any) -> Any:
        for path in value if isinstance(value, list | tuple) else [value]:
            if path is not None and path.suffix.lower() not in allowed:
                wrong = f"{path.suffix!r} must be one of {', '.join(allowed)}"
                raise UserError(f"{param.opts[0]} {path}: ending {wrong}")
        return value

    return check


def written(words: str, *allowed: str) -> Any:
    """Make the option `--out` of a command: a folder, or a file with one of the allowed endings."""
    return typer.Option("--out", "-o", help=words, callback=endings(*allowed) if allowed else None)


def chosen(words: str, *allowed: str) -> Any:
    """Make an option that takes one of a few words and refuses others."""

    def check(param: typer.CallbackParam, value: Any) -> Any:
        if value is not None and value not in allowed:
            raise UserError(f"{param.opts[0]} {value}: must be one of {', '.join(allowed)}")
        return value

    return typer.Option(
        metavar="|".join(allowed),
        help=words,
        autocompletion=lambda: list(allowed),
        callback=check,
    )


def named(words: str, folder: str, kind: Callable[..., Any] = typer.Argument) -> Any:
    """Make an argument or option that takes a file, or the name of one in a folder of `models/`."""

    def complete() -> list[str]:
        from aerodima.workbench.core.yaml_files import shipped_names

        return shipped_names(folder)

    words = f"{words}: a file (YAML), or the name of one that ships."
    return kind(help=words, autocompletion=complete)


def setting(example: str, completion: Callable[..., Any]) -> Any:
    """Make the option `--set` of a command."""
    words = f"Override such as {example}; may be repeated."
    return typer.Option("--set", "-s", metavar="KEY=VALUE", help=words, autocompletion=completion)


_SCENARIO = named("Scenario", "scenarios")
_LAW = typer.Option(
    "--law",
    metavar="FILE:CLASS",
    help="Tail law of your own, such as my_law.py:MyLaw.",
    autocompletion=_defined("class"),
)
_DIAGRAM = typer.Option(
    "--diagram",
    metavar="FILE:FUNCTION",
    help="What drives, as your own Drake diagram.",
    autocompletion=_defined("def"),
)
ScenarioArgument = Annotated[str, _SCENARIO]
OtherScenario = Annotated[str | None, _SCENARIO]
Settings = Annotated[
    list[str] | None,
    setting("car.com_height=0.21 or manoeuvre.speed=4.5", lambda: _keys("Scenario")),
]
RigSettings = Annotated[
    list[str] | None, setting("maxon.torque_constant=0.35", lambda: _keys("RigScenario"))
]
SwingArgument = Annotated[str, named("Swing", "swings")]
SwingOption = Annotated[str | None, named("Swing to play", "swings", typer.Option)]
OtherCar = Annotated[
    bool, typer.Option("--other-car", help="Play a swing that was made for another car.")
]
Law = Annotated[str | None, _LAW]
Laws = Annotated[list[str] | None, _LAW]
Build = Annotated[str | None, _DIAGRAM]
Html = Annotated[
    Path | None,
    typer.Option("--html", help="Page to write, in one file.", callback=endings(".html")),
]
Live = Annotated[
    bool, typer.Option("--live", help="Show the run in Meshcat, in real time, while it goes on.")
]
PICTURE = written("Picture (.png, .svg, .pdf).", *PICTURES)
LogOut = Annotated[Path, written("Run log to write (.parquet).", ".parquet")]
KeptLog = Annotated[Path | None, written("Keep the run log as this file (.parquet).", ".parquet")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing output.")]
Anew = Annotated[bool, typer.Option("--force", help="Drop earlier results in the folder.")]
Workers = Annotated[int, typer.Option(help="Worker processes, one BLAS thread each.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Dask scheduler to use instead, such as tcp://127.0.0.1:8786.")
]
Ensemble = Annotated[str, named("Ensemble of cars", "calibration", typer.Option)]


class Key(str):
    """Key of the scenario that an option sets; part of the option's annotation."""

    __slots__ = ()


def settings_of(options: Any) -> list[str]:
    """List the overrides of a scenario: options with a `Key`, then those of `--set`."""
    overrides = []
    for name, hint in get_type_hints(type(options), include_extras=True).items():
        value = getattr(options, name)
        for key in getattr(hint, "__metadata__", ()):
            if isinstance(key, Key) and value is not None:
                overrides.append(f"{key}={value}")
    return [*overrides, *(options.settings or ())]


@dataclass(frozen=True)
class WorkOptions:
    """Workers of a study, and whether the study begins anew."""

    workers: Workers = 2
    scheduler: Scheduler = None
    force: Anew = False


def _keyword_parameters(owner: Callable[..., Any]) -> list[Parameter]:
    """List the parameters of a function or a dataclass by keyword, their annotations evaluated."""
    hints = get_type_hints(owner, include_extras=True)
    parameters = signature(owner).parameters.values()
    keyword = Parameter.KEYWORD_ONLY
    return [one.replace(kind=keyword, annotation=hints[one.name]) for one in parameters]


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the dataclass parameters of a command by an option for each of their fields."""
    parameters: list[Parameter] = []
    groups: dict[str, Any] = {}
    for parameter in _keyword_parameters(command):
        if is_dataclass(parameter.annotation):
            group: Any = parameter.annotation
            groups[parameter.name] = group
            parameters += _keyword_parameters(group)
        else:
            parameters.append(parameter)

    @wraps(command)
    def call(**given: Any) -> None:
        made = {
            name: kind(**{field.name: given.pop(field.name) for field in fields(kind)})
            for name, kind in groups.items()
        }
        command(**given, **made)

    call.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call


def command_group(
    app: typer.Typer,
    name: str,
    words: str,
    section: str | None = None,
    kind: type[TyperGroup] = TyperGroup,
) -> typer.Typer:
    """Add a group of commands to `app`, with its help text and its section of the help page."""
    group = typer.Typer(cls=kind, no_args_is_help=True)
    group.callback(help=words)(lambda: None)
    app.add_typer(group, name=name, rich_help_panel=section)
    return group
