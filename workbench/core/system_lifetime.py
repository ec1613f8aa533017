"""Templates of systems, and how long systems stay in memory."""

import sys
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pydrake.systems.framework
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import (
    DiagramBuilder,
)
from pydrake.systems.scalar_conversion import TemplateSystem

LeafSystem_: Any = vars(pydrake.systems.framework)["LeafSystem_"]
"""Drake's template of leaf systems."""


class SystemParts:
    """Base of the classes from which `scalar_template` makes a `LeafSystem` of some scalar type.

    A subclass has `declare(T, ...)`, which declares ports and state with the arguments of the
    system, and `arguments(T)`, which gives the arguments of the same system of scalar type T.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def scalar_template(name: str, module: str, parts: type[SystemParts]) -> Any:
    """Makes the template of a system for T = float and AutoDiffXd (see `TemplateSystem`).

    Args:
        name: name of the template.
        module: `__name__` of the caller. To find it by itself Drake reads the source of the whole
            call stack, which takes seconds where imports are nested deeply.
        parts: class that declares the system.
    """

    def instantiation(T: Any) -> Any:
        class Impl(parts, LeafSystem_[T]):  # type: ignore[misc, valid-type]  # known at run time
            __doc__ = parts.__doc__

            def _construct(self, *args: Any, converter: Any = None, **settings: Any) -> None:
                LeafSystem_[T].__init__(self, converter=converter)
                self.declare(T, *args, **settings)

            def _construct_copy(self, other: Any, converter: Any = None) -> None:
                Impl._construct(self, *other.arguments(T), converter=converter)

        return Impl

    scalars = [float, AutoDiffXd]
    define: Any = TemplateSystem.define
    return define(name, T_list=scalars, scope=sys.modules[module])(instantiation)


def weak_callback(calc: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Returns a bound method as the function of an output port that does not keep its system, and
    the whole diagram, alive for ever.

    A port lives as long as its system. Drake 1.51 keeps the functions of all ports, 1.58 those of
    abstract ports.
    """
    method: Any = calc
    function = method.__func__
    owner = weakref.ref(method.__self__)
    return lambda context, output: function(owner(), context, output)


@contextmanager
def break_reference_cycles(builder: DiagramBuilder) -> Iterator[None]:
    """Frees a diagram from memory after the block; nothing may use the diagram afterwards.

    Up to Drake 1.51, Python cannot collect the cycles between the builder, its systems and their
    ports.
    """
    try:
        yield
    finally:
        waiting: list[Any] = [builder]
        while waiting:
            waiting += getattr(waiting.pop(), "__dict__", {}).pop(
                "_pydrake_internal_ref_cycle_peers", ()
            )
