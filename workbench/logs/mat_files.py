"""MAT files of MATLAB as columns of numbers.

Those of version 5 to 7 are read with SciPy, of version 7.3, which is HDF5, with h5py (extra `logs`). Vectors become
columns. A struct field is called `data.force`, the second column of a matrix `force(2)`. Objects such as `timeseries`
are stored in a form that only MATLAB reads: they are listed as unreadable.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerodima.workbench.errors import LogError
from aerodima.workbench.logs.foreign_files import ForeignLog

MOST_COLUMNS = 64
"""A matrix with more columns than this (and than rows) is a picture or a table of something else, not a log."""
_OBJECT = "a MATLAB object or cell; save it as a struct of vectors (for a timeseries: its Time and Data)"


def read_mat(path: Path) -> ForeignLog:
    """Columns of a MAT file.

    Raises:
        LogError: damaged or not a MAT file; h5py is not installed and the file is of version 7.3.
    """
    columns: dict[str, NDArray[np.float64]] = {}
    unreadable: dict[str, str] = {}
    for name, value in _leaves_7_3(path) if is_version_7_3(path) else _leaves_5(path):
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            columns |= _vectors(name, value)
        elif isinstance(value, int | float | np.number) and not isinstance(value, bool):
            columns[name] = np.array([value], dtype=np.float64)
        elif not isinstance(value, str | bytes):
            unreadable[name] = _OBJECT
    if not columns:
        raise LogError(
            f"{path}: no vectors of numbers" + (f"; {', '.join(unreadable)}: {_OBJECT}" if unreadable else "")
        )
    return ForeignLog(str(path), {name: pd.Series(values) for name, values in columns.items()}, unreadable=unreadable)


def is_version_7_3(path: Path) -> bool:
    """Whether a MAT file is HDF5: its text header says so, or the HDF5 signature is at a place where it may be."""
    with open(path, "rb") as stream:
        head = stream.read(520)
    return head.startswith(b"MATLAB 7.3") or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520])


def _vectors(name: str, value: NDArray) -> dict[str, NDArray[np.float64]]:
    value = np.squeeze(value)
    if value.ndim <= 1:
        return {name: np.atleast_1d(value).astype(np.float64)}
    if value.ndim > 2 or (value.shape[1] > MOST_COLUMNS and value.shape[1] > value.shape[0]):
        return {}
    return {f"{name}({column + 1})": value[:, column].astype(np.float64) for column in range(value.shape[1])}


def _leaves_5(path: Path) -> Iterator[tuple[str, Any]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        contents = loadmat(path, simplify_cells=True)
    except (ValueError, TypeError, MatReadError, NotImplementedError, OSError, KeyError, IndexError) as cause:
        raise LogError(f"{path}: damaged or not a MAT file ({' '.join(str(cause).split())})") from cause
    for name, value in contents.items():
        if not name.startswith("__"):
            yield from _walk(name, value)


def _walk(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _walk(f"{name}.{key}", inner)
    else:
        yield name, value


def _leaves_7_3(path: Path) -> Iterator[tuple[str, Any]]:
    try:
        import h5py
    except ImportError:
        raise LogError(
            f"{path}: a MAT file of version 7.3 needs h5py: pip install 'aerodima-workbench[logs]'"
        ) from None
    try:
        with h5py.File(path, "r") as file:
            yield from _walk_7_3(h5py, "", file)
    except OSError as cause:
        raise LogError(f"{path}: damaged or not a MAT file of version 7.3") from cause


def _walk_7_3(h5py: Any, prefix: str, group: Any) -> Iterator[tuple[str, Any]]:
    for key in group:
        if key in ("#refs#", "#subsystem#"):
            continue
        value, name = group[key], prefix + key
        matlab_class = value.attrs.get("MATLAB_class", b"")
        if isinstance(value, h5py.Group):
            yield from _walk_7_3(h5py, f"{name}.", value)
        elif matlab_class == b"char":
            yield name, ""
        elif value.dtype.kind in "fiub" and "MATLAB_object_decode" not in value.attrs:
            # HDF5 keeps MATLAB's order of the numbers, so rows and columns are exchanged.
            yield name, np.array([]) if "MATLAB_empty" in value.attrs else np.asarray(value).T
        else:
            yield name, None
