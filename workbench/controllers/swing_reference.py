"""What a tracker commands at each time of a swing: knots with joint gains, or torque with time-varying feedback.

Everything here is in the turn direction of the swing file; `swing_tracker_law` mirrors. Plain NumPy.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from aerodima.workbench.config.swing_curve import gains_at, swing_at
from aerodima.workbench.config.swing_file import Feedback, SwingFile
from aerodima.workbench.errors import UserError

Tracking = Literal["automatic", "feedback", "torque", "joint_pd", "open_loop"]
TRACKINGS: tuple[Tracking, ...] = ("automatic", "feedback", "torque", "joint_pd", "open_loop")
"""`feedback`: gains on car and tail, those on the tail in the motor's own loop as far as it takes them. `torque`: the
same law as torque alone (thesis section 8.3). `joint_pd`: the motors follow the knots, nothing looks at the car.
`open_loop`: the nominal torque alone. `automatic`: feedback if the file has gains, else joint_pd."""

KP_MAX, KD_MAX = 500.0, 5.0
"""Ranges of the MIT frame (design section 14), N m/rad and N m s/rad."""

_JOINT_STATES = {"roll": ("tail_roll", "tail_roll_rate"), "pitch": ("tail_pitch", "tail_pitch_rate")}
_DEFAULT_FUNNEL = {"tail_roll": 1.0, "tail_pitch": 1.0}
"""rad; for a swing without feedback: a tail this far behind its knots is blocked or free."""


class JointCommand(NamedTuple):
    """Command to one motor: rad, rad/s, N m/rad, N m s/rad, N m."""

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


@dataclass(frozen=True)
class SwingReference:
    """A swing as its tracker needs it.

    Args:
        swing: the file.
        tracking: one of `TRACKINGS`.
        rate: of the controller, Hz: between two ticks a command is held, so positions are those of the middle.

    Raises:
        UserError: unknown tracking, or the file has not what it needs.
    """

    swing: SwingFile
    tracking: Tracking = "automatic"
    rate: float = 100.0

    def __post_init__(self) -> None:
        if self.tracking not in TRACKINGS:
            raise UserError(f"controller.tracking: {self.tracking!r}; allowed: {', '.join(TRACKINGS)}")
        feedback, knots = self.swing.gains.feedback, self.swing.knots
        if self.kind in ("feedback", "torque") and feedback is None:
            raise UserError(
                f"swing {self.swing.name}: gains.feedback: missing; tracking {self.kind} needs it; allowed: joint_pd"
            )
        if self.kind == "open_loop" and feedback is None and knots.roll_torque_n_m is None:
            raise UserError(f"swing {self.swing.name}: knots.roll_torque_n_m: missing; tracking open_loop needs it")

    @property
    def kind(self) -> str:
        """The tracking with `automatic` resolved."""
        if self.tracking != "automatic":
            return self.tracking
        return "joint_pd" if self.swing.gains.feedback is None else "feedback"

    @property
    def length(self) -> float:
        """Time from the release to the end, s: of the knots, or of the feedback if that is longer."""
        feedback, end = self.swing.gains.feedback, self.swing.knots.time_s[-1]
        return max(end, feedback.time_s[-1]) if feedback is not None and self.kind != "joint_pd" else end

    @property
    def start(self) -> tuple[float, float]:
        """Roll and pitch at the first knot, rad."""
        return self.swing.knots.roll_position_rad[0], self.swing.knots.pitch_position_rad[0]

    def commands(self, time: float, states: dict[str, float]) -> tuple[JointCommand, JointCommand]:
        """Commands to the roll and the pitch motor.

        Args:
            time: since the release, s.
            states: name of `FEEDBACK_STATES` -> value; NaN is taken as nominal.
        """
        point, gains = swing_at(self.swing, time + 0.5 / self.rate), gains_at(self.swing, time)
        roll = JointCommand(
            float(point.roll_position), float(point.roll_velocity), gains[0].kp, gains[0].kd, float(point.roll_torque)
        )
        pitch = JointCommand(
            float(point.pitch_position), float(point.pitch_velocity), gains[1].kp, gains[1].kd,
            float(point.pitch_torque),
        )  # fmt: skip
        feedback = self.swing.gains.feedback
        if self.kind == "open_loop":
            torque = roll.torque
            if feedback is not None:
                torque = float(np.interp(time, feedback.time_s, feedback.roll_torque_n_m))
            return self._limited("roll", JointCommand(0.0, 0.0, 0.0, 0.0, torque), states), pitch
        if self.kind == "joint_pd":
            return self._limited("roll", roll, states), self._limited("pitch", pitch, states)
        roll = self._fed_back("roll", time, states)
        if feedback is not None and feedback.pitch_gains is not None:
            return roll, self._fed_back("pitch", time, states)
        return roll, self._limited("pitch", pitch, states)

    def outside_funnel(self, time: float, states: dict[str, float]) -> str | None:
        """Name of a state that has left its funnel; None while all are inside. NaN counts as inside."""
        if self.kind == "open_loop":
            return None
        if self.kind == "joint_pd":
            point = swing_at(self.swing, time)
            nominal = {"tail_roll": float(point.roll_position), "tail_pitch": float(point.pitch_position)}
            funnel = _DEFAULT_FUNNEL
        else:
            row = self._row(time)
            nominal = dict(zip(self._feedback.states, row.nominal, strict=True))
            funnel = dict(zip(self._feedback.states, self._feedback.funnel, strict=True))
        return next((name for name, width in funnel.items() if abs(states[name] - nominal[name]) > width), None)

    def _fed_back(self, joint: Literal["roll", "pitch"], time: float, states: dict[str, float]) -> JointCommand:
        """torque = nominal - gains (states - nominal states); the joint's own gains go to the motor as kp and kd."""
        row = self._row(time)
        gains, torque = (row.roll_gains, row.roll_torque) if joint == "roll" else (row.pitch_gains, row.pitch_torque)
        ahead = self._row(time + 0.5 / self.rate).nominal
        position_name, velocity_name = _JOINT_STATES[joint]
        position = velocity = kp = kd = 0.0
        for name, nominal, gain, soon in zip(self._feedback.states, row.nominal, gains, ahead, strict=True):
            value = states[name]
            deviation = value - nominal if value == value else 0.0
            in_motor = 0.0
            if self.kind == "feedback" and name == position_name:
                in_motor = kp = min(max(float(gain), 0.0), KP_MAX)
                position = float(soon)
            elif self.kind == "feedback" and name == velocity_name:
                in_motor = kd = min(max(float(gain), 0.0), KD_MAX)
                velocity = float(soon)
            torque -= (gain - in_motor) * deviation
        return self._limited(joint, JointCommand(position, velocity, kp, kd, float(torque)), states)

    def _limited(
        self, joint: Literal["roll", "pitch"], command: JointCommand, states: dict[str, float]
    ) -> JointCommand:
        """Takes as much from the torque that the motor, at its present state, gives no more than the file's limit."""
        angle, rate = (states[name] for name in _JOINT_STATES[joint])
        own = command.kp * (command.position - angle) + command.kd * (command.velocity - rate)
        own = own if own == own else 0.0
        most = self.swing.limits.torque_n_m
        return command._replace(torque=min(max(own + command.torque, -most), most) - own)

    @cached_property
    def _feedback(self) -> Feedback:
        feedback = self.swing.gains.feedback
        assert feedback is not None
        return feedback

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Times of the feedback (n,) and one row per time (n, 3 states + 2): nominal, both gains, both torques."""
        feedback = self._feedback
        nominal, roll_torque = np.array(feedback.nominal), np.array(feedback.roll_torque_n_m)
        pitch_gains = np.zeros_like(nominal) if feedback.pitch_gains is None else feedback.pitch_gains
        pitch_torque = np.zeros_like(roll_torque) if feedback.pitch_torque_n_m is None else feedback.pitch_torque_n_m
        columns: list[Any] = [nominal, feedback.roll_gains, pitch_gains, roll_torque, pitch_torque]
        return np.array(feedback.time_s), np.column_stack(columns)

    def _row(self, time: float) -> "_Row":
        times, values = self._table
        clipped = min(max(time, times[0]), times[-1])
        place = min(int(np.searchsorted(times, clipped, side="right")) - 1, len(times) - 2)
        share = (clipped - times[place]) / (times[place + 1] - times[place])
        row = values[place] + share * (values[place + 1] - values[place])
        nominal, roll_gains, pitch_gains = np.split(row[:-2], 3)
        return _Row(nominal, roll_gains, pitch_gains, float(row[-2]), float(row[-1]))


class _Row(NamedTuple):
    nominal: np.ndarray
    roll_gains: np.ndarray
    pitch_gains: np.ndarray
    roll_torque: float
    pitch_torque: float
