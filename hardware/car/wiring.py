"""What the computer tells the car and hears of it once per cycle, whichever way it is wired (design section 14).

In `teensy_bridge` everything goes through the strings of the Teensy. `watched_can` has the motors on a CAN adapter of
the computer, the Teensy for servo, throttle and sail, and the Teensy on the motors' bus as watchdog. Both are a
`WiredCar`, with the same readings, the same faults and the same way out.
Plain NumPy: it runs where Drake has no wheel.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Literal, get_args

import numpy as np

from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.protocol.radio import OperatorCommand
from aerodima.workbench.config.signal_table import IMU, STATUS, TAIL_COMMAND, TAIL_STATE, TAIL_TORQUE
from aerodima.workbench.errors import HardwareError

WiringName = Literal["teensy_bridge", "watched_can"]
WIRINGS: tuple[WiringName, ...] = get_args(WiringName)


def wiring_name(name: str) -> WiringName:
    """The wiring of that name; `HardwareError` with those there are."""
    for known in WIRINGS:
        if known == name:
            return known
    raise HardwareError(f"--wiring {name}: allowed: {', '.join(WIRINGS)}")


@dataclass(frozen=True)
class CarCommand:
    """One cycle's commands, in the units and signs of the station's input ports; the default asks for nothing.

    Attributes:
        steering_angle: rad, positive to the left. throttle: -1 to 1.
        tail_pitch, tail_roll: (5,) as `aerodima.workbench.config.signal_table.TAIL_COMMAND`.
    """

    steering_angle: float = 0.0
    throttle: float = 0.0
    tail_pitch: np.ndarray = field(default_factory=partial(np.zeros, TAIL_COMMAND.size))
    tail_roll: np.ndarray = field(default_factory=partial(np.zeros, TAIL_COMMAND.size))

    @property
    def finite(self) -> bool:
        """Whether every number of it is."""
        numbers = np.concatenate(([self.steering_angle, self.throttle], self.tail_pitch, self.tail_roll))
        return bool(np.all(np.isfinite(numbers)))


@dataclass(frozen=True)
class CarReading:
    """What is known after a cycle, as the station's output ports give it. Values hold their last sample.

    Attributes:
        tail_state: (6,) `aerodima.workbench.config.signal_table.TAIL_STATE`, rad and rad/s.
        tail_torque: (2,) N m. imu: (9,) `aerodima.workbench.config.signal_table.IMU`. speed: (1,) m/s.
        status: (13,) `aerodima.workbench.config.signal_table.STATUS`: ages in s (infinite before the first sample),
            faults, armed.
        operator: the operator's last command, for driving by radio.
        fault_text: the worst fault in words, empty while there is none.
    """

    tail_state: np.ndarray = field(default_factory=partial(np.zeros, TAIL_STATE.size))
    tail_torque: np.ndarray = field(default_factory=partial(np.zeros, TAIL_TORQUE.size))
    imu: np.ndarray = field(default_factory=partial(np.zeros, IMU.size))
    speed: np.ndarray = field(default_factory=partial(np.zeros, 1))
    status: np.ndarray = field(default_factory=partial(np.zeros, STATUS.size))
    operator: OperatorCommand = IDLE
    fault_text: str = ""
