"""Sections of a scenario: every physical number of the car, its tail, its actuators and its
sensors.

The values live in `models/parameters/<section>.yaml`, each with unit and source; the classes here
hold name, unit and allowed range only. Frames and signs: design section 4.
"""

import math
from typing import Literal, NamedTuple

from pydantic import model_validator

from aerodima.workbench.core.checked_files import (
    CONSTANT,
    QuantityModel,
    nearest,
    quantity,
    require_coefficient_name,
)

NO_GEOMETRY = "none"
"""Word for a tail that the numbers of `TailParameters` describe: one straight rod with one sail at
its tip."""
SHELL_DEPTH = 0.5
"""Depth of a half cylinder over its width."""
BUILT = "built"


class CarParameters(QuantityModel):
    """Chassis, wheels, tyres and suspension of the car without its tail arm (design section 7)."""

    mass: float = quantity(
        "kg", "whole car without the tail arm, gearbox and wheels included", gt=0, le=30
    )
    com_height: float = quantity(
        "m", "centre of mass of that car above the ground at nominal ride height", gt=0, le=1
    )
    com_x: float = quantity(
        "m", "centre of mass of that car ahead of the rear axle", ge=-0.2, le=0.5
    )
    gyration_roll: float = quantity(
        "m", "radius of gyration of the sprung body about its x axis", gt=0, le=0.5
    )
    gyration_pitch: float = quantity(
        "m", "radius of gyration of the sprung body about its y axis", gt=0, le=0.5
    )
    gyration_yaw: float = quantity(
        "m", "radius of gyration of the sprung body about its z axis", gt=0, le=0.5
    )
    wheelbase: float = quantity("m", "distance between the axles", gt=0.05, le=2)
    track: float = quantity("m", "distance between the wheel centres of one axle", gt=0.05, le=2)
    tyre_radius: float = quantity("m", "unloaded tyre radius", gt=0.01, le=0.5)
    tyre_width: float = quantity("m", "tyre width", gt=0.005, le=0.3)
    tyre_shape: Literal["cylinder", "ellipsoid"] = quantity(
        "1", "contact shape of a tyre of this width"
    )
    wheel_mass: float = quantity("kg", "one wheel with its tyre", gt=0, le=2)
    upright_mass: float = quantity(
        "kg", "moving part of one suspension without wheel and knuckle", gt=0, le=2
    )
    knuckle_mass: float = quantity("kg", "one steered front knuckle", gt=0, le=2)
    tyre_stiffness_front: float = quantity(
        "N/m", "radial stiffness of one front tyre", gt=0, le=1e7
    )
    tyre_stiffness_rear: float = quantity("N/m", "radial stiffness of one rear tyre", gt=0, le=1e7)
    tyre_dissipation: float = quantity("s/m", "Hunt-Crossley dissipation of the tyres", ge=0, le=10)
    tyre_friction: float = quantity(
        "1", "Coulomb friction coefficient between tyre and ground", gt=0, le=2
    )
    tyre_slip_angle: float = quantity(
        "rad", "friction over cornering stiffness per load; 0: rigid", ge=0, le=0.5
    )
    suspension_stiffness_front: float = quantity(
        "N/m", "spring rate of one front suspension unit", gt=0, le=1e6
    )
    suspension_stiffness_rear: float = quantity(
        "N/m", "spring rate of one rear suspension unit", gt=0, le=1e6
    )
    suspension_damping_front: float = quantity(
        "N s/m", "damping of one front suspension unit", ge=0, le=1e5
    )
    suspension_damping_rear: float = quantity(
        "N s/m", "damping of one rear suspension unit", ge=0, le=1e5
    )
    suspension_motion_ratio: float = quantity(
        "1", "travel of a suspension unit over that of its wheel", gt=0.1, le=1
    )
    rolling_resistance: float = quantity(
        "1", "force against rolling over load, at every wheel", ge=0, le=0.3
    )
    suspension_travel: float = quantity(
        "m", "travel to either side of the nominal ride height", gt=0, le=0.2
    )
    cage_friction: float = quantity(
        "1", "friction coefficient of cage, board and tail on the ground", ge=0, le=2
    )
    gearbox_x: float = quantity(
        "m", "middle of the gearbox ahead of the rear axle", ge=-0.5, le=0.5
    )
    gearbox_mass: float = quantity("kg", "tail gearbox with both motors", gt=0, le=10)
    gearbox_width: float = quantity("m", "gearbox along y", gt=0, le=1)
    gearbox_length: float = quantity("m", "gearbox along x", gt=0, le=1)
    gearbox_height: float = quantity("m", "gearbox along z", gt=0, le=1)

    board: bool = quantity("1", "true: anti-ramp board at the rear; false: none")
    board_x: float = quantity("m", "rear edge of that board ahead of the rear axle", ge=-0.5, le=0)
    board_height: float = quantity(
        "m", "its lower face above the ground at nominal ride height", gt=0, le=0.5
    )
    board_length: float = quantity("m", "board along x", gt=0, le=0.5)
    board_width: float = quantity("m", "board along y", gt=0, le=1)
    board_thickness: float = quantity("m", "board along z", gt=0, le=0.05)
    board_mass: float = quantity("kg", "board, part of the mass of the car", gt=0, le=1)

    @model_validator(mode="after")
    def _gyration_is_physical(self) -> "CarParameters":
        radii = {name: getattr(self, f"gyration_{name}") for name in ("roll", "pitch", "yaw")}
        for name, radius in radii.items():
            most = math.sqrt(sum(other**2 for other in radii.values()) - radius**2)
            if radius > most * (1 + 1e-9):
                raise ValueError(
                    f"gyration_{name}: {radius:g} m; allowed: <= {most:g} m, so that the inertia "
                    "is physical"
                )
        return self

    @property
    def outer_half_track(self) -> float:
        """Distance (m) from the car's middle to the line under its outer tyres once it leans."""
        return self.track / 2 + (self.tyre_width / 2 if self.tyre_shape == "cylinder" else 0.0)


