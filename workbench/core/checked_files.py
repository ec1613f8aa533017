"""Checked files: sections whose numbers have units; reading and writing of YAML files of them."""

import difflib
import math
import re
from collections.abc import Collection
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from aerodima.workbench.core.errors import ScenarioError, UserError
from aerodima.workbench.core.resources import models_dir

NO_UNIT = "1"
"""Unit of a dimensionless number, a name, a flag or a count."""
STANDARD_GRAVITY = 9.80665
"""What a sensor calls 1 g, m/s2 (CGPM 1901)."""
ModelT = TypeVar("ModelT", bound=BaseModel)
Place = tuple[str | int, ...]
CONSTANT = "constant"
"""Word for the plain number of `tail.normal_force_coefficient`."""
FILE_ENDINGS = (".yaml", ".yml", ".csv")
SAIL_LAWS = ("normal_force", "two_sided")
"""Laws of coefficient files that know the normal of a sail (`SectionLaw.knows_normal`)."""


def quantity(unit: str, description: str, **limits: float) -> Any:
    """Declares a field of `QuantityModel`.

    Args:
        unit: SI unit as written in the YAML files, `1` when dimensionless.
        description: what the number is, in one line.
        limits: pydantic's `ge`, `gt`, `le`, `lt`, and `default` where the file may leave it out, in
            that unit.
    """
    described: Any = {"unit": unit}
    bounds: Any = limits
    return Field(description=description, json_schema_extra=described, **bounds)


class QuantityModel(BaseModel):
    """Frozen section of a scenario. Unknown keys, NaN and foreign units are refused.

    A value is a plain number in the unit of the field or a text that repeats that unit, such as
    `3.33 m/s`. Another unit is an error and not converted: a scenario has one reading.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _read_units(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        return {key: cls._read_value(key, value) for key, value in data.items()}

    @classmethod
    def _read_value(cls, key: str, value: Any) -> Any:
        field = cls.model_fields.get(key)
        if field is None or field.annotation not in (float, int) or not isinstance(value, str):
            return value
        number, _, unit = value.strip().partition(" ")
        expected = unit_of(cls, key)
        if unit.strip() not in ("", expected):
            raise ValueError(
                f"{key}: {value!r} has the unit {unit.strip()!r}; allowed is {expected!r}"
            )
        try:
            return field.annotation(number)
        except ValueError:
            return value


def unit_of(model: type[BaseModel], key: str) -> str:
    """Unit that `quantity` declared for a field; `1` for fields without one."""
    extra = model.model_fields[key].json_schema_extra
    if isinstance(extra, dict):
        return str(extra.get("unit", NO_UNIT))
    return NO_UNIT


def nearest(name: str, known: Collection[str]) -> str:
    """Tail of an error about an unknown name: the closest known one, or all of them."""
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return "allowed: " + ", ".join(sorted(known))


def check_range(
    name: str,
    value: float,
    low: float,
    high: float,
    unit: str,
    *,
    above_low: bool = False,
    error: type[UserError] = UserError,
) -> None:
    """Raises UserError (of the class `error`) unless `value` is finite and within [low, high]; see
    `above_low`.

    Args:
        name: where the value comes from, e.g. "controller.swing_speed".
        value: in the unit of the limits.
        low: smallest value allowed.
        high: largest value allowed; may be infinite.
        unit: printed after value and limits.
        above_low: refuse `low` itself.
    """
    if math.isfinite(value) and value <= high and (value > low if above_low else value >= low):
        return
    limits = {f"{'>' if above_low else '>='} {low:g}": low, f"<= {high:g}": high}
    if unit == NO_UNIT:
        shown = ""
    else:
        shown = f" {unit}"
    allowed = " and ".join(text for text, limit in limits.items() if math.isfinite(limit))
    raise error(
        f"{name}: {value:g}{shown}; allowed: {allowed + shown if allowed else 'a finite number'}"
    )


class StrictModel(BaseModel):
    """Part of a file: frozen, unknown keys and NaN refused."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )


class UniqueKeyLoader(yaml.CSafeLoader):
    """Safe loader that refuses a key named twice, of which plain YAML silently takes the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """One mapping; raises yaml.constructor.ConstructorError at the place of the second key."""
        keys = [key.value for key, _ in node.value]
        twice = sorted({str(key) for key in keys if keys.count(key) > 1})
        if twice:
            raise yaml.constructor.ConstructorError(
                None, None, f"key named twice: {', '.join(twice)}", node.start_mark
            )
        return super().construct_mapping(node, deep)


def shipped_names(folder: str) -> list[str]:
    """Names of the YAML files in a folder of `models/`."""
    return sorted(path.stem for path in (models_dir() / folder).glob("*.yaml"))


def find_file(
    name_or_path: str | Path, folder: str, kind: str, error: type[UserError] = ScenarioError
) -> Path:
    """The path itself, or the file of that name in a folder of `models/`.

    Raises:
        UserError (of the class `error`): a bare name that is not there; names the nearest.
    """
    path = Path(name_or_path)
    if path.suffix or path.name != str(name_or_path) or path.exists():
        return path
    names = shipped_names(folder)
    if path.name not in names:
        raise error(
            f"{kind} {path.name!r}: models/{folder} has none of this name; "
            f"{nearest(path.name, names)}"
        )
    return models_dir() / folder / f"{path.name}.yaml"


def read_yaml(path: Path, error: type[UserError] = ScenarioError) -> dict[str, Any]:
    """Reads a YAML mapping; an empty file is an empty one.

    Raises:
        UserError (of the class `error`): a missing file, bad syntax, a key named twice or another
            kind of content.
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=UniqueKeyLoader)
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as cause:
        raise error(f"{path}: cannot be read: {cause}") from None
    except yaml.YAMLError as cause:
        raise error(f"{path}: not YAML: {' '.join(str(cause).split())}") from None
    if data is None:
        return {}
    return require_mapping(data, str(path), error)


