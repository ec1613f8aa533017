"""What the computer tells the car and hears of it once per cycle, whichever way it is wired (design section 14).

In `teensy_bridge` everything goes through the strings of the Teensy. `direct_can` has the motors on a CAN adapter of
the computer and the Teensy for servo, throttle and sail; `watched_can` is the same with the Teensy on the bus as
watchdog. All are a `Wiring`, with the same readings, the same faults and the same way out.
Plain NumPy: it runs where Drake has no wheel.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol, get_args

import numpy as np

from aerodima.hardware.devices.radio_link import IDLE
from aerodima.hardware.protocol.radio import Asks, OperatorCommand
from aerodima.workbench.config.signal_table import IMU, STATUS, TAIL_COMMAND, TAIL_STATE, TAIL_TORQUE
from aerodima.workbench.errors import HardwareError

WiringName = Literal["direct_can", "teensy_bridge", "watched_can"]
WIRINGS: tuple[WiringName, ...] = get_args(WiringName)


def wiring_name(name: str) -> WiringName:
    """The wiring of that name; `HardwareError` with those there are."""
    for known in WIRINGS:
        if known == name:
            return known
    raise HardwareError(f"--wiring {name}: allowed: {', '.join(WIRINGS)}")


def _off() -> np.ndarray:
    return np.zeros(TAIL_COMMAND.size)


@dataclass(frozen=True)
class CarCommand:
    """One cycle's commands, in the units and signs of the station's input ports; the default asks for nothing.

    Attributes:
        steering_angle: rad, positive to the left. throttle: -1 to 1.
        tail_pitch, tail_roll: (5,) as `aerodima.workbench.config.signal_table.TAIL_COMMAND`.
    """

    steering_angle: float = 0.0
    throttle: float = 0.0
    tail_pitch: np.ndarray = field(default_factory=_off)
    tail_roll: np.ndarray = field(default_factory=_off)

    @property
    def finite(self) -> bool:
        """Whether every number of it is."""
        numbers = np.concatenate(([self.steering_angle, self.throttle], self.tail_pitch, self.tail_roll))
        return bool(np.all(np.isfinite(numbers)))


def _zeros(size: int) -> np.ndarray:
    return np.zeros(size)


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

    tail_state: np.ndarray = field(default_factory=lambda: _zeros(TAIL_STATE.size))
    tail_torque: np.ndarray = field(default_factory=lambda: _zeros(TAIL_TORQUE.size))
    imu: np.ndarray = field(default_factory=lambda: _zeros(IMU.size))
    speed: np.ndarray = field(default_factory=lambda: _zeros(1))
    status: np.ndarray = field(default_factory=lambda: _zeros(STATUS.size))
    operator: OperatorCommand = IDLE
    fault_text: str = ""


class Wiring(Protocol):
    """The car at the end of its cables. None of these calls waits for a device, apart from `start` and `stop`.

    Attributes:
        asks: what the operator is told to do before the car drives, with the next report; set by the guard.
    """

    asks: Asks

    @property
    def name(self) -> WiringName:
        """Which of them it is."""
        ...

    def start(self) -> None:
        """Opens the ports and starts the threads; commands nothing. `HardwareError` names the port that failed."""
        ...

    def arm(self) -> None:
        """Begins to switch the tail motors on; they take commands when `armed` of the status is 1.

        A car without a tail is armed at once: servo and throttle take commands.

        Raises:
            HardwareError: no watchdog test is recorded for this wiring, or a motor or the bus has a fault.
        """
        ...

    def read(self, now: float) -> CarReading:
        """The first half of a cycle, every 10 ms: takes in what came and lets the motors do what their state asks for.

        Reading and writing are two calls so that a command can be made of the readings of its own cycle; one call for
        both would let every command wait a cycle, 10 ms in which the tail swings 0.08 rad.

        Args:
            now: `time.monotonic()`, s.
        """
        ...

    def write(self, command: CarCommand, now: float) -> None:
        """The second half: sends the command. What is not finite is a fault of both motors, and throttle 0."""
        ...

    def hold(self, now: float) -> None:
        """Holds the tail where it is, until the next command that is not all zeros."""
        ...

    def disarm(self, now: float) -> None:
        """Exit frames now and in the following cycles; the links stay open and `read` goes on."""
        ...

    def reset(self, now: float) -> None:
        """Forgets faults and the operator's stop, by hand only; the motors stay off until `arm`."""
        ...

    def stop(self, reason: str) -> None:
        """Exit frames several times, throttle 0, steering 0, then everything is closed; from every state, at any time.

        Never raises and may be called twice.
        """
        ...