class SailShape(NamedTuple):
    """One of the shapes of thesis 5.2, as far as the text has it.

    Attributes:
        depth: of the shell over its width.
        board: whether a backing board stands behind it.
        coefficients: embedded set of Table 2.1 for it; None where the thesis has its coefficient in
            a picture only.
    """

    depth: float
    board: bool
    coefficients: str | None


SAIL_SHAPES = {
    "built": SailShape(SHELL_DEPTH, True, None),
    "flat": SailShape(0.0, False, "flat_plate"),
    "flat_board": SailShape(0.0, True, "flat_plate"),
    "half_cylinder": SailShape(SHELL_DEPTH, False, "half_cylinder"),
    "half_cylinder_board": SailShape(SHELL_DEPTH, True, "half_cylinder"),
    "half_cylinder_caps": SailShape(SHELL_DEPTH, False, "half_cylinder"),
    "half_cylinder_caps_board": SailShape(SHELL_DEPTH, True, "half_cylinder"),
    "disc_gap_band": SailShape(SHELL_DEPTH, True, None),
    "disc_gap_band_taper": SailShape(SHELL_DEPTH, True, None),
}
"""The built sail (a half cylinder with caps and board, with the coefficient of the published model)
and eight shapes of the flow simulation: FT, HC and HCEC each without and with backing board, and
two after parachutes."""


