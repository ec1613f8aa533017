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
    mean_y: float = quantity("m/s", "steady wind towards the left of that heading", "[-40, 40]")
    mean_z: float = quantity("m/s", "steady wind upwards", "[-40, 40]")
    gust_amplitude: float = quantity(
        "m/s", "amplitude of the sinusoidal gust, which starts at zero", "[0, 40]"
    )
    gust_period: float = quantity("s", "period of the gust", "(0, 600]")
    gust_direction: float = quantity(
        "rad", "where its first half blows to, from x towards y", "[-3.1416, 3.1416]"
    )
    turbulence: float = quantity(
        "m/s", "standard deviation of the filtered noise in each axis", "[0, 20]"
    )
    turbulence_time_constant: float = quantity(
        "s", "of the first-order filter of that noise", "(0, 60]"
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
    ] = quantity("1", "simulated turn, AUTO sequence, ...")
    speed: float = quantity("m/s", "commanded speed", "[0, 30]")
    rolling_start: bool = quantity(
        "1", "true: the car begins at that speed, straight ahead; false: at rest"
    )
    direction: Literal["left", "right"] = quantity("1", "side of the turn")
    steer_angle: float = quantity("rad", "commanded steering angle of the turn", "[0, 1.2]")
    first_angle: float = quantity(
        "rad", "another angle at the beginning of a simulated turn", "[0, 1.2]"
    )
    first_hold: float = quantity("s", "how much of turn_hold has that angle; 0: none", "[0, 60]")
    level_1: float = quantity("rad", "first of the angles that kind levels holds", "[-1.2, 1.2]")
    level_2: float = quantity("rad", "second of these angles", "[-1.2, 1.2]")
    level_3: float = quantity("rad", "last of these angles, until turn_hold", "[-1.2, 1.2]")
    level_1_end: float = quantity("s", "end of the first level, from its start on", "[0, 60]")
    level_2_end: float = quantity("s", "end of the second level, from that start on", "[0, 60]")
    trim_angle: float = quantity(
        "rad", "angle into the turn that kind levels holds before turn_start", "[-1.2, 1.2]"
    )
    speed_ramp: float = quantity("s", "time in which the commanded speed is ramped up", "(0, 60]")
    turn_start: float = quantity(
        "s", "time of the steering command in a simulated turn", "[0, 600]"
    )
    turn_hold: float = quantity(
        "s", "how long the steering command lasts; in a fishhook the second angle", "(0, 60]"
    )
    turns: int = quantity(
        "1", "how many steps of steering a simulated turn has, all to one side", "[1, 20]"
    )
    turn_gap: float = quantity("s", "straight driving between two of them", "[0, 60]")
    counter_roll_rate: float = quantity(
        "rad/s", "outward roll below which a fishhook is counter-steered", "(0, 10]"
    )
    steer_rate: float = quantity("rad/s", "growth of a rising steering angle", "(0, 10]")
    path: Literal["lane_change", "corner"] = quantity("1", "what is driven by kind path")
    corner_radius: float = quantity("m", "of the centre line of a corner", "(0.05, 100]")
    corner_width: float = quantity("m", "of the lane of a corner", "(0.05, 20]")
    driver_preview: float = quantity("s", "how far ahead the driver of a path looks", "(0, 10]")
    driver_correction: float = quantity(
        "1", "share of missing curvature that driver adds", "[0, 10]"
    )
    driver_lag: float = quantity("s", "time constant with which that driver notices it", "[0, 10]")
    driver_delay: float = quantity("s", "reaction time of that driver", "[0, 1]")
    driver_rate: float = quantity(
        "rad/s", "steering rate of that driver's hands, at the wheels", "(0, 100]"
    )
    duration: float = quantity("s", "length of a run other than the AUTO sequence", "(0, 600]")
    slalom_period: float = quantity("s", "period of the sinusoidal steering", "(0, 60]")
    straight_time: float = quantity(
        "s", "straight driving before the turn of the AUTO sequence", "[0, 600]"
    )
    wait_after_turn: float = quantity(
        "s", "straight driving after that turn before throttle 0", "[0, 60]"
    )
    log_end: float = quantity("s", "end of the AUTO sequence", "(0, 600]")


class SimulationParameters(QuantityModel):
    """Numerics of the discrete plant (design sections 7 and 13)."""

    step: float = quantity("s", "step of the plant", "[1e-5, 0.01]")
    log_rate: float = quantity("Hz", "rows per second in the run log, at most 1/step", "(0, 20000]")
