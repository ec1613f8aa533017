"""How much of the packages a task needs: a reader of one part has no more to know than this."""

from pathlib import Path

from tests.code_measure import built_station, loaded_by

ROOT = Path(__file__).resolve().parent.parent
STATION = 30
"""From a scenario to its station; only lowered."""


def test_station_of_a_scenario_needs_few_modules() -> None:
    assert 0 < loaded_by(ROOT, built_station("aerodima.workbench.stations.car_station")) <= STATION
