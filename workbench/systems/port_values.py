"""Values of vector ports, with the type that Drake's stubs do not give them."""

from typing import cast

from pydrake.systems.framework import Context, InputPort, OutputPort

from aerodima.workbench.config.array_types import FloatArray


def vector_of(port: InputPort | OutputPort, context: Context) -> FloatArray:
    """Value (n,) of a vector port of n numbers; of an input port an array that is not to be changed."""
    return cast(FloatArray, port.Eval(context))
