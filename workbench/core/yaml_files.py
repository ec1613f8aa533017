"""YAML files: found by name, read, and checked against a model; errors name the place."""

from collections import Counter
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from aerodima.workbench.core.errors import ScenarioError, UserError
from aerodima.workbench.core.file_reading import Json, read_text, reading
from aerodima.workbench.core.key_errors import lines_of, nearest
from aerodima.workbench.core.resources import models_dir

ModelT = TypeVar("ModelT", bound=BaseModel)
MAX_DEPTH = 100
"""Deepest nesting of mappings and lists; libyaml recurses, and at some 20,000 levels it ends the
process."""
MAX_NESTED_ALIASES = 20
"""Largest number of aliases within parts that other aliases repeat; 20 can expand to 1,600 times
the text, and with a few lines more to gigabytes."""


class StrictModel(BaseModel):
    """Frozen part of a file; unknown keys and NaN are refused."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True
    )


class UniqueKeyLoader(yaml.CSafeLoader):
    """Safe loader that refuses a key named twice, of which plain YAML silently takes the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Read one mapping; raises yaml.constructor.ConstructorError for a duplicate key."""
        keys = Counter(str(key.value) for key, _ in node.value)
        for key, count in keys.items():
            if count > 1:
                raise yaml.constructor.ConstructorError(
                    None, None, f"duplicate key: {key}", node.start_mark
                )
        return super().construct_mapping(node, deep)


def shipped_names(folder: str) -> list[str]:
    """List the names of the YAML files in a folder of `models/`."""
    return sorted(path.stem for path in (models_dir() / folder).glob("*.yaml"))


def find_file(
    name_or_path: str | Path,
    folder: str,
    kind: str,
    error: type[UserError] = ScenarioError,
    *,
    start: Path = Path(),
) -> Path:
    """Return the path itself, or the file of that name in a folder of `models/`.

    A relative path is resolved from `start`, the folder of the file that names it; by default from
    the working folder.

    Raises:
        UserError (of the class `error`): no file has this bare name; the message gives the nearest.
    """
    path = start / name_or_path
    if path.suffix or path.name != str(name_or_path) or path.is_file():
        return path
    names = shipped_names(folder)
    if path.name not in names:
        raise error(
            f"{kind} {path.name!r}: models/{folder} has none of this name; "
            f"{nearest(path.name, names)}"
        )
    return models_dir() / folder / f"{path.name}.yaml"


def read_yaml(path: Path, error: type[UserError] = ScenarioError) -> Json:
    """Read a YAML mapping; an empty file gives an empty mapping.

    Raises:
        UserError (of the class `error`): a missing file, bad syntax, a key named twice, another
            kind of content, too long or too deep.
    """
    with reading(path, "YAML", error):
        data = parse_yaml(read_text(path))
    if data is None:
        return {}
    return require_mapping(data, str(path), error)


def parse_yaml(text: str) -> Any:
    """Parse YAML text.

    Raises:
        yaml.YAMLError: bad syntax, a key named twice, nesting deeper than `MAX_DEPTH`, more
            than `MAX_NESTED_ALIASES` aliases within anchors, a number of thousands of digits, an
            impossible date.
    """
    _refuse_nesting(text)
    try:
        return yaml.load(text, Loader=UniqueKeyLoader)
    except (ValueError, RecursionError) as cause:
        raise yaml.YAMLError(str(cause)) from None


def _refuse_nesting(text: str) -> None:
    """Raise yaml.YAMLError for the nesting that `parse_yaml` refuses; only a text with many
    brackets, long lines or aliases is searched.
    """
    brackets = text.count("[") + text.count("{")
    longest = max(map(len, text.splitlines()), default=0)  # a block level takes a column
    if brackets + longest < 10 * MAX_DEPTH and "*" not in text:
        return
    anchors: list[str | None] = []
    nested_aliases = 0
    for event in yaml.parse(text, Loader=yaml.CSafeLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            anchors.append(event.anchor)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchors.pop()
        elif isinstance(event, yaml.AliasEvent) and any(anchors):
            nested_aliases += 1
            if event.anchor in anchors or nested_aliases > MAX_NESTED_ALIASES:
                reason = f"an alias of itself, or more than {MAX_NESTED_ALIASES} within anchors"
                raise yaml.YAMLError(f"{reason}{event.start_mark}")
        if len(anchors) > MAX_DEPTH:
            raise yaml.YAMLError(f"more than {MAX_DEPTH} levels{event.start_mark}")


def require_mapping(data: Any, where: str, error: type[UserError]) -> Json:
    """Return the data if they are a mapping, else raise `error`."""
    if not isinstance(data, dict):
        raise error(f"{where}: expected a mapping, not a {type(data).__name__}")
    return data


def checked(
    model: type[ModelT],
    data: Any,
    where: str,
    error: type[UserError] = ScenarioError,
    *,
    schema: str | None = None,
) -> ModelT:
    """Make a model from plain data; `schema` is the schema that they must carry, None for any.

    Raises:
        UserError (of the class `error`): unknown or missing key, value not allowed, another schema;
            the message gives the place after `where`, the value and what is allowed.
    """
    version = require_mapping(data, where, error).get("schema")
    if schema is not None and version != schema:
        raise error(f"{where}: schema: {version!r} must be {schema!r}")
    try:
        return model.model_validate(data)
    except ValidationError as report:
        raise error("; ".join(f"{where}: {line}" for line in lines_of(report, model))) from None
