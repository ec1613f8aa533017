"""Settings of the thesis' law, without the delay, which is a calibrated car's."""

from aerodima.workbench.control.swing_law import SwingSettings
from aerodima.workbench.core.yaml_files import checked
from aerodima.workbench.scenario.scenario import load_scenario


def published(**changes):
    """The settings of the shipped scenario with some changes."""
    settings = SwingSettings.from_scenario(load_scenario("turn_swing"))
    return checked(SwingSettings, {**dict(settings), "delay": 0.0, **changes}, "controller")
