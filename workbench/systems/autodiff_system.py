"""Systems that convert between double and AutoDiffXd, and the output port of those that push a plant."""

from __future__ import annotations

import sys
import weakref
from collections.abc import Callable
from typing import Any

import pydrake.systems.framework
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common.value import Value
from pydrake.multibody.plant import ExternallyAppliedSpatialForce_
from pydrake.systems.scalar_conversion import TemplateSystem

LeafSystem_: Any = vars(pydrake.systems.framework)["LeafSystem_"]
"""Drake's template of leaf systems."""


def system_template(name: str, module: str) -> Callable[[Callable[[Any], Any]], Any]:
    """Decorator of a function f(T) that returns a system class, for T = float and AutoDiffXd (see `TemplateSystem`).

    Args:
        name: of the template.
        module: `__name__` of the caller. To find it by itself Drake reads the source of the whole call stack, which
            takes seconds where imports are nested deeply.
    """
    decorator: Callable[[Callable[[Any], Any]], Any] = TemplateSystem.define(  # type: ignore[no-untyped-call]
        name, T_list=[float, AutoDiffXd], scope=sys.modules[module]
    )
    return decorator


def declare_abstract_output(
    system: Any, name: str, make: Callable[[], Any], calc: Callable[[Any, Any], None], inputs: set[Any]
) -> None:
    """Declares an abstract output port.

    Drake 1.58 keeps the function of an abstract port for ever, unlike that of a vector port: a bound method would make
    its system, and with it the whole diagram, immortal. So the port holds it weakly; it lives as long as its system.

    Args:
        system: whose method `calc` is.
        name: of the port.
        make: gives a new value of its type.
        calc: called with a context and the value to be set.
        inputs: tickets of what the value depends on.
    """
    method: Any = weakref.WeakMethod(calc)
    system.DeclareAbstractOutputPort(name, make, lambda context, output: method()(context, output), inputs)


def declare_spatial_forces(system: Any, calc: Callable[[Any, Any], None], inputs: set[Any], T: Any = float) -> None:
    """Declares the output port `spatial_forces`, a list[ExternallyAppliedSpatialForce], of scalar type T."""
    declare_abstract_output(system, "spatial_forces", Value[list[ExternallyAppliedSpatialForce_[T]]], calc, inputs)
