"""Errors about a key of a file: where it is, what is wrong, and the nearest valid key."""

import difflib
import re
from collections.abc import Collection, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from aerodima.workbench.core.quantity import angle_hint, unit_of
from aerodima.workbench.core.ranges import NO_UNIT

Model = type[BaseModel]
Place = tuple[str | int, ...]


def nearest(name: str, known: Collection[str]) -> str:
    """Suggest the closest known name for an unknown one, or list all of them."""
    close = difflib.get_close_matches(name, known, n=1)
    if close:
        return f"did you mean {close[0]!r}?"
    return "must be one of: " + ", ".join(sorted(known))


def require_unique(names: Sequence[object], what: str, error: type[Exception] = ValueError) -> None:
    """Raise `error` if a name occurs twice; one would be taken for the other."""
    for name in names:
        if names.count(name) > 1:
            raise error(f"{what} {str(name)!r}: duplicate; must be named once")


def lines_of(report: ValidationError, model: Model) -> list[str]:
    """Describe what is wrong with the data that a model refused, one line per error."""
    items: list[Any] = list(report.errors())
    # A list whose entries are wrong is not reported as too short as well.
    outer = {item["loc"][:depth] for item in items for depth in range(len(item["loc"]))}
    return [
        _line(item, model)
        for item in items
        if item["type"] != "too_short" or item["loc"] not in outer
    ]


def keys_of(model: Model) -> list[str]:
    """List the keys of a section as they are written in the file."""
    return [field.alias or name for name, field in model.model_fields.items()]


def _line(item: Any, model: Model) -> str:
    """Write one of pydantic's errors as `key: value is not allowed; what is`."""
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
    text = f"{key}: {item['input']!r} is not allowed; {allowed}"
    for owner in owners:
        if place[-1] in owner.model_fields and unit_of(owner, place[-1]) != NO_UNIT:
            unit = unit_of(owner, place[-1])
            return f"{text} ({unit}){angle_hint(unit)}"
    return text


def _nearest_key(place: Place, owners: list[Model]) -> str:
    name = str(place[-1])
    if len(place) == 1:
        for section, field in owners[0].model_fields.items():
            if any(name in keys_of(model) for model in _models_in(field.annotation)):
                return f"did you mean {section}.{name}?"
    return nearest(name, [key for owner in owners for key in keys_of(owner)])


def _models_at(model: Model, place: Place) -> list[Model]:
    """Find the models that may hold the keys at a place: several where the file chooses a model and
    the place does not show which.
    """
    models = [model]
    for part in place:
        tagged = [owner for owner in models if part == owner.__name__ or part in _tags(owner)]
        inner = []
        for owner in models:
            for name, field in owner.model_fields.items():
                if part in (name, field.alias):
                    inner += _models_in(field.annotation)
        models = tagged or inner or models  # an index, or the key of a mapping, stays where it is
    return models


def _tags(model: Model) -> list[Any]:
    return [tag for field in model.model_fields.values() for tag in get_args(field.annotation)]


def _models_in(annotation: Any) -> list[Model]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
