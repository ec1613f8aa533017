"""The tail of a scenario: arm, sail, motors and joint friction."""

import math
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple, Self

import yaml
from pydantic import model_validator

from aerodima.workbench.core.key_errors import nearest
from aerodima.workbench.core.quantity import QuantityModel, quantity
from aerodima.workbench.core.resources import models_dir

CONSTANT = "constant"
"""Value of `tail.coefficients` for which `tail.normal_force_coefficient` applies."""
COEFFICIENT_ENDINGS = (".yaml", ".yml", ".csv")
SAIL_LAWS = ("normal_force", "two_sided")
"""Laws of coefficient files that know the normal of a sail (`SectionLaw.knows_normal`)."""
NO_GEOMETRY = "none"
"""Value of `tail.geometry` for one straight rod with one sail at its tip (`TailParameters`)."""
SHELL_DEPTH = 0.5
"""Depth of a half cylinder over its width."""


class SailShape(NamedTuple):
    """Sail shape of thesis 5.2, as far as the text describes it.

    Attributes:
        depth: depth of the shell over its width.
        board: whether a backing board stands behind the shell.
        coefficients: embedded set of Table 2.1 for the shape; None for the built sail, and where
            the thesis has the coefficient in a picture only.
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
two modelled on parachutes."""


class TailParameters(QuantityModel):
    """The tail arm: pitch joint, roll joint, rod and sail (thesis chapters 5 and 6.3)."""

    name: str = quantity(
        "1", "name of the tail: built, or the name of a design", min_length=1, max_length=40
    )
    mode: Literal["none", "held", "swing"] = quantity(
        "1", "use of the tail: no tail arm, arm held on the inside, arm swung"
    )
    length: float = quantity("m", "length from the roll axis to the tip", "(0.05, 3]")
    mass: float = quantity("kg", "mass of rod and sail together", "(0, 5]")
    sail_mass_fraction: float = quantity(
        "1", "share of the sail in the mass of rod and sail together", "(0, 1)"
    )
    sail_length: float = quantity(
        "m", "length of the sail along the tail, ending at the tip", "(0.01, 3]"
    )
    sail_width: float = quantity("m", "width of the sail across the tail", "(0.005, 2]")
    hub_mass: float = quantity("kg", "mass of the moving part of the pitch joint", "(0, 2]")
    mount_x: float = quantity(
        "m", "distance of the tail joints ahead of the rear axle", "[-0.5, 0.5]"
    )
    mount_height: float = quantity("m", "height of the tail joints above the ground", "(0, 1]")
    coefficients: str = quantity(
        "1", "sail coefficients: constant, an embedded set, or the path of a coefficient file"
    )
    normal_force_coefficient: float = quantity(
        "1", "C_N with shape built and coefficients constant", "[0, 10]"
    )
    sail: Literal["facing", "free", "locked"] = quantity(
        "1", "state of the sail: facing the wind, free to turn, or locked"
    )
    sail_shape: str = quantity(
        "1", "shape of the sail: depth, board, and with coefficients constant its C_N"
    )
    sail_shell_offset: float = quantity(
        "1", "offset of a free sail's shell behind its bearing, over sail_width", "[-1, 1]"
    )
    sail_board_share: float = quantity(
        "1", "length of a free sail's backing board along the wind, over sail_width", "(0, 5]"
    )
    sail_side_coefficient: float = quantity(
        "1", "C_N of a free sail's shell and board across the wind", "[0, 10]"
    )
    sail_bearing_damping: float = quantity(
        "N m s/rad", "damping of a free sail's bearing", "[0, 1]"
    )
    added_mass: float = quantity(
        "kg", "added mass of the air on each of five parts of the tail", "[-1, 10]"
    )
    sections: int = quantity("1", "number of equal sections of the sail", "[1, 100]")
    geometry: str = quantity(
        "1", "none, or the path of a tail file, whose shape and mass stand in place of those here"
    )
    roll_limit: float = quantity(
        "rad", "largest tail roll that may be commanded, to either side", "(0, 3.1416]"
    )
    roll_stop: float = quantity(
        "rad", "mechanical stop of the roll joint; 3.1416: none", "(0, 3.1416]"
    )
    pitch_limit: float = quantity("rad", "tail pitch range to either side", "(0, 3.1416]")

    @property
    def shell_share(self) -> float:
        """Depth of the sail's shell over its width."""
        return SAIL_SHAPES[self.sail_shape].depth

    @property
    def board_share(self) -> float:
        """Length of the backing board along the wind over the sail's width; 0 without a board."""
        return self.sail_board_share if SAIL_SHAPES[self.sail_shape].board else 0.0

    @property
    def sail_front(self) -> float:
        """Distance of the plane of the sail's opening ahead of the bearing, m; the board ends
        `sail_depth` behind that plane.
        """
        return (self.shell_share / 2 - self.sail_shell_offset) * self.sail_width

    @property
    def sail_depth(self) -> float:
        """Length of shell and board together along the wind, m."""
        return (self.shell_share + self.board_share) * self.sail_width

    @property
    def sail_reach(self) -> float:
        """Radius of the cylinder that the sail sweeps when it turns on its bearing, m."""
        return max(
            math.hypot(self.sail_width / 2, self.sail_front), self.sail_depth - self.sail_front
        )

    @property
    def has_own_geometry(self) -> bool:
        """Tell whether a tail file gives shape and mass."""
        return self.geometry != NO_GEOMETRY

    @model_validator(mode="after")
    def _air_is_known(self) -> Self:
        known = [CONSTANT, *robot_tail_sets()]
        is_file = Path(self.coefficients).suffix in COEFFICIENT_ENDINGS  # read with the car
        if not is_file and self.coefficients not in known:
            raise ValueError(
                f"coefficients: {self.coefficients!r} is no set for the robot's tail; "
                f"{nearest(self.coefficients, known)}; "
                f"or the path of a file ({', '.join(COEFFICIENT_ENDINGS)})"
            )
        if self.sail_shape not in SAIL_SHAPES:
            raise ValueError(
                f"sail_shape: {self.sail_shape!r} is not allowed; "
                f"{nearest(self.sail_shape, SAIL_SHAPES)}"
            )
        shape = SAIL_SHAPES[self.sail_shape]
        is_pictured = shape.coefficients is None and self.sail_shape != "built"
        if is_pictured and self.coefficients == CONSTANT:
            raise ValueError(
                f"sail_shape: {self.sail_shape!r} has its coefficient in a picture of the thesis "
                "only (Fig. 5.7); tail.coefficients must be a set or a file"
            )
        if self.sail == "free" and not shape.board:
            raise ValueError(
                f"sail: 'free' must be facing or locked: the shape {self.sail_shape!r} has no board"
            )
        return self

    @model_validator(mode="after")
    def _geometry_is_locked(self) -> Self:
        if not self.has_own_geometry:
            return self
        if not self.geometry.endswith((".yaml", ".yml")):
            raise ValueError(
                f"geometry: {self.geometry!r} must be {NO_GEOMETRY}, or a tail file (.yaml, .yml)"
            )
        if self.sail != "locked":
            raise ValueError(
                f"sail: {self.sail!r} must be locked with tail.geometry {self.geometry}"
            )
        return self


