"""Metrics of a run: the eight of the thesis, raw and filtered, and whether the car stayed upright.

Everything is computed from the log alone. The eight metrics come twice, from the signals that the
thesis took for its simulated car (`RunMetrics.raw`) and for the real one (`RunMetrics.filtered`);
all else comes from the ground truth if the log has it, otherwise from the sensors
(`RunMetrics.source`). Signs are turned so that the turn is positive
(`aerodima.workbench.car.turn_signals`), so left and right turns are measured alike. Definitions:
design section 10, thesis section 3.3 and eqs 7.1-7.7.
"""

import math
from dataclasses import asdict, dataclass
from itertools import compress
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid, trapezoid

from aerodima.workbench.car.tail_impulses import tail_effort
from aerodima.workbench.car.turn_signals import TurnSignals, settled_row, turn_signals
from aerodima.workbench.car.verdict import FLIP_TILT, has_flipped, is_loaded
from aerodima.workbench.core.array_types import BoolArray, FloatArray, Texts
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import GPS_FILTER, IMU_FILTER, check_time, low_pass
from aerodima.workbench.metrics.published_values import (
    FILTERED,
    SAMPLE_TIMES,
    Platform,
    TurnMetrics,
)
from aerodima.workbench.scenario.signal_table import GROUND_CONTACTS, WHEELS


@dataclass(frozen=True)
class Outcome:
    """End of a run.

    Attributes:
        result: `flipped` if the tilt passed 75 degrees at any time, or the run ended beyond 20
            degrees with fewer than four wheels loaded (without wheel loads in the log: beyond 20
            degrees); else `survived`, or `unknown` where the log has no attitude.
        clean: whether the car survived, and neither cage nor tail touched the ground, nor the board
            from the start of the turn on; None when the log cannot tell.
        max_tilt_rad: largest tilt of the body's z axis, rad.
        end_tilt_rad: tilt at the end, rad.
        end_wheels_loaded: number of wheels on the ground at the end; None without wheel loads.
        touched: names of those of cage, board and tail that touched the ground, the board only from
            the start of the turn on.
        board_before_turn_s: time for which the anti-ramp board was on the ground before the turn,
            where it is meant to be while the car gathers speed, s; None when the log cannot tell.
    """

    result: Literal["flipped", "survived", "unknown"]
    clean: bool | None
    max_tilt_rad: float
    end_tilt_rad: float
    end_wheels_loaded: int | None
    touched: Texts
    board_before_turn_s: float | None = None


@dataclass(frozen=True)
class RunMetrics:
    """Everything that is reported about a run.

    "From the turn on" = from the steering command to the end of the log.

    Attributes:
        source: `truth` or `sensors`, the signals used for everything except `filtered`.
        direction: side of the turn.
        raw: the eight metrics as Tables 7.1 and 7.2 have them: motion at the IMU's place at up to
            1000 Hz, unfiltered.
        filtered: the eight metrics as Tables 7.3 and 7.4 have them: from what the car's IMU and GPS
            report, at 100 Hz, after the zero-phase filters used for the car (IMU 5 Hz, GPS 1 Hz,
            second order).
        outcome: end of the run, such as whether the car stayed upright.
        peak_roll_rad: largest roll outwards from the turn on, rad.
        two_wheel_time_s: time with fewer than three wheels loaded from the turn on, s; None without
            wheel loads.
        heading_change_rad: heading once the car has settled (`settled_row`), else at the end of the
            log, less heading at the start of the turn, into the turn, rad.
        tail_torque_peak_n_m: largest torque of either tail motor from the turn on, N m; None when
            not logged.
        tail_energy_j: positive work of the tail motors from the turn on, J; None when not logged.
        speed_in_turn_m_per_s: mean speed over the window, weighted by the yaw rate: mean Kohut over
            mean yaw rate if Kohut is taken from sample to sample (ERRATA E36), m/s.
        lift_yaw_rate_rad_per_s: largest yaw rate in the window until the first inner wheel leaves
            the ground (thesis 6.3.4), over all of it if none does, rad/s; None without wheel loads.
    """

    source: Literal["truth", "sensors"]
    direction: Literal["left", "right"]
    raw: TurnMetrics
    filtered: TurnMetrics
    outcome: Outcome
    peak_roll_rad: float
    two_wheel_time_s: float | None
    heading_change_rad: float
    tail_torque_peak_n_m: float | None
    tail_energy_j: float | None
    speed_in_turn_m_per_s: float
    lift_yaw_rate_rad_per_s: float | None

    def like(self, platform: Platform) -> TurnMetrics:
        """Returns the eight metrics from the signals that the published rows of a platform were
        made from.
        """
        return self.filtered if platform == "physical" else self.raw

    def as_row(self) -> dict[str, float | str | bool | None]:
        """Returns one flat row for a table: raw metrics under their names, filtered ones with
        `filtered_` before them.
        """
        own = (
            "peak_roll_rad",
            "two_wheel_time_s",
            "heading_change_rad",
            "tail_torque_peak_n_m",
            "tail_energy_j",
            "speed_in_turn_m_per_s",
            "lift_yaw_rate_rad_per_s",
        )
        return {
            "outcome": self.outcome.result,
            "clean": self.outcome.clean,
            "direction": self.direction,
            "signals": self.source,
            **asdict(self.raw),
            "max_tilt_rad": self.outcome.max_tilt_rad,
            **{name: getattr(self, name) for name in own},
            "touched": " ".join(self.outcome.touched),
            "board_before_turn_s": self.outcome.board_before_turn_s,
            **{FILTERED + name: value for name, value in asdict(self.filtered).items()},
        }


