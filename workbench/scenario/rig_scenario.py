"""Scenario of a wind-tunnel rig: numbers of mount, motors, sensors, air and experiment.

A scenario file holds only what differs from `models/parameters/rig`; `load_rig_scenario` resolves
it. The robot's tail, its motor and friction, gravity and air are the same as on the car. Frame W:
origin at the force sensor's measuring point, z up, x along the motor axis, the wind blows towards
-y (design section 4).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.scenario.manoeuvre_parameters import EnvironmentParameters
from aerodima.workbench.scenario.scenario import Scenario
from aerodima.workbench.scenario.scenario_file import ScenarioFile
from aerodima.workbench.scenario.tail_parameters import (
    FrictionParameters,
    TailMotorParameters,
    TailParameters,
)

WRENCH_AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
"""Order of forces and torques."""
_COM = quantity("m", "coordinate of the centre of mass in W", "[-1, 1]")
_PIVOT = quantity("m", "coordinate of the pivot from the mount's centre of mass", "[-1, 1]")
_MOMENT = quantity("kg m2", "moment of inertia about the centre of mass, W axes", "(0, 10]")
_PRODUCT = quantity("kg m2", "element of the inertia matrix", "[-10, 10]")
_FORCE_OFFSET = quantity("N", "force to add to a reading", "[-1000, 1000]")
_TORQUE_OFFSET = quantity("N m", "torque to add to a reading", "[-100, 100]")
_FORCE_BIAS = quantity("N", "standard deviation of the constant bias of a log", "[0, 1000]")
_TORQUE_BIAS = quantity("N m", "standard deviation of the constant bias of a log", "[0, 100]")


class MountParameters(QuantityModel):
    """Mounting structure between force sensor and motor axis (thesis Tables 4.5 and 4.6)."""

    mass: float = quantity("kg", "mass of the mounting structure with the motor", "(0, 50]")
    com_x: float = _COM
    com_y: float = _COM
    com_z: float = _COM
    inertia_xx: float = _MOMENT
    inertia_yy: float = _MOMENT
    inertia_zz: float = _MOMENT
    inertia_xy: float = _PRODUCT
    inertia_xz: float = _PRODUCT
    inertia_yz: float = _PRODUCT
    pivot_x: float = _PIVOT
    pivot_y: float = _PIVOT
    pivot_z: float = _PIVOT
    angle_limit: float = quantity("rad", "range of the angle to either side", "(0, 3.1416]")


class BarParameters(QuantityModel):
    """Steel bar on the motor axis, carrying the tail (thesis Tables 4.5 and 4.6, section 4.6)."""

    mass: float = quantity("kg", "mass of the bar", "(0, 10]")
    com_distance: float = quantity("m", "distance of the centre of mass below the pivot", "(0, 2]")
    tail_distance: float = quantity(
        "m", "distance of the end of the bar, where the tail is mounted, below the pivot", "(0, 2]"
    )
    inertia_xx: float = quantity("kg m2", "moment of inertia about the centre of mass", "(0, 1]")
    inertia_yy: float = quantity("kg m2", "moment of inertia about the centre of mass", "(0, 1]")
    inertia_zz: float = quantity(
        "kg m2", "moment of inertia about the centre of mass, along the bar", "(0, 1]"
    )
    width: float = quantity("m", "width across the wind", "(0, 1]")
    drag_coefficient: float = quantity("1", "C_D of the part in the jet", "[0, 10]")


class CheetahTailParameters(QuantityModel):
    """A cheetah tail (thesis Table 4.2) and the readings at which the force sensor was zeroed with
    it (Table 4.4).
    """

    length: float = quantity("m", "length from root to tip", "(0, 3]")
    major_axis: float = quantity(
        "m", "mean major width; reference width of both orientations (ERRATA E2)", "(0, 1]"
    )
    minor_axis: float = quantity("m", "mean minor width", "(0, 1]")
    mass: float = quantity("kg", "mass of the tail", "(0, 5]")
    com_distance: float = quantity("m", "distance of the centre of mass beyond the root", "(0, 3]")
    gap: float = quantity("m", "distance of the root beyond the end of the bar", "[0, 0.5]")
    fx_offset: float = _FORCE_OFFSET
    fy_offset: float = _FORCE_OFFSET
    fz_offset: float = _FORCE_OFFSET
    tx_offset: float = _TORQUE_OFFSET
    ty_offset: float = _TORQUE_OFFSET
    tz_offset: float = _TORQUE_OFFSET

    @property
    def offsets(self) -> tuple[float, ...]:
        """F_x, F_y, F_z (N), T_x, T_y, T_z (N m) to add to a reading."""
        return tuple(getattr(self, f"{axis}_offset") for axis in WRENCH_AXES)


class MaxonParameters(QuantityModel):
    """Maxon DCX35L with its gearbox, driven by current (design section 6)."""

    torque_constant: float = quantity(
        "N m/A", "torque at the gearbox output per ampere, k_t N", "(0, 10]"
    )
    gear_ratio: float = quantity("1", "rotor turns per output turn", "[1, 1000]")
    reflected_inertia: float = quantity(
        "kg m2", "reflected inertia of the rotor, N^2 I_rotor, about the motor axis only", "[0, 1]"
    )
    current_limit: float = quantity("A", "largest current to either side", "(0, 200]")
    current_noise: float = quantity("A", "standard deviation of a logged current sample", "[0, 10]")


class RigEncoderParameters(QuantityModel):
    """Incremental encoder on the rotor (thesis section 4.7)."""

    pulses: int = quantity("1", "pulses per rotor turn", "[1, 100000]")
    quadrature: int = quantity("1", "counts per pulse", "[1, 4]")
    rate: float = quantity("Hz", "samples per second", "(0, 100000]")
    rate_window: float = quantity(
        "s", "time over which counts are subtracted for the rate", "(0, 1]"
    )


class TunnelParameters(QuantityModel):
    """The jet, and how the rig stands in it (design section 5, ERRATA E21)."""

    jet_edge_depth: float = quantity(
        "m", "depth of the upper edge of the jet below the pivot, h0", "[-2, 2]"
    )
    jet_slope: float = quantity(
        "1", "rise of the upper edge of the jet per metre downstream", "[-1, 1]"
    )
    psi3: float = quantity("rad", "wind direction from -y, turned about z", "[-0.5, 0.5]")
    misalignment: float = quantity(
        "rad", "angle of the tail's axis from the bar's, positive downstream", "[-0.5, 0.5]"
    )


class ForceSensorParameters(QuantityModel):
    """Axia80-M20 under the rig (thesis section 4.3, Table 4.8; errors: design section 11)."""

    rate: float = quantity("Hz", "samples per second", "(0, 100000]")
    fx_accuracy: float = _FORCE_BIAS
    fy_accuracy: float = _FORCE_BIAS
    fz_accuracy: float = _FORCE_BIAS
    tx_accuracy: float = _TORQUE_BIAS
    ty_accuracy: float = _TORQUE_BIAS
    tz_accuracy: float = _TORQUE_BIAS
    noise_fraction: float = quantity(
        "1", "standard deviation of a sample's noise over the accuracy of its axis", "[0, 10]"
    )
    drift_fraction: float = quantity(
        "1/s", "standard deviation of a log's drift over the accuracy of its axis", "[0, 1]"
    )
    force_range_xy: float = quantity("N", "largest F_x and F_y reading", "(0, 1e5]")
    force_range_z: float = quantity("N", "largest F_z reading", "(0, 1e5]")
    torque_range: float = quantity("N m", "largest torque reading", "(0, 1e4]")

    @property
    def accuracies(self) -> tuple[float, ...]:
        """Accuracies of F_x, F_y, F_z (N), T_x, T_y, T_z (N m)."""
        return tuple(getattr(self, f"{axis}_accuracy") for axis in WRENCH_AXES)

    @property
    def ranges(self) -> tuple[float, ...]:
        """Ranges of F_x, F_y, F_z (N), T_x, T_y, T_z (N m), to either side."""
        return (
            self.force_range_xy,
            self.force_range_xy,
            self.force_range_z,
            *(self.torque_range,) * 3,
        )


class RigUncertaintyParameters(QuantityModel):
    """Standard deviations of the rig's constants and of its instruments' errors, which every
    interval of a fit includes.

    A value of zero means that the constant is exact. `wind_speed`, `encoder_gain` and `force_gain`
    are relative to their value.
    """

    mount_mass: float = quantity("kg", "standard deviation of mount.mass", "[0, 1]")
    mount_com_x: float = quantity(
        "m", "standard deviation of mount.com_x, the pivot staying where it is", "[0, 0.1]"
    )
    mount_com_y: float = quantity(
        "m", "standard deviation of mount.com_y, the pivot staying where it is", "[0, 0.1]"
    )
    pivot_x: float = quantity(
        "m", "standard deviation of the pivot's x from the sensor's measuring point", "[0, 0.1]"
    )
    pivot_y: float = quantity(
        "m", "standard deviation of the pivot's y from the sensor's measuring point", "[0, 0.1]"
    )
    pivot_z: float = quantity(
        "m", "standard deviation of the pivot's height over the measuring point", "[0, 0.1]"
    )
    bar_mass: float = quantity("kg", "standard deviation of bar.mass", "[0, 1]")
    bar_com: float = quantity("m", "standard deviation of bar.com_distance", "[0, 0.1]")
    bar_inertia: float = quantity("kg m2", "standard deviation of bar.inertia_xx, yy", "[0, 0.1]")
    bar_width: float = quantity("m", "standard deviation of bar.width", "[0, 0.1]")
    bar_drag: float = quantity("1", "standard deviation of bar.drag_coefficient", "[0, 2]")
    tail_mass: float = quantity("kg", "standard deviation of the tail's mass", "[0, 1]")
    tail_com: float = quantity("m", "standard deviation of the tail's com_distance", "[0, 0.2]")
    tail_gap: float = quantity("m", "standard deviation of the tail's gap", "[0, 0.1]")
    tail_length: float = quantity("m", "standard deviation of the tail's length", "[0, 0.1]")
    tail_width: float = quantity(
        "m", "standard deviation of the tail's reference width", "[0, 0.1]"
    )
    rotor_inertia: float = quantity(
        "kg m2", "standard deviation of maxon.reflected_inertia", "[0, 0.1]"
    )
    torque_constant: float = quantity(
        "N m/A", "standard deviation of maxon.torque_constant", "[0, 1]"
    )
    jet_edge_depth: float = quantity("m", "standard deviation of tunnel.jet_edge_depth", "[0, 0.2]")
    wind_speed: float = quantity("1", "relative standard deviation of the wind speed", "[0, 0.2]")
    air_density: float = quantity(
        "kg/m3", "standard deviation of environment.air_density", "[0, 0.5]"
    )
    coulomb: float = quantity(
        "N m", "standard deviation of friction.coulomb, where it is not fitted", "[0, 1]"
    )
    viscous: float = quantity(
        "N m s/rad", "standard deviation of friction.viscous, where it is not fitted", "[0, 1]"
    )
    encoder_zero: float = quantity(
        "rad", "standard deviation of the angle at which the encoder reads zero", "[0, 0.5]"
    )
    encoder_gain: float = quantity(
        "1", "relative standard deviation of the encoder's scale", "[0, 0.2]"
    )
    current_bias: float = quantity(
        "A", "standard deviation of the bias of the logged current", "[0, 10]"
    )
    current_delay: float = quantity(
        "s", "standard deviation of the time by which the logged current comes late", "[0, 0.1]"
    )
    force_gain: float = quantity(
        "1", "relative standard deviation of the force sensor's scale", "[0, 0.2]"
    )


class RigAeroParameters(QuantityModel):
    """Coefficients of the tail under test (design section 5)."""

    source: Literal["published", "constant"] = quantity(
        "1", "source of the coefficients: tables in models/coefficients, or the constants here"
    )
    drag: float = quantity("1", "C_D with source constant", "[0, 10]")
    lift: float = quantity("1", "C_L with source constant, towards the root", "[-10, 10]")
    normal_force: float = quantity("1", "C_N of the robot tail with source constant", "[0, 10]")
    lift_blend: float = quantity(
        "rad", "angle of attack within which the lift changes sides; 0 jumps", "[0, 0.7]"
    )
    sections: int = quantity("1", "number of equal sections of the exposed length", "[1, 200]")
    added_mass: float = quantity(
        "kg", "added mass of each of five parts of the whole tail", "[-1, 10]"
    )


class ExperimentParameters(QuantityModel):
    """Experiment on the rig (thesis sections 4.4, 4.7 and 6.3)."""

    kind: Literal["static", "swing", "bar_swing", "robot_swing"] = quantity(
        "1", "experiment, as in the log's metadata"
    )
    tail: int = quantity("1", "number of the cheetah tail", "[1, 3]")
    axis: Literal["major", "minor"] = quantity(
        "1", "orientation of the tail: which width faces the wind"
    )
    wind_speed: float = quantity("m/s", "speed of the wind, towards -y", "[0, 40]")
    angle: float = quantity(
        "rad", "angle that is held, or from which a swing starts", "[-1.75, 1.75]"
    )
    target: float = quantity("rad", "angle to which a swing goes", "[-1.75, 1.75]")
    wind_off: float = quantity(
        "s", "time of rest without wind at the start of the log of a static hold", "[0, 60]"
    )
    rest: float = quantity("s", "time for which the start angle is held before a swing", "[0, 60]")
    duration: float = quantity("s", "length of the log", "(0, 600]")
    actuated: bool = quantity(
        "1", "true: the motor drives the tail to the target in a swing; false: it lets go"
    )
    kp: float = quantity("A/rad", "position gain of the current controller in a swing", "[0, 1000]")
    kd: float = quantity(
        "A s/rad", "velocity gain of the current controller in a swing", "[0, 1000]"
    )


class RobotRigParameters(QuantityModel):
    """The robot's tail on the rig (thesis section 6.3): the AK70-10 in place of Maxon and bar."""

    kp: float = quantity("N m/rad", "position gain of the AK70-10", "[0, 500]")
    kd: float = quantity("N m s/rad", "velocity gain of the AK70-10", "[0, 5]")
    command_rate: float = quantity(
        "Hz", "commands to the motor and replies per second", "(0, 10000]"
    )
    torque_constant: float = quantity("N m/A", "torque at the output per ampere", "(0, 10]")


