"""A laboratory that is not ours: logs from formulae of its own, with the truth beside them and no
scenario in them.

Nothing of the workbench's rig, force laws or rollouts is used. The held rig is a closed form, the
swings are the equation of motion given to scipy. Frames and signs are those of docs/design.md,
section 4; the force law that of section 5; the numbers below are typed off the thesis (Tables 4.2,
4.5, 4.6).
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from aerodima.workbench.logs.schema import run_log_from_metadata, write_run_log

GRAVITY = 9.81
ACCURACY = np.array([8.0067, 7.9933, 14.46, 0.4283, 0.445, 0.38])
COUNT = 2.0 * math.pi / (512 * 4 * 26)
HOLD_ANGLE = math.radians(20.0)
FLICK_ANGLE = math.radians(60.0)
READINGS = ("force_x_n", "force_y_n", "force_z_n", "torque_x_n_m", "torque_y_n_m", "torque_z_n_m")


@dataclass(frozen=True)
class Lab:
    """True numbers of the rig with tail 1 (SI), and what its instruments do wrong.

    Attributes:
        encoder_zero: is subtracted from the angle in the log, rad.
        current_delay: by which the logged current comes late, s.
        force_bias, force_drift, force_noise: N and N m, per s of the latter, per sample.
        current_noise: A per sample.
        count: of the encoder, rad.
    """

    pivot: tuple[float, float, float] = (0.09576, -0.00011, 0.17138)
    mount_mass: float = 1.189
    mount_com: tuple[float, float, float] = (-0.00569, -0.00011, 0.03149)
    bar_mass: float = 0.313
    bar_com: float = 0.100
    bar_end: float = 0.270
    bar_inertia: float = 1.9198e-3
    bar_width: float = 0.02
    bar_drag: float = 2.0
    tail_length: float = 0.39
    tail_width: float = 0.0639
    tail_mass: float = 0.0982
    tail_com: float = 0.163
    tail_gap: float = 0.0
    rotor_inertia: float = 6.731e-3
    torque_constant: float = 0.346
    jet_edge_depth: float = 0.265
    jet_slope: float = 1.0 / 18.0
    air_density: float = 1.225
    coulomb: float = 0.0435
    viscous: float = 0.0364
    encoder_zero: float = 0.0
    current_delay: float = 0.0
    wind_gain: float = 1.0
    force_gain: float = 1.0
    force_bias: np.ndarray = field(default_factory=lambda: np.zeros(6))
    force_drift: np.ndarray = field(default_factory=lambda: np.zeros(6))
    force_noise: np.ndarray = field(default_factory=lambda: 0.01 * ACCURACY)
    current_noise: float = 0.01
    count: float = COUNT

    @property
    def root(self) -> float:
        """Distance of the tail's root from the pivot, m."""
        return self.bar_end + self.tail_gap

    @property
    def bare_inertia(self) -> float:
        """Of bar and rotor about the motor axis, kg m2."""
        return self.bar_inertia + self.bar_mass * self.bar_com**2 + self.rotor_inertia


LAB = Lab()


def _axis(q):
    return np.array([0.0, -math.sin(q), -math.cos(q)])


def _exposed(lab, q, psi, start, length):
    """First and last distance from the pivot that the jet meets."""
    rate = math.cos(q) + lab.jet_slope * math.sin(q) * math.cos(psi)
    edge = lab.jet_edge_depth / rate if rate > 1e-9 else math.inf
    return max(start, edge), start + length


def _force(v, a, cd, cl, scale):
    """Drag along v and lift across it, to the root; the lift turns over within a degree and fades
    at the end.
    """
    speed = float(np.linalg.norm(v))
    if speed < 1e-9:
        return np.zeros(3)
    along = float(v @ a) / speed
    across = math.sqrt(max(1.0 - along * along, 0.0))
    x = max(-1.0, min(1.0, along / math.sin(math.radians(1.0))))
    y = min(1.0, across / math.sin(math.radians(10.0)))
    turned = 0.5 * x * (3.0 - x * x) * y * y * (3.0 - 2.0 * y)
    lift = -(a - along * v / speed) / max(across, 1e-9)
    return scale * speed * (cd * v + cl * turned * speed * lift)


