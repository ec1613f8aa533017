"""What the published tables give for the sets of `models/coefficients/`, as the files hold it.

Weights follow thesis eqs. 4.29-4.31: w_i proportional to 1 / resnorm_i.
"""

import math

import numpy as np

from aerodima.workbench.core.resources import published_table

BAND = (10.0, 90.0)


def weighted(values, resnorms):
    return float(np.average(values, weights=1.0 / resnorms))


def robot_tail_rows():
    """The 160 distinct coefficients of the robot tail: Table 11.3 repeats 11.6 and is left out
    (ERRATA E24).
    """
    rows = published_table("robot_tail_drag")
    return rows[rows.source_table != "Table 11.3"]


def averages(group, columns):
    """Weighted average and percentiles by the name in the file, of columns of the table, and their
    number.
    """
    found = {}
    for name, column in columns.items():
        low, high = np.percentile(group[column], BAND)
        values = {
            name: weighted(group[column], group.resnorm),
            f"{name}_p10": low,
            f"{name}_p90": high,
        }
        found |= {key: round(float(value), 4) for key, value in values.items()}
    return found | {"samples": len(group)}


def robot_tail_nodes():
    groups = robot_tail_rows().groupby("relative_velocity_m_per_s")
    return [
        {"speed_m_per_s": float(speed), **averages(group, {"cn": "cd"})} for speed, group in groups
    ]


def robot_tail_line():
    rows = robot_tail_rows()
    slope, intercept = np.polyfit(rows.relative_velocity_m_per_s, rows.cd, 1)
    return {"cn_slope_s_per_m": round(float(slope), 6), "cn_intercept": round(float(intercept), 6)}


def cheetah_nodes(tail, axis):
    """The 18 nodes of one cheetah tail: measured ones from the static fits, the others seeds
    (ERRATA E1, E3, E4, F).
    """
    fits = published_table("static_fits")
    fits = fits[(fits["tail"] == tail) & (fits.axis == axis)]
    fits = fits[
        fits.derived_repeats_wind_speed_m_per_s.isna() & ~fits.published_bold_outlier.eq(True)
    ]
    seeds = published_table("static_seeds")
    seeds = seeds[seeds["tail"] == tail]
    nodes = []
    for angle in (0, 15, 30, 45, 60, 75):
        for speed in (10.0, 20.0, 30.0):
            place = {"speed_m_per_s": speed, "angle_rad": round(math.radians(angle), 9)}
            group, seed = (
                table[(table.angle_of_attack_deg == angle) & (table.wind_speed_m_per_s == speed)]
                for table in (fits, seeds)
            )
            if len(group):
                found = {"status": "measured", **averages(group, {"cd": "cd", "cl": "cl"})}
                source = group.source_table.iloc[0]
            else:
                start = seed.set_index("variable").x0
                found = {
                    "status": "seed",
                    "cd": float(start["cd"]),
                    "cl": float(start["cl"]),
                    "samples": 0,
                }
                source = seed.source_table.iloc[0]
            nodes.append({**place, **found, "source": str(source)})
    return nodes