class TailParameters(QuantityModel):
    """The tail arm: pitch joint, roll joint, rod and sail (thesis chapters 5 and 6.3)."""

    name: str = quantity(
        "1", "which tail it is: built, or the name of a design", min_length=1, max_length=40
    )
    mode: Literal["none", "held", "swing"] = quantity(
        "1", "no tail arm, arm held on the inside, arm swung"
    )
    length: float = quantity("m", "roll axis to tip", gt=0.05, le=3)
    mass: float = quantity("kg", "rod and sail together", gt=0, le=5)
    sail_mass_fraction: float = quantity("1", "share of that mass in the sail", gt=0, lt=1)
    sail_length: float = quantity("m", "sail along the tail, ending at the tip", gt=0.01, le=3)
    sail_width: float = quantity("m", "sail across the tail", gt=0.005, le=2)
    hub_mass: float = quantity("kg", "moving part of the pitch joint", gt=0, le=2)
    mount_x: float = quantity("m", "tail joints ahead of the rear axle", ge=-0.5, le=0.5)
    mount_height: float = quantity("m", "tail joints above the ground", gt=0, le=1)
    coefficients: str = quantity(
        "1", "of the sail: constant, an embedded set, or the path of a coefficient file"
    )
    normal_force_coefficient: float = quantity(
        "1", "C_N with shape built and coefficients constant", ge=0, le=10
    )
    sail: Literal["facing", "free", "locked"] = quantity(
        "1", "facing the wind, free to turn, or locked"
    )
    sail_shape: str = quantity(
        "1", "shape of the sail: depth, board, and with coefficients constant its C_N"
    )
    sail_shell_offset: float = quantity(
        "1", "of a free sail's shell behind its bearing, over sail_width", ge=-1, le=1
    )
    sail_board_share: float = quantity(
        "1", "backing board of a free sail, along the wind, over sail_width", gt=0, le=5
    )
    sail_side_coefficient: float = quantity(
        "1", "C_N of a free sail's shell and board across the wind", ge=0, le=10
    )
    sail_bearing_damping: float = quantity(
        "N m s/rad", "damping of a free sail's bearing", ge=0, le=1
    )
    added_mass: float = quantity(
        "kg", "added mass of the air on each of five parts of the tail", ge=-1, le=10
    )
    sections: int = quantity("1", "number of equal sections of the sail", ge=1, le=100)
    geometry: str = quantity(
        "1", "none, or the path of a tail file, whose shape and mass stand in place of those here"
    )
    roll_limit: float = quantity(
        "rad", "tail roll that may be commanded, to either side", gt=0, le=3.1416
    )
    roll_stop: float = quantity(
        "rad", "mechanical stop of the roll joint; 3.1416: none", gt=0, le=3.1416
    )
    pitch_limit: float = quantity("rad", "tail pitch range to either side", gt=0, le=3.1416)

    @property
    def shell_share(self) -> float:
        """Depth of the sail's shell over its width."""
        return SAIL_SHAPES[self.sail_shape].depth

    @property
    def board_share(self) -> float:
        """Backing board along the wind over the sail's width; 0 for a shape without."""
        return self.sail_board_share if SAIL_SHAPES[self.sail_shape].board else 0.0

    @property
    def sail_front(self) -> float:
        """Plane of the sail's opening ahead of the bearing, m; the board ends `sail_depth` behind
        that plane.
        """
        return (self.shell_share / 2 - self.sail_shell_offset) * self.sail_width

    @property
    def sail_depth(self) -> float:
        """Shell and board together along the wind, m."""
        return (self.shell_share + self.board_share) * self.sail_width

    @property
    def sail_reach(self) -> float:
        """Radius of the cylinder that the sail sweeps when it turns on its bearing, m."""
        return max(
            math.hypot(self.sail_width / 2, self.sail_front), self.sail_depth - self.sail_front
        )

    @model_validator(mode="after")
    def _air_is_known(self) -> "TailParameters":
        require_coefficient_name(self.coefficients)
        shape = SAIL_SHAPES.get(self.sail_shape)
        if shape is None:
            raise ValueError(
                f"sail_shape: {self.sail_shape!r} is not allowed; "
                f"{nearest(self.sail_shape, SAIL_SHAPES)}"
            )
        if (
            self.sail_shape != BUILT
            and shape.coefficients is None
            and self.coefficients == CONSTANT
        ):
            raise ValueError(
                f"sail_shape: {self.sail_shape!r} has its coefficient in a picture of the thesis "
                "only (Fig. 5.7); allowed: with tail.coefficients a set or a file"
            )
        if self.sail == "free" and not shape.board:
            raise ValueError(
                f"sail: 'free'; allowed: facing, locked with the shape {self.sail_shape!r}: it "
                "has no board"
            )
        return self

    @property
    def has_own_geometry(self) -> bool:
        """Whether a tail file gives shape and mass."""
        return self.geometry != NO_GEOMETRY

    @model_validator(mode="after")
    def _geometry_is_locked(self) -> "TailParameters":
        if not self.has_own_geometry:
            return self
        if not self.geometry.endswith((".yaml", ".yml")):
            raise ValueError(
                f"geometry: {self.geometry!r}; allowed: {NO_GEOMETRY}, or a tail file (.yaml, .yml)"
            )
        if self.sail != "locked":
            raise ValueError(
                f"sail: {self.sail!r}; allowed: locked, with tail.geometry {self.geometry}"
            )
        return self


