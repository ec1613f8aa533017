"""The car of a scenario: chassis, wheels, steering servo and drive.

The values live in `models/parameters/<section>.yaml`, each with unit and source; the classes here
hold name, unit and allowed range only. Frames and signs: design section 4.
"""

import math
from typing import Literal, Self

from pydantic import model_validator

from aerodima.workbench.core.quantity import QuantityModel, quantity


class CarParameters(QuantityModel):
    """Chassis, wheels, tyres and suspension of the car without its tail arm (design section 7)."""

    mass: float = quantity(
        "kg", "mass of the whole car without the tail arm, gearbox and wheels included", "(0, 30]"
    )
    com_height: float = quantity(
        "m",
        "height of the centre of mass without tail arm above the ground, at nominal ride height",
        "(0, 1]",
    )
    com_x: float = quantity(
        "m", "distance of the centre of mass without tail arm ahead of the rear axle", "[-0.2, 0.5]"
    )
    gyration_roll: float = quantity(
        "m", "radius of gyration of the sprung body about its x axis", "(0, 0.5]"
    )
    gyration_pitch: float = quantity(
        "m", "radius of gyration of the sprung body about its y axis", "(0, 0.5]"
    )
    gyration_yaw: float = quantity(
        "m", "radius of gyration of the sprung body about its z axis", "(0, 0.5]"
    )
    wheelbase: float = quantity("m", "distance between the axles", "(0.05, 2]")
    track: float = quantity("m", "distance between the wheel centres of one axle", "(0.05, 2]")
    tyre_radius: float = quantity("m", "unloaded tyre radius", "(0.01, 0.5]")
    tyre_width: float = quantity("m", "tyre width", "(0.005, 0.3]")
    tyre_shape: Literal["cylinder", "ellipsoid"] = quantity(
        "1", "contact shape of a tyre of width tyre_width"
    )
    wheel_mass: float = quantity("kg", "mass of one wheel with its tyre", "(0, 2]")
    upright_mass: float = quantity(
        "kg", "mass of the moving part of one suspension without wheel and knuckle", "(0, 2]"
    )
    knuckle_mass: float = quantity("kg", "mass of one steered front knuckle", "(0, 2]")
    tyre_stiffness_front: float = quantity("N/m", "radial stiffness of one front tyre", "(0, 1e7]")
    tyre_stiffness_rear: float = quantity("N/m", "radial stiffness of one rear tyre", "(0, 1e7]")
    tyre_dissipation: float = quantity("s/m", "Hunt-Crossley dissipation of the tyres", "[0, 10]")
    tyre_friction: float = quantity(
        "1", "Coulomb friction coefficient between tyre and ground", "(0, 2]"
    )
    tyre_slip_angle: float = quantity(
        "rad", "friction over cornering stiffness per load; 0: rigid", "[0, 0.5]"
    )
    suspension_stiffness_front: float = quantity(
        "N/m", "spring rate of one front suspension unit", "(0, 1e6]"
    )
    suspension_stiffness_rear: float = quantity(
        "N/m", "spring rate of one rear suspension unit", "(0, 1e6]"
    )
    suspension_damping_front: float = quantity(
        "N s/m", "damping of one front suspension unit", "[0, 1e5]"
    )
    suspension_damping_rear: float = quantity(
        "N s/m", "damping of one rear suspension unit", "[0, 1e5]"
    )
    suspension_motion_ratio: float = quantity(
        "1", "travel of a suspension unit over that of its wheel", "(0.1, 1]"
    )
    rolling_resistance: float = quantity(
        "1", "force against rolling over load, at every wheel", "[0, 0.3]"
    )
    suspension_travel: float = quantity(
        "m", "travel to either side of the nominal ride height", "(0, 0.2]"
    )
    cage_friction: float = quantity(
        "1", "friction coefficient of cage, board and tail on the ground", "[0, 2]"
    )
    gearbox_x: float = quantity(
        "m", "distance of the middle of the gearbox ahead of the rear axle", "[-0.5, 0.5]"
    )
    gearbox_mass: float = quantity("kg", "mass of the tail gearbox with both motors", "(0, 10]")
    gearbox_width: float = quantity("m", "width of the gearbox, along y", "(0, 1]")
    gearbox_length: float = quantity("m", "length of the gearbox, along x", "(0, 1]")
    gearbox_height: float = quantity("m", "height of the gearbox, along z", "(0, 1]")

    board: bool = quantity("1", "true: anti-ramp board at the rear; false: none")
    board_x: float = quantity(
        "m", "distance of the rear edge of the anti-ramp board ahead of the rear axle", "[-0.5, 0]"
    )
    board_height: float = quantity(
        "m", "height of the board's lower face above the ground at nominal ride height", "(0, 0.5]"
    )
    board_length: float = quantity("m", "length of the board, along x", "(0, 0.5]")
    board_width: float = quantity("m", "width of the board, along y", "(0, 1]")
    board_thickness: float = quantity("m", "thickness of the board, along z", "(0, 0.05]")
    board_mass: float = quantity("kg", "mass of the board, part of the mass of the car", "(0, 1]")
    bodies: str = quantity(
        "1", "none, or the path of a file of bodies on the chassis that feel the air"
    )

    @property
    def has_bodies(self) -> bool:
        """Tell whether a file puts bodies that feel the air on the chassis."""
        return self.bodies != "none"

    @model_validator(mode="after")
    def _gyration_is_physical(self) -> Self:
        radii = {name: getattr(self, f"gyration_{name}") for name in ("roll", "pitch", "yaw")}
        for name, radius in radii.items():
            largest = math.sqrt(sum(other**2 for other in radii.values()) - radius**2)
            if radius > largest * (1 + 1e-9):
                raise ValueError(
                    f"gyration_{name}: {radius:g} m must be <= {largest:g} m for a physical inertia"
                )
        return self

    @property
    def outer_half_track(self) -> float:
        """Compute the distance (m) of the outer tyres' edge from the car's middle as it leans."""
        return self.track / 2 + (self.tyre_width / 2 if self.tyre_shape == "cylinder" else 0.0)


