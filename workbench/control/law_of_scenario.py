"""The tail law that a scenario names: published swing, played swing or feedback. No Drake."""

from typing import Any

from aerodima.workbench.control.feedback_law import FeedbackLaw
from aerodima.workbench.control.swing_law import SwingSettings
from aerodima.workbench.control.swing_library import NO_SWING, swing_of_scenario
from aerodima.workbench.control.swing_machine import SwingLaw
from aerodima.workbench.control.swing_player import SwingPlayer
from aerodima.workbench.control.tail_law import TailLaw
from aerodima.workbench.core.errors import UserError


def law_of_scenario(scenario: Any) -> TailLaw:
    """Returns the law of `scenario.controller` and `scenario.tail.mode` (any object with these
    attributes).

    Raises:
        UserError: a setting out of range, a swing file that is missing or malformed.
    """
    if scenario.controller.law == "feedback" and scenario.tail.mode == "swing":
        if scenario.controller.swing_file != NO_SWING:
            raise UserError(
                f"controller.swing_file: {scenario.controller.swing_file}; allowed with law "
                f"feedback: {NO_SWING}"
            )
        return FeedbackLaw.from_scenario(scenario)
    swing = swing_of_scenario(scenario)
    if swing is None:
        return SwingLaw(SwingSettings.from_scenario(scenario))
    return SwingPlayer.from_scenario(swing, scenario)
