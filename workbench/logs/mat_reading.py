"""MAT files, read by a separate process: some damaged ones make SciPy or the HDF5 library crash.

`python -m aerodima.workbench.logs.mat_reading FILE` writes what is in it to stdout, pickled.
"""

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

MAX_DEFLATION = 1032
"""Largest number of bytes that one compressed byte of HDF5 stands for."""
MAX_UNSTORED = 2**24
"""Size of the largest HDF5 dataset that is read although the file holds less of it, bytes."""
_TIMEOUT = 600.0
"""Longest time of reading, s."""


def read_struct(path: Path) -> dict[str, Any]:
    """Reads the variables of a file: those of version 7.3 as `_content` gives them, others as
    SciPy's `loadmat` does with simplified cells.

    Raises:
        ValueError: the library reports a damaged file, or crashed.
    """
    command = [sys.executable, "-P", "-m", __name__, str(path)]  # -P: no module of the folder
    reader = subprocess.run(command, capture_output=True, timeout=_TIMEOUT, check=False)
    if reader.returncode < 0:
        raise ValueError(f"it makes the library that reads it crash (signal {-reader.returncode})")
    if reader.returncode:
        raise ValueError(reader.stderr.decode(errors="replace").splitlines()[-1])
    content: dict[str, Any] = pickle.loads(reader.stdout)
    return content


def is_version_7_3(path: Path) -> bool:
    """Says whether a MAT file is HDF5: its text header says so, or the HDF5 signature is at a place
    where it may be.
    """
    with open(path, "rb") as stream:
        head = stream.read(520)
    return head.startswith(b"MATLAB 7.3") or b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520])


def _content(dataset: Any, follow: bool = True) -> Any:
    """Reads a group as a dict, and a dataset: its numbers, "" for a text, None for an object.

    References, of which cells and struct arrays are made, become a list of what they lead to; those
    behind a reference are not followed.

    HDF5 keeps MATLAB's order of the numbers, so rows and columns are exchanged. ValueError for a
    dataset that states a size which the bytes in the file cannot have.
    """
    if hasattr(dataset, "items"):
        return {name: _content(value, follow) for name, value in dataset.items()}
    stored = dataset.id.get_storage_size()
    if dataset.nbytes > max(MAX_UNSTORED, MAX_DEFLATION * stored):
        raise ValueError(f"{dataset.name} states {dataset.nbytes} bytes, the file holds {stored}")
    if dataset.attrs.get("MATLAB_class") == b"char":
        return ""
    if dataset.dtype.metadata and follow:
        return [_content(dataset.file[to], follow=False) for to in np.ravel(dataset)]
    if dataset.dtype.kind not in "fiub" or "MATLAB_object_decode" in dataset.attrs:
        return None
    if "MATLAB_empty" in dataset.attrs:
        return np.array([])
    return np.asarray(dataset).T


def main() -> None:
    """Reads the file that the command line names."""
    path = Path(sys.argv[1])
    if is_version_7_3(path):
        import h5py

        with h5py.File(path, "r") as file:
            content = _content(file)
    else:
        from scipy.io import loadmat

        content = loadmat(path, simplify_cells=True)
    pickle.dump(content, sys.stdout.buffer)


if __name__ == "__main__":
    main()