def _loads(lab, q, rate, psi, wind, cd, cl):
    """Force, moment about W and torque about the motor axis (downstream positive) of the air on
    tail and bar.
    """
    a = _axis(q)
    w = wind * np.array([math.sin(psi), -math.cos(psi), 0.0])
    total = np.zeros(3)
    moment = np.zeros(3)
    torque = 0.0
    hand = np.array([0.0, -math.cos(q), math.sin(q)])
    parts = 5 if rate else 1
    for start, length, width, drag, lift, number in (
        (lab.root, lab.tail_length, lab.tail_width, cd, cl, parts),
        (0.0, lab.bar_end, lab.bar_width, lab.bar_drag, 0.0, 1),
    ):
        first, last = _exposed(lab, q, psi, start, length)
        if first >= last:
            continue
        piece = (last - first) / number
        for i in range(number):
            s = first + (i + 0.5) * piece
            # A positive rate moves the point s a towards the hand.
            force = _force(
                w - rate * s * hand, a, drag, lift, 0.5 * lab.air_density * piece * width
            )
            total += force
            moment += np.cross(np.array(lab.pivot) + s * a, force)
            torque += s * float(force @ hand)
    return total, moment, np.array(torque)


def weight(lab, q):
    """Wrench of the support (6) and torque about the motor axis of the weight alone."""
    a = _axis(q)
    p = np.array(lab.pivot)
    bodies = [
        (lab.mount_mass, np.array(lab.mount_com)),
        (lab.bar_mass, p + lab.bar_com * a),
        (lab.tail_mass, p + (lab.root + lab.tail_com) * a),
    ]
    wrench = np.zeros(6)
    for mass, place in bodies:
        load = mass * GRAVITY * np.array([0.0, 0.0, 1.0])
        wrench[:3] += load
        wrench[3:] += np.cross(place, load)
    arm = lab.bar_mass * lab.bar_com + lab.tail_mass * (lab.root + lab.tail_com)
    return wrench, -GRAVITY * arm * math.sin(q)


def hold(
    lab=LAB,
    *,
    cd=0.9,
    cl=0.25,
    psi=0.03,
    angle=HOLD_ANGLE,
    wind=20.0,
    rest=2.0,
    duration=8.0,
    rate=500.0,
    seed=0,
    wander=None,
    **extra,
):
    """A static hold whose first `rest` seconds are without wind; the sensor was zeroed at nothing
    (offset 0).

    Args:
        wander: of the times (n) in units of each axis' accuracy (n), added to all six readings.
        extra: further metadata.
    """
    rng = np.random.default_rng(seed)
    time = _times(duration, rate)
    force, moment, torque = _loads(lab, angle, 0.0, psi, lab.wind_gain * wind, cd, cl)
    hanging, hanging_torque = weight(lab, angle)
    blown = np.concatenate([-force, -moment])
    windy = time > rest
    readings = hanging + np.outer(windy, blown)
    current = (hanging_torque + windy * float(torque)) / lab.torque_constant
    readings = lab.force_gain * readings + lab.force_bias + np.outer(time, lab.force_drift)
    if wander is not None:
        readings += np.outer(wander(time), ACCURACY)
    readings += lab.force_noise * rng.normal(size=readings.shape)
    table = pd.DataFrame({"time_s": time, "angle_rad": _count(lab, angle - lab.encoder_zero)})
    table["current_a"] = current + lab.current_noise * rng.normal(size=len(time))
    table[list(READINGS)] = readings
    truth = {"cd": cd, "cl": cl, "psi3": psi, "current": float(current[-1])}
    facts = {
        "tail": "1",
        "axis": "major",
        "wind_speed_m_per_s": wind,
        "offsets_to_add": [0.0] * 6,
        "truth": truth,
    }
    if rest > 0.0:
        facts["rest_s"] = [0.0, float(rest)]
    return _log(table, "static", facts | extra)


