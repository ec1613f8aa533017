"""What `aerodima.optimisation` promises; the modules behind it may move."""

from .identify.fit_figures import plot_curves as plot_curves
from .identify.fit_options import FitOptions as FitOptions
from .identify.fit_pipeline import fit as fit
from .identify.fit_program import FitProgram as FitProgram
from .identify.fit_report import format_estimate as format_estimate
from .identify.gauss_newton import solve_formula as solve_formula
from .identify.gauss_newton import solve_rollout as solve_rollout
from .identify.least_squares import Parameter as Parameter
from .identify.least_squares import Parameters as Parameters
from .identify.least_squares import Problem as Problem
from .identify.noise import independent_noise as independent_noise
from .identify.noise import serial_noise as serial_noise
from .identify.static_fit import fit_static_log as fit_static_log
from .identify.swing_coefficients import fit_added_mass_log as fit_added_mass_log
from .identify.swing_coefficients import fit_friction_log as fit_friction_log
from .identify.swing_coefficients import fit_robot_tail_log as fit_robot_tail_log
from .judge.entry_speed import find_entry_speeds as find_entry_speeds
from .judge.reduced_entries import sweep_speeds as sweep_speeds
from .studies.rollover_threshold import critical_friction as critical_friction
from .studies.run_study import run_study as run_study
from .studies.runs import open_run_engine as open_run_engine
from .studies.study import load_study as load_study
from .swing.motion_search import MotionSearch as MotionSearch
from .swing.motion_search import make_turn_nlp as make_turn_nlp
from .swing.motion_search import turn_programme as turn_programme
from .swing.task import Task as Task
