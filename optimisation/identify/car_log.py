"""A drive of the car as data of a fit: sensor samples around the turn, and commands that are
played to a model.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from aerodima.workbench.car.car_sensors import STEPS
from aerodima.workbench.car.laws import steady_speed
from aerodima.workbench.car.turn_signals import STEERED
from aerodima.workbench.control.manoeuvre import TICK_TOLERANCE, DriverInput, throttle_line
from aerodima.workbench.control.tail_law import Observation
from aerodima.workbench.core.array_types import FloatArray, NamedArrays, Texts, Values
from aerodima.workbench.core.errors import FitError, UserError
from aerodima.workbench.core.file_reading import Settings
from aerodima.workbench.logs.log_findings import inconsistent_rates
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import (
    Interval,
    check_signals,
    checked_signals,
    median_step,
    naming,
)
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.signal_table import IMU

Signals = Mapping[str, FloatArray]
"""Samples (n) of signals, by name."""
LEAD = 0.6
"""Time before the first steering command from which the car of a model rolls, s."""
SETTLING = 0.1
"""Time after it begins to roll from which its motion is compared, once pitch and tail have settled,
s."""
REACH = 0.5
"""Time after the last steering command until which its motion is compared, s."""
MAX_TILT = 0.8
"""Largest lean that is fitted, rad; beyond it the motion is decided by what no model knows, and
later samples are not used."""
STOP_MARGIN = 0.03
"""Distance from the stop that the tail swings to within which it has struck it or may, rad; that
instant decides all that follows."""
MODEL_SHARE = 0.005
"""Least error of the model, as a share of the signal; the largest yaw rate at the plant's step is
off by this share."""
MODEL_TIME = 0.1
"""Duration of one such error, s."""
MIN_SPAN = 0.5
"""Time that a log needs before and after the first steering command, s."""
MIN_SAMPLES = {"imu": 40, "speed": 5}
"""Number of samples that a log needs, by source."""
MIN_NOISE = 1e-4
"""Least deviation of a sample, in the unit of its signal: rad/s, m/s2 or m/s."""
DRIVER = ("steering_command_rad", "throttle_command", "planned_turn")
WITHOUT = {
    "throttle_command": "the car is driven at the logged speed",
    "planned_turn": "no turn is announced",
    "imu_roll_rad": "the car is taken to stay upright",
    "imu_pitch_rad": "the car is taken to stay upright",
    "status_imu_age_s": "each row is taken as a new sample",
    "status_speed_age_s": "each row is taken as a new sample",
    "imu_gyro_x_rad_per_s": "roll rate is left out and car.com_height is that of the scenario",
}
"""Note on what a fit does without a column, for each column that a log may lack."""
TAIL = {
    joint: [
        f"tail_{joint}_command_{name}"
        for name in ("position_rad", "velocity_rad_per_s", "kp", "kd", "torque_n_m")
    ]
    for joint in ("pitch", "roll")
}
CHANNELS = {
    "yaw_rate": ("imu", "imu_gyro_z_rad_per_s", "gyro_z_truth_rad_per_s"),
    "roll_rate": ("imu", "imu_gyro_x_rad_per_s", "gyro_x_truth_rad_per_s"),
    "lateral_acceleration": ("imu", "imu_acceleration_y_m_per_s2", "acceleration_y_truth_m_per_s2"),
    "speed": ("speed", "speed_m_per_s", ""),
}
"""Source of its `status`, column of the log and column of the model's run, by channel."""


@dataclass(frozen=True)
class Channel:
    """Samples of one sensor.

    Attributes:
        time: times at which the samples were taken (n), s.
        value: readings of the sensor (n).
        deviation: deviation by which a model may be off (n): the noise of the sensor, and the least
            error of the model, spread over the samples of its duration.
    """

    time: FloatArray
    value: FloatArray
    deviation: FloatArray


@dataclass(frozen=True)
class LoggedCommands:
    """Commands of a log, held between its rows: the schedule of a driver and, for the tail, its
    law.

    Attributes:
        time: times of the rows (n), s.
        driver: steering angle, rad, throttle and planned turn (3, n).
        tail: commands to the joints pitch and roll (2, n, 5).
        rate: ticks of the tail's controller per second, Hz.
        begin: time of the log from which the commands are played, s.
        latency: time by which the steering lags its command, s.
        memory_size: size of the law's memory, which is empty.
    """

    time: FloatArray
    driver: FloatArray
    tail: FloatArray
    rate: float
    begin: float
    latency: float = 0.0
    memory_size: int = 0

    def at(self, time: float) -> DriverInput:
        """Return the inputs at `time` s since the start."""
        steering = self.driver[0, self._row(time - self.latency)]
        return DriverInput(float(steering), *self.driver[1:, self._row(time)].tolist())

    def start(self) -> FloatArray:
        """Return the memory of this law, which is empty."""
        return np.zeros(0)

    def step(
        self, memory: FloatArray, observation: Observation
    ) -> tuple[FloatArray, FloatArray, FloatArray, int]:
        """Command the joints as the log does at this time."""
        pitch, roll = self.tail[:, self._row(observation.time)]
        return memory, pitch, roll, 0

    def _row(self, time: float) -> int:
        return max(
            int(np.searchsorted(self.time, time + self.begin + TICK_TOLERANCE, side="right")) - 1, 0
        )