def bar_swing(lab=LAB, *, angle=1.4, duration=5.0, **extra):
    """The bare bar let go at `angle`."""

    def motion(t, state):
        q, w = state
        load = -GRAVITY * lab.bar_mass * lab.bar_com * math.sin(q) - _friction(lab, w)
        return [w, load / lab.bare_inertia]

    truth = {"coulomb": lab.coulomb, "viscous": lab.viscous}
    table = _swing(lab, motion, (angle, 0.0), duration, 500.0)
    table["current_a"] = 0.0
    return _log(table, "bar_swing", {"truth": truth, "rest_s": [-1.0, 0.0], **extra})


def flick(
    lab=LAB,
    *,
    added_mass=0.02,
    angle=FLICK_ANGLE,
    duration=1.5,
    rate=500.0,
    convention="instantaneous",
    seed=0,
    **extra,
):
    """Tail 1 let go at `angle` in a wind of 10 m/s and driven by a smooth current; C_D is 0.9 and
    C_L 0.25.

    Args:
        convention: whether a sample of the current is its value then, or the `mean` since the
            sample before.
        seed: of drive and noise.
    """
    rng = np.random.default_rng(seed)
    sine = Sine(1.5, 2.0 * math.pi * (1.0 + rng.uniform()), rng.uniform(0.0, 2.0 * math.pi))
    inertia = swinging_inertia(lab, added_mass)

    def motion(t, state):
        q, w = state
        load = weight(lab, q)[1] + float(
            _loads(lab, q, w or 1e-300, 0.0, lab.wind_gain * 10.0, 0.9, 0.25)[2]
        )
        return [w, (load - lab.torque_constant * sine.value(t) - _friction(lab, w)) / inertia]

    table = _swing(lab, motion, (angle, 0.0), duration, rate)
    late = table.time_s.to_numpy() - lab.current_delay
    current = (
        sine.value(late) if convention == "instantaneous" else sine.mean(late - 1.0 / rate, late)
    )
    table["current_a"] = current + lab.current_noise * rng.normal(size=len(late))
    facts = {"tail": "1", "axis": "major", "wind_speed_m_per_s": 10.0, "rest_s": [-1.0, 0.0]}
    return _log(table, "swing", facts | {"truth": {"added_mass": added_mass}} | extra)


@dataclass(frozen=True)
class Sine:
    """size sin(frequency t + phase), and its mean between two times."""

    size: float
    frequency: float
    phase: float

    def value(self, t):
        return self.size * np.sin(self.frequency * t + self.phase)

    def mean(self, start, end):
        ends = np.cos(self.frequency * start + self.phase) - np.cos(
            self.frequency * end + self.phase
        )
        return self.size * ends / (self.frequency * (end - start))


def write(log, folder, name):
    """The log as a file."""
    return write_run_log(replace(log, source=name), folder / f"{name}.parquet")


def swinging_inertia(lab, added_mass):
    """Of bar, tail, rotor and added mass per fifth of the tail (kg) about the motor axis, kg m2."""
    arms = lab.root + lab.tail_length * (np.arange(5) + 0.5) / 5.0
    tail = lab.tail_mass * (lab.tail_length**2 / 12.0 + (lab.root + lab.tail_com) ** 2)
    return lab.bare_inertia + tail + added_mass * float(arms @ arms)


def _friction(lab, w):
    return lab.coulomb * math.tanh(10.0 * w) + lab.viscous * w


def _count(lab, angle):
    return np.round(angle / lab.count) * lab.count


def _times(duration, rate):
    return np.arange(round(duration * rate) + 1) / rate


def _swing(lab, motion, start, duration, rate):
    time = _times(duration, rate)
    found = solve_ivp(
        motion, (0.0, time[-1]), start, "DOP853", time, rtol=1e-11, atol=1e-13, max_step=0.004
    )
    assert found.success, found.message
    return pd.DataFrame({"time_s": time, "angle_rad": _count(lab, found.y[0] - lab.encoder_zero)})


def _log(table, kind, extra):
    metadata = {"schema": "aerodima/run-log/1", "scenario": {}, "seed": 0, "versions": {}}
    metadata |= {"created": "", "kind": kind, "extra": extra}
    return run_log_from_metadata(table, metadata, f"other laboratory, {kind}")
