"""Files from outside: whatever a reader raises becomes one error, and no text is read without a
limit.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from aerodima.workbench.core.errors import UserError

Json = dict[str, Any]
"""A JSON object."""
Facts = Mapping[str, Any]
"""A JSON object that is read only."""
MAX_TEXT = 32 * 2**20
"""Size of the largest scenario, mapping or other text that is read at once, bytes."""
_MAX_REASON = 300
"""Characters of a parser's own message that are repeated."""


@contextmanager
def reading(
    path: Path | str, kind: str, error: type[UserError], remedy: str = ""
) -> Iterator[None]:
    """Turn every failure of a reader into one `error`: file, kind, reason and `remedy`.

    Damaged files make parsers raise what they like: `zlib.error`, `struct.error`, MemoryError,
    RecursionError. A `UserError` from within says more and passes.
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
    """Read a UTF-8 text; raises ValueError when it is longer than `MAX_TEXT`, as a device is."""
    with open(path, "rb") as stream:
        content = stream.read(MAX_TEXT + 1)
    if len(content) > MAX_TEXT:
        raise ValueError(f"longer than {MAX_TEXT // 2**20} MiB")
    return content.decode()


def read_json(path: Path, error: type[UserError]) -> Any:
    """Read a JSON text; raises `error`, as `reading` does, for whatever is none."""
    with reading(path, "JSON", error):
        return json.loads(read_text(path))