@dataclass(frozen=True)
class CarDrive:
    """A drive to be fitted.

    Attributes:
        name: name of the log.
        scenario: scenario of the log; its car has the numbers that are not fitted.
        commands: commands of the driver and of the tail's controller.
        channels: samples of the sensors, by channel as in `CHANNELS`.
        turn: time of the first steering command, s.
        line_speed: speed that the scenario's drive has at the throttle of the log at `turn`, m/s.
        warnings: inconsistent sensors, columns that the log lacks, and reasons why samples at the
            end are not used.
    """

    name: str
    scenario: Scenario
    commands: LoggedCommands
    channels: Mapping[str, Channel]
    turn: float
    line_speed: float
    warnings: Texts

    def run(self, car: Values, begin: float, driven: float, latency: float, step: float) -> Signals:
        """Simulate the drive; return channels without noise and bias, and `time`, s of the log.

        Another driven speed means another line of the throttle.

        Args:
            car: changes to the car of the scenario, by key.
            begin: speed at which the car rolls straight ahead where the commands begin, m/s.
            driven: speed to which the throttle of the log drives the car, m/s.
            latency: latency of the steering, a whole number of steps, s.
            step: step of the plant, s.

        Raises:
            FitError: there is no such car.
        """
        from aerodima.workbench.car.car_run import run_outcome
        from aerodima.workbench.car.run_view import LiveView

        played = replace(self.commands, latency=latency)
        last = max(float(channel.time[-1]) for channel in self.channels.values())
        duration = last + 2.0 * step - played.begin
        offset = self.scenario.drive.throttle_offset + (driven - self.line_speed)
        try:
            changed = self.scenario.varied(
                car=dict(car),
                manoeuvre={"kind": "straight", "speed": driven, "duration": duration},
                drive={"throttle_offset": offset},
                simulation={"step": step},
                servo={"frame_rate": 1.0 / step},
                controller={"rate": 1.0 / step},
            )
            law = played if self.scenario.has_tail else None
            table = run_outcome(changed, False, law, LiveView(), played, begin).table
        except (UserError, RuntimeError) as error:
            raise FitError(str(error)) from error
        columns = {}
        for name, (_, _, column) in CHANNELS.items():
            if column:
                columns[name] = table[column].to_numpy()
        velocity = [table[f"velocity_{axis}_truth_m_per_s"].to_numpy() for axis in "xy"]
        columns["speed"] = np.hypot(*velocity)
        columns["time"] = table["time_s"].to_numpy() + played.begin
        return columns

    def sampled(self, run: Signals, late: float) -> NamedArrays:
        """Sample a run, delayed by `late` seconds, at the times of the log."""
        return {
            name: np.interp(channel.time - late, run["time"], run[name])
            for name, channel in self.channels.items()
        }


def car_drive(log: RunLog, settings: Settings = ()) -> CarDrive:
    """Take from a log of a drive what a fit needs, but no truth.

    Args:
        log: log of a drive of the car or of its simulation.
        settings: overrides of its scenario, `section.key=value`, such as a mass that was weighed.

    Raises:
        LogError: a missing column that is not in `WITHOUT`, unsorted time, a gap or NaN; names the
            column and the time.
        FitError: a log of something else, without a turn, or too short.
        ScenarioError: its scenario or a setting is wrong.
    """
    with naming(log.name):
        return _car_drive(log, settings)


def _completed(log: RunLog, scenario: Scenario) -> tuple[RunLog, Scenario, list[str]]:
    """Fill in the columns of `WITHOUT` that a log lacks.

    Returns:
        Log and scenario of the drive, and a note on what is done without each missing column.
    """
    absent = [name for name in WITHOUT if name not in log.table]
    table = log.table.assign(**dict.fromkeys(absent, 0.0))
    if "throttle_command" in absent:
        scenario = scenario.varied(drive={"governor": True})
        line = throttle_line(scenario)
        speed = checked_signals(log, ["speed_m_per_s"])["speed_m_per_s"]
        table["throttle_command"] = list(map(line.throttle, speed))
    notes = [f"without {name} {WITHOUT[name]}" for name in absent]
    return replace(log, table=table), scenario, notes


