"""Systems that convert between double and AutoDiffXd: the two names that Drake's stubs lack, in one place."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pydrake.systems.framework
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.scalar_conversion import TemplateSystem

LeafSystem_: Any = vars(pydrake.systems.framework)["LeafSystem_"]
"""Drake's template of leaf systems."""


def system_template(name: str) -> Callable[[Callable[[Any], Any]], Any]:
    """Decorator of a function f(T) that returns a system class, for T = float and AutoDiffXd (see `TemplateSystem`)."""
    decorator: Callable[[Callable[[Any], Any]], Any] = TemplateSystem.define(  # type: ignore[no-untyped-call]
        name, T_list=[float, AutoDiffXd]
    )
    return decorator