def metrics_of(run_log: RunLog) -> RunMetrics:
    """Returns all metrics of a run; those of a column that holds only NaN are NaN.

    Raises:
        LogError: a column or scenario key is missing, NaN, unsorted time or a gap, the log ends
            before the turn does.
    """
    signals = turn_signals(run_log)
    reported = turn_signals(run_log, "sensors")
    after = signals.from_start
    time = signals.time
    loads = signals.wheel_loads
    peak_torque, energy = tail_effort(run_log, after)
    settled = settled_row(run_log.table, signals.window[1])
    if settled is None:
        settled = -1
    raw = turn_metrics(signals.sampled(1.0 / SAMPLE_TIMES["simulated"]))
    filtered = turn_metrics(reported.sampled(1.0 / SAMPLE_TIMES["physical"]), filtered=True)
    two_wheel_time = None
    lift_yaw_rate = None
    if loads is not None:
        two_wheel_time = _time_while(time[after], _wheels_loaded(loads[after]) < 3)
        lift_yaw_rate = _lift_yaw_rate(signals, loads)
    return RunMetrics(
        source=signals.source,
        direction="left" if signals.sign > 0 else "right",
        raw=raw,
        filtered=filtered,
        outcome=_outcome(signals),
        peak_roll_rad=float(np.max(signals.roll[after])),
        two_wheel_time_s=two_wheel_time,
        heading_change_rad=float(signals.yaw[settled] - signals.yaw[after][0]),
        tail_torque_peak_n_m=peak_torque,
        tail_energy_j=energy,
        speed_in_turn_m_per_s=_speed_in_turn(signals),
        lift_yaw_rate_rad_per_s=lift_yaw_rate,
    )


def turn_metrics(signals: TurnSignals, filtered: bool = False) -> TurnMetrics:
    """Returns the eight metrics over the window of the turn.

    Maxima are of magnitudes, averages are signed means over time; Kohut = speed at the start of the
    window x yaw rate in degrees per second; the roll integral is the largest value over the whole
    run of the integrated outward roll rate.

    Args:
        signals: signals of a run, with signs such that the turn is positive.
        filtered: whether the car's zero-phase filters are applied to the whole run first.
    """

    def prepared(name: str, column: FloatArray) -> FloatArray:
        design = GPS_FILTER if name == "speed" else IMU_FILTER
        if filtered and not np.isnan(column).all():
            return low_pass(signals.time, column, design, name)
        return column

    window = signals.in_window
    time = signals.time[window]
    speed = float(prepared("speed", signals.speed)[signals.from_start][0])
    yaw_rate = prepared("yaw_rate", signals.yaw_rate)[window]
    acceleration = prepared("lateral_acceleration", signals.lateral_acceleration)[window]
    roll_rate = prepared("roll_rate", signals.roll_rate)
    max_yaw_rate = float(np.max(np.abs(yaw_rate)))
    average_yaw_rate = _mean(time, yaw_rate)
    return TurnMetrics(
        speed_m_per_s=speed,
        max_yaw_rate_rad_per_s=max_yaw_rate,
        average_yaw_rate_rad_per_s=average_yaw_rate,
        max_linear_acceleration_m_per_s2=float(np.max(np.abs(acceleration))),
        average_linear_acceleration_m_per_s2=_mean(time, acceleration),
        max_kohut_deg_m_per_s2=speed * math.degrees(max_yaw_rate),
        average_kohut_deg_m_per_s2=speed * math.degrees(average_yaw_rate),
        roll_integral_rad=float(np.max(cumulative_trapezoid(roll_rate, signals.time, initial=0.0))),
    )