def _car_drive(log: RunLog, settings: Settings) -> CarDrive:
    if log.kind not in ("car_run", "car_log"):
        raise FitError(
            f"is a log of kind {log.kind!r}; this fit needs a drive of the car, 'car_run' or "
            "'car_log'"
        )
    # A wrong sign or unit, or gravity in a sensor, for which no constant of the car can make up.
    warnings = inconsistent_rates(log.table)
    rolls = CHANNELS["roll_rate"][1] in log.table
    scenario = Scenario.from_dict(log.scenario, "its scenario", settings)
    log, scenario, notes = _completed(log, scenario)
    time = log.time
    names = [*DRIVER, "imu_roll_rad", "imu_pitch_rad"]
    if scenario.has_tail:
        names += [*TAIL["pitch"], *TAIL["roll"], "tail_roll_angle_rad"]
    signals = checked_signals(log, names)
    steered = np.flatnonzero(np.abs(signals[DRIVER[0]]) > STEERED)
    if not steered.size:
        raise FitError(f"column {DRIVER[0]!r} stays within {STEERED:g} rad; a fit needs a turn")
    turn = float(time[steered[0]])
    end = float(time[steered[-1]]) + REACH
    warnings += notes
    for reason, lost in _losses(scenario, signals, int(steered[0])).items():
        over = time[lost & (time >= turn)]
        if over.size and over[0] < end:
            end = float(over[0])
            warnings.append(f"{reason} at {end:g} s; samples until then are used")
    rate = scenario.controller.rate
    first, last = float(time[0]), float(time[-1])
    begin = max(math.floor((turn - LEAD) * rate) / rate, first)
    if min(turn - begin, last - turn) < MIN_SPAN:
        span = f"{first:g} to {last:g} s, steered from {turn:g} s on"
        raise FitError(f"holds {span}; a fit needs {MIN_SPAN:g} s to either side")
    channels = {
        name: _channel(log, name, scenario, (begin + SETTLING, end))
        for name in CHANNELS
        if rolls or name != "roll_rate"
    }
    tail: FloatArray = np.zeros((2, time.size, 5))
    if scenario.has_tail:
        joints = [[signals[name] for name in columns] for columns in TAIL.values()]
        tail = np.array(joints).swapaxes(1, 2)
    driver = np.array([signals[name] for name in DRIVER])
    commands = LoggedCommands(time=time, driver=driver, tail=tail, rate=rate, begin=begin)
    line_speed = steady_speed(commands.at(turn - begin).throttle, scenario.drive)
    if line_speed <= 0.0:
        raise FitError(
            f"column {DRIVER[1]!r} drives the car at {line_speed:g} m/s into the turn; a fit "
            "needs a driven one"
        )
    return CarDrive(log.name, scenario, commands, channels, turn, line_speed, tuple(warnings))


def _losses(scenario: Scenario, signals: Signals, turn: int) -> dict[str, np.ndarray]:
    """Flag the rows in which no model can follow the car any more; return flags (n) by reason.

    Args:
        turn: row of the first steering command.
    """
    upright = np.cos(signals["imu_roll_rad"]) * np.cos(signals["imu_pitch_rad"])
    losses = {f"the car leans beyond {MAX_TILT:g} rad": upright < math.cos(MAX_TILT)}
    if "tail_roll_angle_rad" in signals:
        angle = signals["tail_roll_angle_rad"]
        across = -np.sign(angle[turn]) * angle
        losses["the tail strikes its stop"] = across > scenario.tail.roll_stop - STOP_MARGIN
    return losses


def _channel(log: RunLog, name: str, scenario: Scenario, span: Interval) -> Channel:
    """Take the samples of a sensor within a span, s, one per row of the log, each at its time."""
    source, column, _ = CHANNELS[name]
    age = log.signal(f"status_{source}_age_s")
    values = log.signal(column)
    begin, end = span
    used = (log.time >= begin) & (log.time <= end)
    time = log.time[used]
    check_signals(time, {column: values[used], f"status_{source}_age_s": age[used]})
    taken = time - age[used]
    sensor = scenario.imu if source == "imu" else scenario.gps
    # The sensor of a log may be faster than that of its scenario, whose period no age then reaches.
    period = min(1.0 / sensor.rate, float(np.ptp(age[used])) + median_step(time))
    new = _fresh_rows(taken, 0.5 * period)
    count = len(new)
    least = MIN_SAMPLES[source]
    if count < least:
        raise FitError(f"only {count} samples of {column!r} around the turn; a fit needs {least}")
    if name == "speed":
        noise, step = scenario.gps.noise, 0.0
    elif name == "lateral_acceleration":
        noise, step = scenario.imu.accelerometer_noise, STEPS[IMU.index("acceleration_y")]
    else:
        noise, step = scenario.imu.gyro_noise, STEPS[IMU.index("gyro_z")]
    time = taken[new]
    value = values[used][new]
    alike = max(MODEL_TIME * (time.size - 1) / float(np.ptp(time)), 1.0)
    size = maximum_filter1d(np.abs(value), 2 * round(alike) + 1)
    # Rounding errors are uniformly distributed.
    squares = noise**2 + step**2 / 12.0 + alike * np.square(MODEL_SHARE * size)
    return Channel(time, value, np.sqrt(np.maximum(squares, MIN_NOISE**2)))


def _fresh_rows(taken: FloatArray, gap: float) -> list[int]:
    """List the rows with a new sample: one taken (n), s, later than that of the last listed row by
    more than the gap, s.
    """
    rows: list[int] = []
    last = -math.inf
    for row, time in enumerate(taken.tolist()):
        if time - last > gap:
            rows.append(row)
            last = time
    return rows