@cache
def robot_tail_sets() -> tuple[str, ...]:
    """List the embedded sets (`models/coefficients`) whose law knows the normal of a sail."""
    files = sorted((models_dir() / "coefficients").glob("*.yaml"))
    return tuple(
        path.stem
        for path in files
        if yaml.safe_load(path.read_text(encoding="utf-8")).get("law") in SAIL_LAWS
    )


class TailMotorParameters(QuantityModel):
    """T-Motor AK70-10 in MIT mode, one for pitch and one for roll (design sections 6 and 14)."""

    torque_limit: float = quantity("N m", "peak torque at the output", "(0, 200]")
    kp_max: float = quantity("N m/rad", "largest position gain of the MIT frame", "(0, 500]")
    kd_max: float = quantity("N m s/rad", "largest velocity gain of the MIT frame", "(0, 5]")
    position_range: float = quantity(
        "rad", "largest position of the MIT frame to either side", "(0, 100]"
    )
    speed_range: float = quantity(
        "rad/s", "largest speed of the MIT frame to either side", "(0, 200]"
    )
    rotor_inertia: float = quantity("kg m2", "rotor inertia before the gearbox", "(0, 0.01]")
    gear_ratio: float = quantity("1", "rotor turns per output turn", "[1, 200]")
    speed_constant: float = quantity("rad/s/V", "no-load rotor speed per volt", "(0, 1000]")
    winding_resistance: float = quantity(
        "ohm", "resistance that the torque-speed line is built with", "(0, 10]"
    )
    pack_voltage: float = quantity("V", "voltage of the tail battery", "[24, 48]")
    torque_error: float = quantity(
        "1", "relative error of the torque that a command gives", "(-1, 1]"
    )

    @property
    def reflected_inertia(self) -> float:
        """Compute the inertia of the rotor about the joint, kg m2."""
        return self.rotor_inertia * self.gear_ratio**2


class FrictionParameters(QuantityModel):
    """Joint friction of the robot tail (thesis eq. 4.12 with the right sign, ERRATA E14, E15; Table
    6.2).
    """

    coulomb: float = quantity("N m", "Coulomb friction torque", "[0, 10]")
    viscous: float = quantity("N m s/rad", "viscous friction", "[0, 10]")
    tanh_gain: float = quantity(
        "s/rad", "gain inside tanh of the smoothed Coulomb friction", "(0, 1000]"
    )
