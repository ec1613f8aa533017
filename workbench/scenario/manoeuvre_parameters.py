"""The manoeuvre of a scenario, its air and its numerics."""

from typing import Literal

from aerodima.workbench.core.quantity import QuantityModel, quantity


class EnvironmentParameters(QuantityModel):
    """Gravity and air."""

    gravity: float = quantity("m/s2", "gravitational acceleration", "[0, 30]")
    air_density: float = quantity("kg/m3", "air density", "(0, 10]")
    air_viscosity: float = quantity("kg/(m s)", "dynamic viscosity of the air", "(0, 1e-3]")


class WindParameters(QuantityModel):
    """Motion of the air over the ground, everywhere the same: mean, gust and turbulence, in world
    axes.

    The car starts along +x. Its tail and the bodies of `car.bodies` feel the wind.
    """

    mean_x: float = quantity(
        "m/s", "steady wind towards the car's first heading: a tail wind", "[-40, 40]"
    )
    mean_y: float = quantity(
        "m/s", "steady wind towards the left of the car's first heading", "[-40, 40]"
    )
    mean_z: float = quantity("m/s", "steady wind upwards", "[-40, 40]")
    gust_amplitude: float = quantity(
        "m/s", "amplitude of the sinusoidal gust, which starts at zero", "[0, 40]"
    )
    gust_period: float = quantity("s", "period of the gust", "(0, 600]")
    gust_direction: float = quantity(
        "rad", "direction to which a gust's first half blows, from x towards y", "[-3.1416, 3.1416]"
    )
    turbulence: float = quantity(
        "m/s", "standard deviation of the filtered noise in each axis", "[0, 20]"
    )
    turbulence_time_constant: float = quantity(
        "s", "time constant of the first-order filter of the turbulence's noise", "(0, 60]"
    )

    @property
    def is_still(self) -> bool:
        """Tell whether the air stands still."""
        return not any(
            (self.mean_x, self.mean_y, self.mean_z, self.gust_amplitude, self.turbulence)
        )


class ManoeuvreParameters(QuantityModel):
    """Task of the car (design section 10)."""

    kind: Literal[
        "turn", "auto_turn", "levels", "straight", "slalom", "fishhook", "path", "rising"
    ] = quantity("1", "kind of manoeuvre: simulated turn, AUTO sequence, ...")
    speed: float = quantity("m/s", "commanded speed", "[0, 30]")
    rolling_start: bool = quantity(
        "1", "true: the car begins at the commanded speed, straight ahead; false: at rest"
    )
    direction: Literal["left", "right"] = quantity("1", "side of the turn")
    steer_angle: float = quantity("rad", "commanded steering angle of the turn", "[0, 1.2]")
    first_angle: float = quantity(
        "rad", "other steering angle at the beginning of a simulated turn", "[0, 1.2]"
    )
    first_hold: float = quantity("s", "part of turn_hold that has first_angle; 0: none", "[0, 60]")
    level_1: float = quantity("rad", "first of the angles that kind levels holds", "[-1.2, 1.2]")
    level_2: float = quantity("rad", "second of the angles that kind levels holds", "[-1.2, 1.2]")
    level_3: float = quantity(
        "rad", "last of the angles that kind levels holds, until turn_hold", "[-1.2, 1.2]"
    )
    level_1_end: float = quantity("s", "end of the first level, from its start on", "[0, 60]")
    level_2_end: float = quantity(
        "s", "end of the second level, from the start of the first one on", "[0, 60]"
    )
    trim_angle: float = quantity(
        "rad", "angle into the turn that kind levels holds before turn_start", "[-1.2, 1.2]"
    )
    speed_ramp: float = quantity("s", "time in which the commanded speed is ramped up", "(0, 60]")
    turn_start: float = quantity(
        "s", "time of the steering command in a simulated turn", "[0, 600]"
    )
    turn_hold: float = quantity(
        "s", "time for which the steering command lasts; in a fishhook the second angle", "(0, 60]"
    )
    turns: int = quantity(
        "1", "number of steering steps of a simulated turn, all to one side", "[1, 20]"
    )
    turn_gap: float = quantity(
        "s", "time of straight driving between two steering steps", "[0, 60]"
    )
    counter_roll_rate: float = quantity(
        "rad/s", "outward roll rate below which a fishhook is counter-steered", "(0, 10]"
    )
    steer_rate: float = quantity("rad/s", "growth rate of a rising steering angle", "(0, 10]")
    path: Literal["lane_change", "corner"] = quantity("1", "path that kind path drives")
    corner_radius: float = quantity("m", "radius of the centre line of a corner", "(0.05, 100]")
    corner_width: float = quantity("m", "width of the lane of a corner", "(0.05, 20]")
    driver_preview: float = quantity(
        "s", "time by which the driver of a path looks ahead", "(0, 10]"
    )
    driver_correction: float = quantity(
        "1", "share of the missing curvature that the driver of a path adds", "[0, 10]"
    )
    driver_lag: float = quantity(
        "s", "time constant with which the driver of a path notices missing curvature", "[0, 10]"
    )
    driver_delay: float = quantity("s", "reaction time of the driver of a path", "[0, 1]")
    driver_rate: float = quantity(
        "rad/s", "steering rate of the hands of the driver of a path, at the wheels", "(0, 100]"
    )
    duration: float = quantity("s", "length of a run other than the AUTO sequence", "(0, 600]")
    slalom_period: float = quantity("s", "period of the sinusoidal steering", "(0, 60]")
    straight_time: float = quantity(
        "s", "time of straight driving before the turn of the AUTO sequence", "[0, 600]"
    )
    wait_after_turn: float = quantity(
        "s", "time of straight driving after the AUTO sequence's turn, before throttle 0", "[0, 60]"
    )
    log_end: float = quantity("s", "end of the AUTO sequence", "(0, 600]")


class SimulationParameters(QuantityModel):
    """Numerics of the discrete plant (design sections 7 and 13)."""

    step: float = quantity("s", "step of the plant", "[1e-5, 0.01]")
    log_rate: float = quantity("Hz", "rows per second in the run log, at most 1/step", "(0, 20000]")
