"""Names, order and sizes of the vector ports that the simulated and the real station share (design section 9).

Plain Python: the controllers of the no-Drake mode read the same names. `PortFields.named_view` makes the Drake
`namedview` for those who want one.

Signs and axes: car body frame x forward, y left, z up; steering and yaw positive to the left; tail roll 0 = straight
up, positive to the right; acceleration is linear (gravity removed) in body axes.
"""

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

STATUS_SOURCES = ("tail_pitch", "tail_roll", "sail", "imu", "speed", "operator")


@dataclass(frozen=True)
class PortFields:
    """The fields of one vector port, in order.

    Args:
        name: CamelCase name of the views made from it.
        fields: one name per element of the port's vector.
    """

    name: str
    fields: tuple[str, ...]
    _tuple: Any = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_tuple", namedtuple(self.name, self.fields))

    @property
    def size(self) -> int:
        """Number of elements of the port's vector."""
        return len(self.fields)

    def index(self, name: str) -> int:
        """Position of a field in the vector; ValueError, with the known names, for an unknown field."""
        if name not in self.fields:
            raise ValueError(f"{self.name} has no field '{name}'; it has {', '.join(self.fields)}")
        return self.fields.index(name)

    def read(self, values: Sequence[float] | np.ndarray) -> Any:
        """The vector (size,) as an immutable named tuple of plain floats; ValueError for another length."""
        if len(values) != len(self.fields):
            raise ValueError(f"{self.name} has {len(self.fields)} elements, got {len(values)}")
        return self._tuple(*(values.tolist() if isinstance(values, np.ndarray) else map(float, values)))

    def write(self, **values: float) -> np.ndarray:
        """Vector (size,) from one keyword per field, all of them required; TypeError names a missing or unknown one."""
        return np.array(self._tuple(**values), dtype=float)

    def named_view(self) -> type:
        """The `pydrake.common.containers.namedview` class of these fields (imports Drake)."""
        from pydrake.common import containers

        view: type = containers.namedview(self.name, list(self.fields))  # type: ignore[no-untyped-call]
        return view


STEERING_ANGLE = PortFields("SteeringAngle", ("steering_angle",))
"""rad, positive to the left."""

THROTTLE = PortFields("Throttle", ("throttle",))
"""-1 to 1."""

TAIL_COMMAND = PortFields("TailCommand", ("position", "velocity", "kp", "kd", "torque"))
"""One tail motor in MIT mode: rad, rad/s, N m/rad, N m s/rad, N m."""

TAIL_STATE = PortFields(
    "TailState", ("pitch_angle", "roll_angle", "sail_angle", "pitch_rate", "roll_rate", "sail_rate")
)
"""rad and rad/s, as the encoders report them."""

TAIL_TORQUE = PortFields("TailTorque", ("pitch", "roll"))
"""N m, as the motors report it."""

IMU = PortFields(
    "ImuSample",
    (
        "roll",
        "pitch",
        "yaw",
        "gyro_x",
        "gyro_y",
        "gyro_z",
        "acceleration_x",
        "acceleration_y",
        "acceleration_z",
    ),
)
"""rad; rad/s; m/s2 without gravity. All in body axes."""

SPEED = PortFields("Speed", ("speed",))
"""m/s, horizontal."""

STATUS = PortFields(
    "Status", (*(f"{source}_{what}" for source in STATUS_SOURCES for what in ("age", "fault")), "armed")
)
"""Per source: age of its newest sample in s, fault code (0 = none). Armed: 0 or 1."""

PLANNED_TURN = PortFields("PlannedTurn", ("planned_turn",))
"""The turn that the driver announces, from the start of the run on: +1 left, -1 right, 0 none. Goes from the driver to
the tail controller."""

STATION_INPUTS: dict[str, PortFields] = {
    "steering_angle": STEERING_ANGLE,
    "throttle": THROTTLE,
    "tail_pitch_command": TAIL_COMMAND,
    "tail_roll_command": TAIL_COMMAND,
}

STATION_OUTPUTS: dict[str, PortFields] = {
    "tail_state": TAIL_STATE,
    "tail_torque": TAIL_TORQUE,
    "imu": IMU,
    "speed": SPEED,
    "status": STATUS,
}
