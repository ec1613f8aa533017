"""What `aerodima.workbench` promises; the modules behind it may move."""

from .aero.added_mass import AddedMass as AddedMass
from .aero.added_mass import add_added_mass as add_added_mass
from .aero.coefficient_files import embedded_sets as embedded_sets
from .aero.coefficient_files import load_coefficients as load_coefficients
from .aero.coefficient_plots import plot_coefficients as plot_coefficients
from .aero.laws import NormalForceLaw as NormalForceLaw
from .aero.laws import SectionLaw as SectionLaw
from .aero.polar_law import PolarLaw as PolarLaw
from .aero.sections import Air as Air
from .aero.sections import SectionLayout as SectionLayout
from .aero.tail_force import TailForce as TailForce
from .aero.tail_force import add_tail_force as add_tail_force
from .aero.wind import WindModel as WindModel
from .aero.wind import add_wind as add_wind
from .batch.engine import open_engine as open_engine
from .config.ensemble import Ensemble as Ensemble
from .config.ensemble import load_ensemble as load_ensemble
from .config.scenario import RigScenario as RigScenario
from .config.scenario import Scenario as Scenario
from .config.scenario import load_rig_scenario as load_rig_scenario
from .config.scenario import load_scenario as load_scenario
from .config.swing_curve import swing_at as swing_at
from .config.swing_file import SwingFile as SwingFile
from .config.swing_file import read_swing as read_swing
from .config.swing_file import write_swing as write_swing
from .controllers.tail_law import Observation as Observation
from .controllers.tail_law import TailLaw as TailLaw
from .errors import UserError as UserError
from .figures.run_figures import plot_overlay as plot_overlay
from .figures.run_figures import plot_turn as plot_turn
from .figures.tail_figures import plot_range_of_motion as plot_range_of_motion
from .logs.schema import RunLog as RunLog
from .logs.schema import read_run_log as read_run_log
from .metrics.turn_metrics import RunMetrics as RunMetrics
from .metrics.turn_metrics import metrics_of as metrics_of
from .plants.clearance import RangeOfMotion as RangeOfMotion
from .plants.clearance import make_range_of_motion as make_range_of_motion
from .replay.strip import strip_figure as strip_figure
from .replay.strip import write_strip as write_strip
from .report.replay_page import write_replay_html as write_replay_html
from .simulate.car_run import assemble as assemble
from .simulate.simulation import simulate as simulate
from .stations.car_station import make_car_station as make_car_station
from .stations.rig_station import make_rig_station as make_rig_station

__version__: str