class TailMotorParameters(QuantityModel):
    """T-Motor AK70-10 in MIT mode, one for pitch and one for roll (design sections 6 and 14)."""

    torque_limit: float = quantity("N m", "peak torque at the output", gt=0, le=200)
    kp_max: float = quantity("N m/rad", "largest position gain of the MIT frame", gt=0, le=500)
    kd_max: float = quantity("N m s/rad", "largest velocity gain of the MIT frame", gt=0, le=5)
    position_range: float = quantity(
        "rad", "largest position of the MIT frame to either side", gt=0, le=100
    )
    speed_range: float = quantity(
        "rad/s", "largest speed of the MIT frame to either side", gt=0, le=200
    )
    rotor_inertia: float = quantity("kg m2", "rotor inertia before the gearbox", gt=0, le=0.01)
    gear_ratio: float = quantity("1", "rotor turns per output turn", ge=1, le=200)
    speed_constant: float = quantity("rad/s/V", "no-load rotor speed per volt", gt=0, le=1000)
    winding_resistance: float = quantity(
        "ohm", "resistance that the torque-speed line is built with", gt=0, le=10
    )
    pack_voltage: float = quantity("V", "voltage of the tail battery", ge=24, le=48)
    torque_error: float = quantity(
        "1", "relative error of the torque that a command gives", gt=-1, le=1
    )


class FrictionParameters(QuantityModel):
    """Joint friction of the robot tail (thesis eq. 4.12 with the right sign, ERRATA E14, E15; Table
    6.2).
    """

    coulomb: float = quantity("N m", "Coulomb friction torque", ge=0, le=10)
    viscous: float = quantity("N m s/rad", "viscous friction", ge=0, le=10)
    tanh_gain: float = quantity(
        "s/rad", "gain inside tanh of the smoothed Coulomb friction", gt=0, le=1000
    )


class ServoParameters(QuantityModel):
    """Steering servo, rate limited (thesis 7.1.1)."""

    rate: float = quantity("rad/s", "steering rate at the road wheels", gt=0, le=100)
    limit: float = quantity("rad", "largest steering angle to either side", gt=0, le=1.2)
    linkage: Literal["parallel", "ackermann"] = quantity(
        "1", "both wheels at the steering angle, or about one centre"
    )
    frame_rate: float = quantity("Hz", "rate at which the servo reads its command", gt=0, le=2000)
    stiffness: float = quantity("N m/rad", "position gain at each front knuckle", gt=0, le=1e4)
    damping: float = quantity("N m s/rad", "velocity gain at each front knuckle", ge=0, le=1e3)
    torque_limit: float = quantity(
        "N m", "largest steering torque at each front knuckle", gt=0, le=100
    )


class DriveParameters(QuantityModel):
    """Brushless drive on the rear differential (design section 6)."""

    governor: bool = quantity(
        "1", "true: holds the wheel speed; false: throttle frozen, speed droops with load"
    )
    throttle_gain: float = quantity("m/s", "steady speed per unit throttle", gt=0, le=100)
    throttle_offset: float = quantity(
        "m/s", "steady speed at zero throttle of the fitted line", ge=-5, le=5
    )
    breakaway_throttle: float = quantity(
        "1", "throttle below which the car without governor stands", ge=0, lt=1
    )
    governor_gain: float = quantity(
        "N m s/rad", "torque per shaft-speed error with governor", gt=0, le=100
    )
    time_constant: float = quantity(
        "s", "speed response of the whole car without governor", gt=0.01, le=20
    )
    torque_limit: float = quantity("N m", "largest torque on the rear axle", gt=0, le=100)
    rotor_inertia: float = quantity(
        "kg m2", "motor and gear train reflected to the axle", gt=0, le=1
    )


class ImuParameters(QuantityModel):
    """BNO055 inertial measurement unit."""

    rate: float = quantity("Hz", "sampling rate", gt=0, le=10000)
    delay: float = quantity("s", "age of a sample when it appears", ge=0, le=1)
    x: float = quantity("m", "position ahead of the rear axle", ge=-1, le=1)
    z: float = quantity("m", "height above the ground", ge=0, le=1)
    gyro_noise: float = quantity("rad/s", "standard deviation of a gyro sample", ge=0, le=10)
    gyro_bias: float = quantity(
        "rad/s", "standard deviation of the constant bias of a run", ge=0, le=10
    )
    accelerometer_noise: float = quantity(
        "m/s2", "standard deviation of an acceleration sample", ge=0, le=100
    )
    attitude_noise: float = quantity("rad", "standard deviation of an attitude sample", ge=0, le=1)


class GpsParameters(QuantityModel):
    """Ground speed from the C94-M8P receiver."""

    rate: float = quantity("Hz", "sampling rate", gt=0, le=1000)
    delay: float = quantity("s", "age of a sample when it appears", ge=0, le=5)
    noise: float = quantity("m/s", "standard deviation of a speed sample", ge=0, le=10)


