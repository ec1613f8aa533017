"""A user's file: `.ci/run` lets mypy read it beside the wheel, with no checkout. It is never run.

Where a name of the packages had no type, `mypy --strict` would find the ignored error of its line
unused.
"""

from typing import assert_type

from aerodima.hardware import MitCommand, make_command
from aerodima.optimisation import fit_static_log
from aerodima.workbench import (
    Scenario,
    SectionLayout,
    TailGeometry,
    __version__,
    load_scenario,
    metrics_of,
    simulate,
)

scenario = load_scenario("turn_none", ["manoeuvre.speed=3.61"])
run = simulate(scenario, record="outcome")
assert_type(scenario, Scenario)
assert_type(scenario.car.mass, float)
assert_type(metrics_of(run).peak_roll_rad, float)
assert_type(fit_static_log("hold.parquet")["cd"].value, float)
assert_type(SectionLayout.strip(start=0.1, length=0.2, width=0.3), SectionLayout)
assert_type(__version__, str)

run.no_such_signal  # type: ignore[attr-defined]  # noqa: B018
load_scenario(3.61)  # type: ignore[arg-type]
make_command("1", MitCommand, None)  # type: ignore[arg-type]
TailGeometry(name=1)  # type: ignore[arg-type, call-arg]
