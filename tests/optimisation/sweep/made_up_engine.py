"""An engine whose runs cost nothing: survival and numbers as plain functions of the settings."""

from aerodima.optimisation.sweep.rollover_threshold import FRICTION, SPEED
from aerodima.workbench.batch.engine import Engine

LIMITS = {"turn_none": 0.62, "turn_held": 0.72, "turn_swing": 0.82}


class MadeUpEngine(Engine):
    """The tailless car survives to a friction of 0.62, held to 0.72, swung to 0.82; a little less
    at higher speed.
    """

    def map(self, work, tasks, done=None, lost=None):
        rows = []
        for place, task in enumerate(tasks):
            settings = dict(setting.split("=", 1) for setting in task.settings)
            friction = float(settings.get(FRICTION, 0.6))
            speed = float(settings.get(SPEED, 3.33))
            survived = friction <= LIMITS[task.scenario] - 0.02 * (speed - 3.33)
            row = {
                "run": task.name,
                "outcome": "survived" if survived else "flipped",
                "clean": survived,
                "error": "",
            }
            names = (
                "max_yaw_rate_rad_per_s",
                "average_yaw_rate_rad_per_s",
                "max_linear_acceleration_m_per_s2",
            )
            names += (
                "max_kohut_deg_m_per_s2",
                "peak_roll_rad",
                "heading_change_rad",
                "swing_trigger_time_s",
            )
            row |= dict.fromkeys(names, 0.1 * speed)
            if task.signals == "all" and task.scenario != "turn_none":
                row |= {
                    f"{cause}_yaw_impulse_window_n_m_s": -0.1
                    for cause in ("inertial", "aerodynamic")
                }
            rows.append(
                row
                | {
                    "scenario": task.scenario,
                    "settings": " ".join(task.settings),
                    "version_drake": "none",
                }
            )
            if done is not None:
                done(place, rows[-1])
        return rows