class ServoParameters(QuantityModel):
    """Steering servo, rate limited (thesis 7.1.1)."""

    rate: float = quantity("rad/s", "steering rate at the road wheels", "(0, 100]")
    limit: float = quantity("rad", "largest steering angle to either side", "(0, 1.2]")
    linkage: Literal["parallel", "ackermann"] = quantity(
        "1", "kind of linkage: both wheels at the steering angle, or about one centre"
    )
    frame_rate: float = quantity("Hz", "rate at which the servo reads its command", "(0, 2000]")
    stiffness: float = quantity("N m/rad", "position gain at each front knuckle", "(0, 1e4]")
    damping: float = quantity("N m s/rad", "velocity gain at each front knuckle", "[0, 1e3]")
    torque_limit: float = quantity(
        "N m", "largest steering torque at each front knuckle", "(0, 100]"
    )


class DriveParameters(QuantityModel):
    """Brushless drive on the rear differential (design section 6)."""

    governor: bool = quantity(
        "1", "true: holds the wheel speed; false: throttle frozen, speed droops with load"
    )
    throttle_gain: float = quantity("m/s", "steady speed per unit throttle", "(0, 100]")
    throttle_offset: float = quantity(
        "m/s", "steady speed at zero throttle of the fitted line", "[-5, 5]"
    )
    breakaway_throttle: float = quantity(
        "1", "throttle below which the car without governor stands", "[0, 1)"
    )
    governor_gain: float = quantity(
        "N m s/rad", "torque per shaft-speed error with governor", "(0, 100]"
    )
    time_constant: float = quantity(
        "s", "time constant of the whole car's speed response without governor", "(0.01, 20]"
    )
    torque_limit: float = quantity("N m", "largest torque on the rear axle", "(0, 100]")
    rotor_inertia: float = quantity(
        "kg m2", "inertia of motor and gear train, reflected to the axle", "(0, 1]"
    )
