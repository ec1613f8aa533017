"""Ensemble files of the cars of a posterior."""

import yaml

from aerodima.optimisation.calibrate.calibration import FineRuns
from aerodima.optimisation.calibrate.calibration_plan import CarPrior
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.metrics.published_values import Platform
from aerodima.workbench.scenario.ensemble import ENSEMBLE_SCHEMA

OF_A_CAR = ("controller.trigger_yaw_rate", "tail.roll_stop")
"""Settings of a run that belong to the car, not to its drive."""


def ensemble_text(
    prior: CarPrior, fine: FineRuns, system: Platform, effective_sample_size: float
) -> str:
    """Returns the cars of the fine runs in one system as the text of an ensemble file, equally
    likely.
    """
    plan = prior.plan
    keys = {*plan.body, *plan.each, *OF_A_CAR}
    first = next(turn for turn in plan.turns if turn.system == system)
    content: Json = {
        "schema": ENSEMBLE_SCHEMA,
        "name": system,
        "provenance": {
            "method": f"posterior cars of the {system} system, given Tables 7.1 to 7.4 and the "
            "published outcomes",
            "plan": plan.name,
            "seed": plan.seed,
            "effective_sample_size": round(effective_sample_size, 1),
            "fine_step_s": plan.size.fine_step,
            "versions": software_versions(),
        },
        "best": f"car{fine.best[system]:03d}",
    }
    lines = [
        "# Cars that the published figures leave possible, made by `aerodima calibrate --plan "
        f"{plan.name}`.",
        yaml.safe_dump(content, sort_keys=False, width=116).rstrip(),
        "members:",
    ]
    weight = 1 / len(fine.cars)
    for index, car in enumerate(fine.cars):
        settings = dict(setting.split("=") for setting in prior.settings(car, first))
        values = ", ".join(f"{key}: {value}" for key, value in settings.items() if key in keys)
        lines.append(f"- {{name: car{index:03d}, weight: {weight:.6g}, values: {{{values}}}}}")
    return "\n".join(lines) + "\n"