class SailEncoderParameters(QuantityModel):
    """Absolute encoder of the sail joint, at the microcontroller (thesis 5.4.5; ERRATA E30)."""

    rate: float = quantity("Hz", "rate at which the reading reaches the station", gt=0, le=10000)
    delay: float = quantity("s", "age of a sample when it appears", ge=0, le=1)
    bits: int = quantity("1", "word length", ge=4, le=20)
    noise: float = quantity(
        "rad", "standard deviation of the angle before quantisation", ge=0, le=0.1
    )


class EnvironmentParameters(QuantityModel):
    """Gravity and air."""

    gravity: float = quantity("m/s2", "gravitational acceleration", ge=0, le=30)
    air_density: float = quantity("kg/m3", "air density", gt=0, le=10)
    air_viscosity: float = quantity("kg/(m s)", "dynamic viscosity of the air", gt=0, le=1e-3)


class WindParameters(QuantityModel):
    """Motion of the air over the ground, everywhere the same: mean, gust and turbulence, in world
    axes.

    The car starts along +x. Only its tail feels the wind.
    """

    mean_x: float = quantity(
        "m/s", "steady wind towards the car's first heading: a tail wind", ge=-40, le=40
    )
    mean_y: float = quantity("m/s", "steady wind towards the left of that heading", ge=-40, le=40)
    mean_z: float = quantity("m/s", "steady wind upwards", ge=-40, le=40)
    gust_amplitude: float = quantity(
        "m/s", "amplitude of the sinusoidal gust, which starts at zero", ge=0, le=40
    )
    gust_period: float = quantity("s", "period of the gust", gt=0, le=600)
    gust_direction: float = quantity(
        "rad", "where its first half blows to, from x towards y", ge=-3.1416, le=3.1416
    )
    turbulence: float = quantity(
        "m/s", "standard deviation of the filtered noise in each axis", ge=0, le=20
    )
    turbulence_time_constant: float = quantity(
        "s", "of the first-order filter of that noise", gt=0, le=60
    )

    @property
    def is_still(self) -> bool:
        """Whether the air stands still."""
        return not any(
            (self.mean_x, self.mean_y, self.mean_z, self.gust_amplitude, self.turbulence)
        )


class ControllerParameters(QuantityModel):
    """Tail controller of thesis Table 6.4, read with ERRATA E28 (design section 8); the same
    numbers for both sides.
    """

    rate: float = quantity("Hz", "controller rate", gt=0, le=10000)
    hold_angle: float = quantity(
        "rad", "tail roll at rest, towards the inside of the turn", gt=0, le=3.1416
    )
    hold_kp: float = quantity("N m/rad", "position gain of the hold", ge=0, le=500)
    hold_kd: float = quantity("N m s/rad", "velocity gain of the hold", ge=0, le=5)
    swing_speed: float = quantity("rad/s", "commanded roll rate of the swing", gt=0, le=50)
    swing_kp: float = quantity("N m/rad", "position gain of the swing", ge=0, le=500)
    swing_kd: float = quantity("N m s/rad", "velocity gain of the swing", ge=0, le=5)
    settle_kp: float = quantity("N m/rad", "position gain at the end of the swing", ge=0, le=500)
    settle_kd: float = quantity("N m s/rad", "velocity gain at the end of the swing", ge=0, le=5)
    trigger: Literal["yaw_rate", "lateral_acceleration", "steering"] = quantity(
        "1", "what starts the swing"
    )
    trigger_yaw_rate: float = quantity(
        "rad/s", "yaw rate into the planned turn that starts the swing", gt=0, le=100
    )
    trigger_lateral_acceleration: float = quantity(
        "m/s2", "of the IMU into the turn that starts it", gt=0, le=100
    )
    trigger_steering_angle: float = quantity(
        "rad", "steering command into the turn that does", gt=0, le=1.2
    )
    delay: float = quantity("s", "wait between trigger and swing", ge=0, le=10)
    travel: float = quantity(
        "rad", "roll travel after which position control takes over", gt=0, le=6.3
    )
    recock_speed: float = quantity(
        "rad/s", "roll rate of the slow return before the next turn", gt=0, le=50
    )
    pitch_angle: float = quantity(
        "rad", "tail pitch that is held all the time", ge=-3.1416, le=3.1416
    )
    swing_file: str = quantity(
        "1", "swing that is played: none (the law above), a name in models/swings, or a path"
    )
    law: Literal["swing", "feedback"] = quantity(
        "1", "the thesis' law or swing_file, or that of section feedback"
    )


