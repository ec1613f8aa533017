"""Atomic writing: a reader sees the old file or the whole new one, never a part of it.

The content first goes to a hidden file beside the target, which is forced to the disk and then
takes the target's name.
"""

import os
from collections.abc import Callable
from pathlib import Path

from aerodima.workbench.core.errors import UserError


def refuse_existing(path: Path | None, force: bool, error: type[UserError]) -> None:
    """Raise `error` if `path` is a folder, or exists and `force` is not set; None passes."""
    if path is None:
        return
    if path.is_dir():
        raise error(f"{path}: is a folder, a file name is needed")
    if path.exists() and not force:
        raise error(
            f"{path}: exists already and is not overwritten; choose another name, or use "
            "--force (in Python force=True)"
        )


def make_folder(folder: Path, error: type[UserError]) -> None:
    """Make `folder` and its parents; raise `error` naming the folder when that is not possible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as cause:
        raise error(f"{folder}: cannot be made or used as a folder ({cause.strerror})") from cause


def write_atomically(
    path: Path, content: str | bytes | Callable[[Path], object], force: bool, error: type[UserError]
) -> Path:
    """Write to a hidden file beside `path` and rename it to `path`.

    Args:
        path: final path of the file; its folder is made when it is not there.
        content: content of the file, or a function that writes all of it to the path it is given.
        force: whether an existing file is replaced.
        error: class of the errors raised: path exists, folder unusable, disk full.
    """
    refuse_existing(path, force, error)
    make_folder(path.parent, error)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        if callable(content):
            content(temporary)
        else:
            temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        with open(temporary, "rb+") as stream:
            os.fsync(stream.fileno())
        _take_name(temporary, path, force, error)
    except OSError as cause:
        raise error(f"{path}: cannot be written ({cause.strerror or cause})") from cause
    finally:
        temporary.unlink(missing_ok=True)
    return path


def _take_name(temporary: Path, path: Path, force: bool, error: type[UserError]) -> None:
    """Rename; without `force` by a hard link, which fails if another process took the name in the
    meantime.
    """
    if not force:
        try:
            os.link(temporary, path)
            return
        # Without hard links in the file system, the check and the rename are two steps.
        except OSError:
            refuse_existing(path, force, error)
    os.replace(temporary, path)
