"""Paths of the files of `models/` in a checkout, an editable install and a wheel.

In a wheel they are inside the package (`workbench/_models`); in a checkout and an editable install
they are the folder `models` beside the packages.
"""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from aerodima.workbench.core.errors import ModelError

if TYPE_CHECKING:
    import pandas as pd

_PACKAGE = Path(__file__).resolve().parent.parent
_SHIPPED = _PACKAGE / "_models"
_CHECKOUT = _PACKAGE.parent / "models"


@cache
def models_dir() -> Path:
    """Find the folder with `package.xml`, models, parameters and scenarios.

    Raises:
        ModelError: neither a wheel's nor a checkout's folder is there.
    """
    for folder in (_SHIPPED, _CHECKOUT):
        if folder.is_dir():
            return folder
    raise ModelError(f"the model files are missing: neither {_SHIPPED} nor {_CHECKOUT} is a folder")


def model_path(relative: str) -> Path:
    """Find a file or folder of `models/`.

    Args:
        relative: path below `models/` with forward slashes, such as `parameters/car.yaml`.

    Raises:
        ModelError: there is no such file.
    """
    path = models_dir() / relative
    if not path.exists():
        raise ModelError(f"model file {relative!r} does not exist in {models_dir()}")
    return path


def published_rows(name: str) -> list[dict[str, str]]:
    """Read the rows of `models/published/NAME.csv`, every cell as printed there."""
    with model_path(f"published/{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@cache
def published_table(name: str) -> pd.DataFrame:
    """Read `models/published/NAME.csv` with numbers parsed; do not change the table in place."""
    import pandas as pd

    return pd.read_csv(model_path(f"published/{name}.csv"))