def require_mapping(data: Any, where: str, error: type[UserError]) -> dict[str, Any]:
    """The data, if they are keys with values."""
    if not isinstance(data, dict):
        raise error(f"{where}: holds a {type(data).__name__}; allowed is a mapping")
    return data


def checked(
    model: type[ModelT],
    data: Any,
    where: str,
    error: type[UserError] = ScenarioError,
    *,
    schema: str | None = None,
) -> ModelT:
    """The model of plain data; `schema` is what they must carry, if they must carry one.

    Raises:
        UserError (of the class `error`): unknown or missing key, value not allowed, another schema;
            names the place after `where`, the value and what is allowed.
    """
    found = require_mapping(data, where, error).get("schema")
    if schema is not None and found != schema:
        raise error(
            f"{where}: schema: {found!r} is not read by this version; allowed is {schema!r}"
        )
    try:
        return model.model_validate(data)
    except ValidationError as report:
        raise error("; ".join(f"{where}: {line}" for line in lines_of(report, model))) from None


def lines_of(report: ValidationError, model: type[BaseModel]) -> list[str]:
    """What is wrong with plain data that a model refused, a line each."""
    items: list[Any] = list(report.errors())
    # A list whose entries are wrong is not called too short as well.
    outer = {item["loc"][:depth] for item in items for depth in range(len(item["loc"]))}
    return [
        _line(item, model)
        for item in items
        if item["type"] != "too_short" or item["loc"] not in outer
    ]


def keys_of(model: type[BaseModel]) -> list[str]:
    """Keys of a section as they are written in the file."""
    return [field.alias or name for name, field in model.model_fields.items()]


def _line(item: Any, model: type[BaseModel]) -> str:
    """One of pydantic's errors as `key: value is not allowed; what is`."""
    place = item["loc"]
    kind = item["type"]
    key = ".".join(map(str, place))
    if kind == "missing":
        return f"{key}: missing"
    if kind == "value_error":
        text = str(item["ctx"]["error"])
        if not key:
            return text
        return key + ("." if re.match(r"[\w.]+: ", text) else ": ") + text
    owners = _models_at(model, place[:-1])
    if kind == "extra_forbidden":
        return f"{key}: unknown key; {_nearest_key(place, owners)}"
    allowed = item["msg"][0].lower() + item["msg"][1:]
    if kind.startswith("union_tag"):
        return f"{key}: {allowed}"
    units = {
        unit_of(owner, place[-1]) for owner in owners if place and place[-1] in owner.model_fields
    } - {NO_UNIT}
    return f"{key}: {item['input']!r} is not allowed; {allowed}" + "".join(
        f" ({unit})" for unit in units
    )


def _nearest_key(place: Place, owners: list[type[BaseModel]]) -> str:
    name = str(place[-1])
    sections = [
        key for owner in owners for key in keys_of(owner) if name in _keys_within(owner, key)
    ]
    if len(place) == 1 and sections:
        return f"did you mean {' or '.join(f'{section}.{name}' for section in sections)}?"
    return nearest(name, [key for owner in owners for key in keys_of(owner)])


def _keys_within(owner: type[BaseModel], key: str) -> set[str]:
    return {
        name for model in _models_at(owner, (key,)) if model is not owner for name in keys_of(model)
    }


def _models_at(model: type[BaseModel], place: Place) -> list[type[BaseModel]]:
    """The models that may hold the keys at a place: several where the file chooses and the place
    does not say.
    """
    models = [model]
    for part in place:
        fields = [(name, field) for owner in models for name, field in owner.model_fields.items()]
        tagged = [owner for owner in models if part == owner.__name__ or part in _tags(owner)]
        named = [field for name, field in fields if part in (name, field.alias)]
        inner = [found for field in named for found in _named_in(field.annotation)]
        models = tagged or inner or models  # an index, or the key of a mapping, stays where it is
    return models


def _tags(model: type[BaseModel]) -> set[Any]:
    return {
        tag
        for field in model.model_fields.values()
        for tag in get_args(field.annotation)
        if isinstance(tag, str)
    }


def _named_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _named_in(part)]


@cache
def robot_tail_sets() -> tuple[str, ...]:
    """Embedded sets (`models/coefficients`) whose law knows the normal of a sail, sorted."""
    files = sorted((models_dir() / "coefficients").glob("*.yaml"))
    return tuple(
        path.stem
        for path in files
        if yaml.safe_load(path.read_text(encoding="utf-8")).get("law") in SAIL_LAWS
    )


def require_coefficient_name(name: str) -> None:
    """Refuses (ValueError) what is neither `constant` nor a set for the robot's tail nor a path of
    a YAML or CSV file.

    A file is looked at when the car is built: a log stays readable where the file is not at hand.
    """
    if name == CONSTANT or Path(name).suffix in FILE_ENDINGS or name in robot_tail_sets():
        return
    known = [CONSTANT, *robot_tail_sets()]
    raise ValueError(
        f"coefficients: {name!r} is no set for the robot's tail; {nearest(name, known)}; "
        f"or the path of a file ({', '.join(FILE_ENDINGS)})"
    )
