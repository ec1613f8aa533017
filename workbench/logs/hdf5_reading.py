"""HDF5 files, read by a process of its own: some damaged ones make the library crash.

`python -m aerodima.workbench.logs.hdf5_reading FILE` writes what is in it to stdout, pickled.
"""

import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_DEFLATION = 1032
"""Most bytes that a compressed one of HDF5 stands for."""
MAX_UNSTORED = 2**24
"""Size of the largest HDF5 dataset that is read although the file holds less of it, bytes."""
_TIMEOUT = 600.0
"""Longest time of reading, s."""


def read_hdf5(path: Path) -> dict[str, Any]:
    """Reads groups as dicts, and datasets as `_content` gives them.

    Raises:
        ValueError: what the library says of a damaged file, or that it crashed.
    """
    command = [sys.executable, "-P", "-m", __name__, str(path)]  # -P: no module of the folder
    reader = subprocess.run(command, capture_output=True, timeout=_TIMEOUT, check=False)
    if reader.returncode < 0:
        raise ValueError(f"it makes the HDF5 library crash (signal {-reader.returncode})")
    if reader.returncode:
        raise ValueError(reader.stderr.decode(errors="replace").splitlines()[-1])
    content: dict[str, Any] = pickle.loads(reader.stdout)
    return content


def _contents(group: Mapping[str, Any]) -> dict[str, Any]:
    """Reads all that is in a group."""
    contents: dict[str, Any] = {}
    for name, value in group.items():
        if hasattr(value, "items"):
            contents[name] = _contents(value)
        else:
            contents[name] = _content(value)
    return contents


def _content(dataset: Any) -> NDArray | str | None:
    """Reads a dataset: its numbers, "" for a text, None for an object.

    It keeps MATLAB's order of the numbers, so that rows and columns are exchanged. ValueError for
    one that states a size which the bytes in the file cannot have.
    """
    stored = dataset.id.get_storage_size()
    if dataset.nbytes > max(MAX_UNSTORED, MAX_DEFLATION * stored):
        raise ValueError(f"{dataset.name} states {dataset.nbytes} bytes, the file holds {stored}")
    if dataset.attrs.get("MATLAB_class") == b"char":
        return ""
    if dataset.dtype.kind not in "fiub" or "MATLAB_object_decode" in dataset.attrs:
        return None
    if "MATLAB_empty" in dataset.attrs:
        return np.array([])
    return np.asarray(dataset).T


def main() -> None:
    """Reads the file that the command line names."""
    import h5py

    with h5py.File(sys.argv[1], "r") as file:
        pickle.dump(_contents(file), sys.stdout.buffer)


if __name__ == "__main__":
    main()
