"""Files from outside: any failure of a reader becomes one error; too long a text is refused."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aerodima.workbench.core.errors import UserError

Json = dict[str, Any]
"""A JSON object."""
Facts = Mapping[str, Any]
"""A read-only JSON object."""
Settings = tuple[str, ...]
"""Overrides of a scenario, each `section.key=value`."""
MAX_TEXT = 32 * 2**20
"""Size of the largest scenario, mapping or other text that is read at once, bytes."""
_MAX_REASON = 300
"""Number of characters of a parser's own message that an error repeats."""


@contextmanager
def reading(
    path: Path | str, kind: str, error: type[UserError], remedy: str = ""
) -> Iterator[None]:
    """Turn every failure of a reader into one `error`: file, kind, reason and `remedy`.

    Damaged files make parsers raise anything: `zlib.error`, `struct.error`, MemoryError,
    RecursionError. A `UserError` from within says more and passes unchanged.
    """
    try:
        yield
    except UserError:
        raise
    except FileNotFoundError as cause:
        raise error(f"{path}: no such file{remedy}") from cause
    except Exception as cause:
        words = str(cause)
        reason = (words if " " in words else repr(cause))[:_MAX_REASON]
        raise error(f"{path}: cannot be read as {kind}: {reason}{remedy}") from cause


def read_text(path: Path) -> str:
    """Read a UTF-8 text; raises ValueError if it is longer than `MAX_TEXT`, as a device may be."""
    with open(path, "rb") as stream:
        content = stream.read(MAX_TEXT + 1)
    if len(content) > MAX_TEXT:
        raise ValueError(f"longer than {MAX_TEXT // 2**20} MiB")
    return content.decode()


def read_json(path: Path, error: type[UserError]) -> Any:
    """Read a JSON text; raises `error`, as `reading` does, for anything that is not JSON."""
    with reading(path, "JSON", error):
        return json.loads(read_text(path))
