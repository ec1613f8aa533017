"""The car of a run log: its plant, rebuilt from the scenario in the log, and its positions over time."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder

from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import Scenario, scenario_from_dict
from aerodima.workbench.config.signal_table import PLANT_POSITION_PREFIX
from aerodima.workbench.errors import LogError, ScenarioError
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.logs.signals import check_time
from aerodima.workbench.plants.car import CarPlant, add_car_plant

SAIL_POSITION = f"{PLANT_POSITION_PREFIX}tail_tail_sail_turn_q"


@dataclass(frozen=True)
class LoggedCar:
    """A run and the car that made it.

    Attributes:
        run_log: the run.
        scenario: its scenario.
        car: plant and scene graph; they are moved, not simulated.
        positions: plant positions, shape (n, nq), one row per row of the log.
    """

    run_log: RunLog
    scenario: Scenario
    car: CarPlant
    positions: FloatArray

    def move(self, plant_context: Context, row: int) -> None:
        """Puts the car where it was in one row of the log."""
        self.car.plant.SetPositions(plant_context, self.positions[row])


def add_logged_car(builder: DiagramBuilder, run_log: RunLog) -> LoggedCar:
    """Adds the car of a run log to a diagram.

    Raises:
        LogError: the log has no plant positions (a run of the real car: see `replayable`), others than the car of its
            scenario has, a value that is not finite, or a scenario that cannot be read.
    """
    name = run_log.source or "run log"
    check_time(run_log.time)
    logged = [column for column in run_log.table.columns if column.startswith(PLANT_POSITION_PREFIX)]
    if not logged:
        raise LogError(f"{name}: has no columns {PLANT_POSITION_PREFIX}*; only a simulated run can be replayed")
    try:
        scenario = scenario_from_dict(run_log.scenario)
    except ScenarioError as error:
        raise LogError(f"{name}: the scenario in its metadata cannot be read: {error}") from None
    car = add_car_plant(builder, with_turning_sail(scenario))
    wanted = [PLANT_POSITION_PREFIX + position for position in _position_names(car.plant)]
    table = _with_sail_angle(run_log, scenario)
    logged = [column for column in table.columns if column.startswith(PLANT_POSITION_PREFIX)]
    if set(wanted) != set(logged):
        missing, foreign = sorted(set(wanted) - set(logged)), sorted(set(logged) - set(wanted))
        raise LogError(
            f"{name}: its plant positions are not those of the car of its scenario; "
            f"missing: {', '.join(missing) or 'none'}; unknown: {', '.join(foreign) or 'none'}"
        )
    positions = table[wanted].to_numpy(dtype=np.float64)
    if not np.all(np.isfinite(positions)):
        row, column = np.argwhere(~np.isfinite(positions))[0]
        raise LogError(f"{name}: {wanted[column]} is not finite at {run_log.time[row]:g} s")
    return LoggedCar(run_log, scenario, car, positions)


def with_turning_sail(scenario: Scenario) -> Scenario:
    """The scenario with a joint for a sail that faces the wind, so that it can be drawn turned."""
    if scenario.tail.sail != "facing":
        return scenario
    return scenario.model_copy(update={"tail": scenario.tail.model_copy(update={"sail": "free"})})


def _with_sail_angle(run_log: RunLog, scenario: Scenario) -> pd.DataFrame:
    """The log with the encoder's angle as position of the joint that a facing sail does not have in its simulation."""
    table = run_log.table
    if scenario.tail.sail != "facing" or scenario.tail.mode == "none" or SAIL_POSITION in table.columns:
        return table
    return table.assign(**{SAIL_POSITION: run_log.signal("sail_angle_rad")})


def _position_names(plant: MultibodyPlant) -> list[str]:
    return list(plant.GetPositionNames())
