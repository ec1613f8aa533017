"""Where the wind meets a rig: its pivot, and the sections of bar and tail."""

import numpy as np

from aerodima.workbench.aero.sections import SectionLayout
from aerodima.workbench.scenario.rig_scenario import MountParameters, RigScenario

DOWN = (0.0, 0.0, -1.0)
"""Direction in world axes."""
UPSTREAM = (0.0, 1.0, 0.0)
"""Direction in world axes against the wind, which blows to -y."""


def pivot_position(mount: MountParameters) -> np.ndarray:
    """p_WP: the point of the motor axis above the bar (3), m."""
    return np.array(
        [mount.com_x + mount.pivot_x, mount.com_y + mount.pivot_y, mount.com_z + mount.pivot_z]
    )


def tail_layout(scenario: RigScenario, sections: int | None = None) -> SectionLayout:
    """Sections over the whole tail under test, in the frame of the body `tail`; the jet cuts them
    to its exposed part.

    Args:
        scenario: with a tail.
        sections: equal parts; `aero.sections` by default.
    """
    number = sections or scenario.aero.sections
    if scenario.is_robot:
        arm = scenario.robot_tail
        return SectionLayout.strip(
            start=arm.length - arm.sail_length,
            length=arm.sail_length,
            width=arm.sail_width,
            number=number,
            axis_B=DOWN,
            normal_B=UPSTREAM,
        )
    tail = scenario.cheetah_tail
    return SectionLayout.strip(
        start=0.0,
        length=tail.length,
        width=tail.major_axis,
        number=number,
        axis_B=DOWN,
        normal_B=UPSTREAM,
    )


def bar_layout(scenario: RigScenario) -> SectionLayout:
    """The bar as one section, in the frame of the body `bar`."""
    bar = scenario.bar
    return SectionLayout.strip(
        start=0.0,
        length=bar.tail_distance,
        width=bar.width,
        number=1,
        axis_B=DOWN,
        normal_B=UPSTREAM,
    )