def outcome_of(run_log: RunLog) -> Outcome:
    """Returns the outcome of a run; LogError as for `metrics_of`."""
    return _outcome(turn_signals(run_log))


def outcome_from(
    time: FloatArray,
    tilt: FloatArray,
    wheel_loads: FloatArray | None = None,
    ground_contact: FloatArray | None = None,
    turn_start: float = -math.inf,
) -> Outcome:
    """Returns the outcome from the histories themselves.

    Args:
        time: times of the samples, s, shape (n,).
        tilt: angle of the body's z axis from the world's, rad, shape (n,).
        wheel_loads: vertical force on each wheel, N, shape (n, 4).
        ground_contact: force on cage, board and tail, N, shape (n, 3).
        turn_start: start of the turn, s; before it the board may touch the ground.
    """
    check_time(time)
    end_tilt = float(tilt[-1])
    end_loaded = None
    if wheel_loads is not None:
        end_loaded = int(_wheels_loaded(wheel_loads[-1:])[0])
    lifted = end_loaded is None or end_loaded < 4
    flipped = bool(has_flipped(np.max(tilt) > FLIP_TILT, end_tilt, lifted))
    touched: Texts = ()
    clean = None
    board_before = None
    if ground_contact is not None:
        hit = is_loaded(ground_contact)
        board = GROUND_CONTACTS.index("board")
        before = time < turn_start
        board_before = _time_while(time, hit[:, board] & before)
        hit[before, board] = False
        touched = tuple(compress(GROUND_CONTACTS, hit.any(axis=0)))
        clean = not touched
    if flipped:
        clean = False
    result: Literal["flipped", "survived", "unknown"] = "flipped" if flipped else "survived"
    if math.isnan(end_tilt):
        result = "unknown"
    return Outcome(
        result=result,
        clean=clean,
        max_tilt_rad=float(np.max(tilt)),
        end_tilt_rad=end_tilt,
        end_wheels_loaded=end_loaded,
        touched=touched,
        board_before_turn_s=board_before,
    )


def _outcome(signals: TurnSignals) -> Outcome:
    start = float(signals.time[signals.from_start][0])
    return outcome_from(
        signals.time, signals.tilt, signals.wheel_loads, signals.ground_contact, start
    )


def _speed_in_turn(signals: TurnSignals) -> float:
    time = signals.time[signals.in_window]
    speed = signals.speed[signals.in_window]
    yaw_rate = np.abs(signals.yaw_rate[signals.in_window])
    turned = _mean(time, yaw_rate)
    if turned > 0.0:
        return _mean(time, speed * yaw_rate) / turned
    return _mean(time, speed)


def _lift_yaw_rate(signals: TurnSignals, loads: FloatArray) -> float:
    side = "left" if signals.sign > 0 else "right"
    inner = [wheel.endswith(side) for wheel in WHEELS]
    window = signals.in_window
    lifted = np.flatnonzero(_wheels_loaded(loads[window][:, inner]) < sum(inner))
    until = None
    if lifted.size:
        until = lifted[0] + 1
    return float(np.max(signals.yaw_rate[window][:until]))


def _mean(time: FloatArray, values: FloatArray) -> float:
    """Returns the mean over time, which for evenly spaced samples differs from their plain mean by
    half a step at each end.
    """
    return float(trapezoid(values, time) / (time[-1] - time[0]))


def _wheels_loaded(loads: FloatArray) -> NDArray[np.int64]:
    """Returns how many wheels press on the ground, per row of loads (n, 4)."""
    return np.count_nonzero(is_loaded(loads), axis=1)


def _time_while(time: FloatArray, condition: BoolArray) -> float:
    """Returns the total time of the steps that begin with the condition true, s."""
    return float(np.sum(np.diff(time)[condition[:-1]]))