class FeedbackParameters(QuantityModel):
    """Tail law that follows the state of the car (`control.feedback_law`, design section 8)."""

    lean_gain: float = quantity("rad", "roll of the tail at the limit of the floor", ge=-10, le=10)
    roll_gain: float = quantity("1", "roll of the tail per roll of the car", ge=-100, le=100)
    roll_rate_gain: float = quantity(
        "s", "roll of the tail per roll rate of the car", ge=-10, le=10
    )
    yaw_rate_gain: float = quantity(
        "s", "roll of the tail per yaw rate beyond that of the steering", ge=-10, le=10
    )
    grip: float = quantity(
        "m/s2", "lateral acceleration at which the prediction saturates", gt=0, le=30
    )
    most_roll: float = quantity("rad", "largest roll of the tail to either side", gt=0, le=3.1416)
    out_speed: float = quantity(
        "rad/s", "roll rate of the reference towards a larger lean", gt=0, le=50
    )
    return_speed: float = quantity("rad/s", "roll rate of the reference otherwise", gt=0, le=50)
    kp: float = quantity("N m/rad", "position gain of the roll motor", ge=0, le=500)
    kd: float = quantity("N m s/rad", "velocity gain of the roll motor", ge=0, le=5)
    pitch_angle: float = quantity("rad", "pitch at which the tail is held", ge=-1.5708, le=1.5708)


class ManoeuvreParameters(QuantityModel):
    """What the car is asked to do (design section 10)."""

    kind: Literal["turn", "auto_turn", "straight", "slalom", "fishhook", "path", "rising"] = (
        quantity("1", "simulated turn, AUTO sequence, ...")
    )
    speed: float = quantity("m/s", "commanded speed", ge=0, le=30)
    rolling_start: bool = quantity(
        "1", "true: the car begins at that speed, straight ahead; false: at rest"
    )
    direction: Literal["left", "right"] = quantity("1", "side of the turn")
    steer_angle: float = quantity("rad", "commanded steering angle of the turn", ge=0, le=1.2)
    first_angle: float = quantity(
        "rad", "another angle at the beginning of a simulated turn", ge=0, le=1.2
    )
    first_hold: float = quantity("s", "how much of turn_hold has that angle; 0: none", ge=0, le=60)
    speed_ramp: float = quantity("s", "time in which the commanded speed is ramped up", gt=0, le=60)
    turn_start: float = quantity(
        "s", "time of the steering command in a simulated turn", ge=0, le=600
    )
    turn_hold: float = quantity(
        "s", "how long the steering command lasts; in a fishhook the second angle", gt=0, le=60
    )
    turns: int = quantity(
        "1", "how many steps of steering a simulated turn has, all to one side", ge=1, le=20
    )
    turn_gap: float = quantity("s", "straight driving between two of them", ge=0, le=60)
    counter_roll_rate: float = quantity(
        "rad/s", "outward roll below which a fishhook is counter-steered", gt=0, le=10
    )
    steer_rate: float = quantity("rad/s", "growth of a rising steering angle", gt=0, le=10)
    path: Literal["lane_change", "corner"] = quantity("1", "what is driven by kind path")
    corner_radius: float = quantity("m", "of the centre line of a corner", gt=0.05, le=100)
    corner_width: float = quantity("m", "of the lane of a corner", gt=0.05, le=20)
    driver_preview: float = quantity("s", "how far ahead the driver of a path looks", gt=0, le=10)
    driver_correction: float = quantity(
        "1", "share of missing curvature that driver adds", ge=0, le=10
    )
    driver_lag: float = quantity(
        "s", "time constant with which that driver notices it", ge=0, le=10
    )
    driver_delay: float = quantity("s", "reaction time of that driver", ge=0, le=1)
    driver_rate: float = quantity(
        "rad/s", "steering rate of that driver's hands, at the wheels", gt=0, le=100
    )
    duration: float = quantity("s", "length of a run other than the AUTO sequence", gt=0, le=600)
    slalom_period: float = quantity("s", "period of the sinusoidal steering", gt=0, le=60)
    straight_time: float = quantity(
        "s", "straight driving before the turn of the AUTO sequence", ge=0, le=600
    )
    wait_after_turn: float = quantity(
        "s", "straight driving after that turn before throttle 0", ge=0, le=60
    )
    log_end: float = quantity("s", "end of the AUTO sequence", gt=0, le=600)


class SimulationParameters(QuantityModel):
    """Numerics of the discrete plant (design sections 7 and 13)."""

    step: float = quantity("s", "step of the plant", gt=0, le=0.01)
    log_rate: float = quantity(
        "Hz", "rows per second in the run log, at most 1/step", gt=0, le=20000
    )
