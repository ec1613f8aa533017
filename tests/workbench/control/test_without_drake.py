"""The laws, the schedules and the port names must run on a computer for which Drake has no
wheel.
"""

from tests.blocked_drake import run_without_drake

PROGRAM = """
from aerodima.workbench.control.manoeuvre import SpeedRamp, ThrottleLine, TurnSchedule
from aerodima.workbench.control.swing_law import SwingSettings
from aerodima.workbench.control.swing_machine import SwingLaw, SwingMemory
from aerodima.workbench.control.swing_law import SwingState
from aerodima.workbench.control.tail_law import Observation
from aerodima.workbench.scenario.scenario import load_scenario
from aerodima.workbench.scenario.signal_table import TAIL_COMMAND

schedule = TurnSchedule(SpeedRamp(3.0, 1.0, ThrottleLine(10.0, 0.0)), 1.0, 0.5, 2.0, 0.5)
prompt = load_scenario("turn_swing", ["controller.delay=0.0"])
memory, settings = SwingMemory(), SwingSettings.from_scenario(prompt)
states = []
for tick, yaw_rate in enumerate((0.0, 0.0, 1.5)):
    driver = schedule.at(0.01 * tick)
    observation = Observation(0.01 * tick, yaw_rate, -1.5, 0.0, driver.planned_turn, True)
    memory, _, roll = SwingLaw(settings).tick(memory, observation)
    states.append(SwingState(memory.state).name)
assert states == ["HOLD", "HOLD", "SWING"], states
assert TAIL_COMMAND.read(roll).velocity == 8.0

from aerodima.workbench.control.swing_player import SwingPlayer
from aerodima.workbench.core.resources import model_path
from aerodima.workbench.scenario.swing_file import read_swing

player = SwingPlayer(read_swing(model_path("swings/thesis_8_rad_per_s.yaml")), settings)
memory, states = player.start(), []
for tick, yaw_rate in enumerate((0.0, 0.0, 1.5)):
    observation = Observation(0.01 * tick, yaw_rate, -1.5, 0.0, 1.0, True)
    memory, _, roll, state = player.step(memory, observation)
    states.append(SwingState(state).name)
assert states == ["HOLD", "HOLD", "SWING"], states
assert TAIL_COMMAND.read(roll).velocity == 8.0

from aerodima.workbench.control.driver_law import DriverView, make_driver

law = make_driver(load_scenario("entry_lane_change"))
_, given = law.step(law.start(), DriverView(0.0, (0.0, 0.0), 0.0, 0.0, 2.0, 0.0))
assert given.planned_turn == 1.0
print("runs")
"""


def test_laws_schedule_and_ports_run_with_drake_blocked():
    result = run_without_drake(PROGRAM)
    assert result.stdout == "runs\n", result.stderr
