"""A tail law of one's own from a Python file, named as `my_law.py:MyLaw`. No Drake."""

import importlib.util
import sys
from pathlib import Path
from typing import Any

from aerodima.workbench.controllers.tail_law import TailLaw
from aerodima.workbench.errors import UserError

_MEMBERS = ("rate", "memory_size", "start", "step")


def load_law(place: str) -> TailLaw:
    """Makes the law that a flag names: a class without arguments in a Python file, `my_law.py:MyLaw`.

    The file is run, as a script would be.

    Raises:
        UserError: no such file or class, the file fails, or what it holds is no `TailLaw`; names the place.
    """
    path, _, name = place.rpartition(":")
    if not path or not name.isidentifier():
        raise UserError(f"--law {place}: allowed: a Python file and a class in it, such as my_law.py:MyLaw")
    maker = getattr(_run_file(Path(path)), name, None)
    if not isinstance(maker, type):
        raise UserError(f"--law {place}: {path} has no class {name}")
    try:
        law: Any = maker()
    except Exception as error:
        raise UserError(f"--law {place}: {name}() failed: {_in_words(error)}") from error
    missing = [member for member in _MEMBERS if not hasattr(law, member)]
    if missing:
        raise UserError(f"--law {place}: {name} has no {', '.join(missing)}; a tail law has {', '.join(_MEMBERS)}")
    found: TailLaw = law
    return found


def _run_file(path: Path) -> Any:
    if path.suffix != ".py" or not path.is_file():
        raise UserError(f"--law {path}: no such Python file")
    module_name = f"aerodima_law_{path.stem}"
    specification = importlib.util.spec_from_file_location(module_name, path)
    assert specification is not None  # the ending is .py
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[module_name] = module  # dataclasses look there for the names in annotations
    try:
        specification.loader.exec_module(module)
    except Exception as error:
        raise UserError(f"--law {path}: running it failed: {_in_words(error)}") from error
    return module


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
