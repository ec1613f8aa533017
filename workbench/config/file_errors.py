"""One-line messages about a mapping or recipe file: pydantic's report with the place, the value and what is allowed."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from aerodima.workbench.config.parameter_files import read_yaml
from aerodima.workbench.config.quantity import nearest
from aerodima.workbench.errors import LogError, ScenarioError

Place = tuple[Any, ...]
ModelAt = Callable[[Place], type[BaseModel] | None]


class StrictModel(BaseModel):
    """Part of a mapping or recipe file: frozen, unknown keys and NaN refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)


def read_log_yaml(path: Path) -> dict[str, Any]:
    """The content of a YAML file; LogError when it is missing, not YAML or not a mapping."""
    try:
        return read_yaml(path)
    except ScenarioError as error:
        raise LogError(str(error)) from None


def explain_strictly(error: ValidationError, where: str, model_at: ModelAt) -> LogError:
    """Turns a report into one line that names file, key, value and what is allowed.

    Args:
        error: the report.
        where: file.
        model_at: the model that holds the keys at a place, for the names that would have been right.
    """
    items = error.errors()
    # A list whose entries are wrong is not told to be too short as well.
    told = [
        item
        for item in items
        if item["type"] != "too_short" or not any(_is_within(other["loc"], item["loc"]) for other in items)
    ]
    return LogError("; ".join(f"{where}: {_line(item, model_at)}" for item in told))


def _is_within(place: Place, outer: Place) -> bool:
    return len(place) > len(outer) and place[: len(outer)] == outer


def _line(item: Mapping[str, Any], model_at: ModelAt) -> str:
    place = item["loc"]
    key = ".".join(str(part) for part in place) or "file"
    if item["type"] == "extra_forbidden":
        model = model_at(place[:-1])
        hint = nearest(str(place[-1]), keys_of(model)) if model else "it is not allowed here"
        return f"{key}: unknown key; {hint}"
    if item["type"] == "missing":
        return f"{key}: missing"
    if item["type"] == "value_error":
        return f"{key}: {item['ctx']['error']}"
    message = item["msg"][0].lower() + item["msg"][1:]
    if item["type"].startswith("union_tag"):
        return f"{key}: {message}"
    return f"{key}: {item['input']!r} is not allowed; {message}"


def keys_of(model: type[BaseModel]) -> list[str]:
    """Keys of a section as they are written in the file."""
    return [field.alias or name for name, field in model.model_fields.items()]