class RigSimulationParameters(QuantityModel):
    """Numerics of the continuous plant."""

    step: float = quantity("s", "fixed step of the integrator", "[1e-5, 0.01]")
    log_rate: float = quantity("Hz", "rows per second in the log, at most 1/step", "(0, 20000]")


class RigScenario(ScenarioFile):
    """Resolved rig scenario, frozen. SI units and radians."""

    folder = "scenarios/rig"
    default_name = "rig"
    example = "experiment.wind_speed=20"
    rates = ("force_sensor.rate", "encoder.rate", "robot.command_rate", "simulation.log_rate")
    parameter_folder = "parameters/rig"
    shared_with_car: ClassVar = {
        "robot_tail": "tail",
        "robot_motor": "tail_motor",
        "robot_friction": "friction",
        "environment": "environment",
    }

    renamed: ClassVar = {"tunnel": {"kilter": "misalignment"}}
    retired: ClassVar = {"robot_tail": Scenario.retired["tail"]}

    schema_: Literal["aerodima/rig-scenario/1"] = Field("aerodima/rig-scenario/1", alias="schema")
    experiment: ExperimentParameters
    mount: MountParameters
    bar: BarParameters
    tail_1: CheetahTailParameters
    tail_2: CheetahTailParameters
    tail_3: CheetahTailParameters
    maxon: MaxonParameters
    encoder: RigEncoderParameters
    friction: FrictionParameters
    tunnel: TunnelParameters
    force_sensor: ForceSensorParameters
    uncertainty: RigUncertaintyParameters
    aero: RigAeroParameters
    robot: RobotRigParameters
    robot_tail: TailParameters
    robot_motor: TailMotorParameters
    robot_friction: FrictionParameters
    environment: EnvironmentParameters
    simulation: RigSimulationParameters

    @model_validator(mode="after")
    def _experiment_is_possible(self) -> "RigScenario":
        done = self.experiment
        tail = self.robot_tail
        shorter = f"< duration {done.duration:g} s"
        self._require_at_most("experiment.angle", "mount.angle_limit")
        self._require_at_most("experiment.target", "mount.angle_limit")
        if done.kind == "static":
            self._require(done.wind_off < done.duration, "experiment.wind_off", shorter)
        else:
            self._require(done.rest < done.duration, "experiment.rest", shorter)
            still = "0 s in a swing, which rests in the wind (experiment.rest)"
            self._require(done.wind_off == 0.0, "experiment.wind_off", still)
        if done.kind == "bar_swing":
            self._require(done.wind_speed == 0.0, "experiment.wind_speed", "0 m/s in a bar_swing")
        if self.tunnel.misalignment != 0.0:
            straight = "0 kg unless tunnel.misalignment is 0"
            self._require(self.aero.added_mass == 0.0, "aero.added_mass", straight)
        self._require(not tail.has_own_geometry, "robot_tail.geometry", "none, on a rig")
        self._require(tail.sail_shape == "built", "robot_tail.sail_shape", "built, on a rig")
        self._require(tail.added_mass == 0.0, "robot_tail.added_mass", "0 kg, see aero.added_mass")
        if self.is_robot:
            straight = "0 rad in a robot_swing"
            self._require(self.tunnel.misalignment == 0.0, "tunnel.misalignment", straight)
            self._require(done.actuated, "experiment.actuated", "true in a robot_swing")
        return self

    @property
    def has_cheetah_tail(self) -> bool:
        """Tells whether a cheetah tail is mounted: not on the bare bar, not on the robot's rig."""
        return self.experiment.kind in ("static", "swing")

    @property
    def is_robot(self) -> bool:
        """Tells whether the robot's tail and motor are on the rig."""
        return self.experiment.kind == "robot_swing"

    @property
    def cheetah_tail(self) -> CheetahTailParameters:
        """Cheetah tail of the experiment."""
        return (self.tail_1, self.tail_2, self.tail_3)[self.experiment.tail - 1]

    @property
    def joint_friction(self) -> FrictionParameters:
        """Friction of the swinging joint, either the bar's or that of the robot's motor."""
        return self.robot_friction if self.is_robot else self.friction

    @property
    def sensor_offsets(self) -> tuple[float, ...]:
        """Readings (6) at which the force sensor was zeroed, N and N m: add them to a reading.

        They are zero on the bare bar and with the robot's tail, for which none are published.
        """
        return self.cheetah_tail.offsets if self.has_cheetah_tail else (0.0,) * 6

    @property
    def count_angle(self) -> float:
        """Angle of one count of the encoder at the output, rad: 2 pi / (512 x 4 x 26) = 1.180e-4
        (ERRATA E19).
        """
        encoder = self.encoder
        return 2.0 * math.pi / (encoder.pulses * encoder.quadrature * self.maxon.gear_ratio)

    @property
    def tail_name(self) -> str:
        """Name of the tail in a log's metadata: `1`, `2`, `3`, `none` or `robot`."""
        if self.is_robot:
            return "robot"
        if self.has_cheetah_tail:
            return str(self.experiment.tail)
        return "none"


rig_scenario_from_dict = RigScenario.from_dict


def load_rig_scenario(name_or_path: str | Path, settings: Sequence[str] = ()) -> RigScenario:
    """Loads a scenario of a rig; arguments and errors are those of `ScenarioFile.load`."""
    return RigScenario.load(name_or_path, settings)
