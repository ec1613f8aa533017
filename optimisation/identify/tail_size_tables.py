"""What the posterior of the tail's size says: tables, a figure, estimates with what is wrong with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from aerodima.optimisation.fit.fit_pipeline import Estimate, FitResult
from aerodima.optimisation.identify.published_tables import duplicated_robot_tables
from aerodima.optimisation.identify.tail_size import READINGS, TailPosterior, drawn_names, scaled, weigh
from aerodima.optimisation.identify.tail_swings import lever, swing_extremes
from aerodima.workbench.config.array_types import FloatArray
from aerodima.workbench.config.scenario import load_rig_scenario
from aerodima.workbench.figures.figure_style import BLACK, BLUE, GREEN, ORANGE, VERMILION, new_figure, styled
from aerodima.workbench.resources import published_table

AREAS = (0.12, 0.04, 0.0125, 0.005)
"""Sails that are drawn beside the posterior median, m2: assumed first, two between, thesis section 5.2."""
UPPER = 0.95
"""Of the one-sided bounds."""
_LIKELY = (0.12, 0.06, 0.04, 0.02, 0.0125, 0.01, 0.005, 0.002, 0.001)
_FIFTHS = {"lowest fifth": 0, "middle fifth": 2, "highest fifth": 4}
_QUANTITIES = ("area_m2", "cd_area_lever_m3", "cd_area_lever2_m4")
_COLOURS = (VERMILION, ORANGE, GREEN, BLUE, BLACK)


def tail_size_result(found: TailPosterior, seed: int) -> FitResult:
    """Median and 95 % interval of A (C_D 2), C_D A L_cor and C_D A L_cor^2; a warning where an end is the prior's."""
    values = (found.tails["area"], found.moment(1), found.moment(2))
    estimates = []
    for name, unit, one in zip(("area", "cd_area_lever", "cd_area_lever2"), ("m2", "m3", "m4"), values, strict=True):
        low, middle, high = found.quantiles(one, (0.025, 0.5, 0.975))
        spread = float(np.sqrt(np.sum(found.weights * (one - np.sum(found.weights * one)) ** 2)))
        estimates.append(Estimate(name, unit, float(middle), spread, float(low), float(high)))
    smallest, largest = (float(end(found.tails["area"])) for end in (np.min, np.max))
    warnings = [
        f"the {side} end of the intervals and the median follow from the prior: an area of {area:.2g} m2 explains the "
        "swings about as well as the most likely one"
        for side, area in (("lower", smallest), ("upper", largest))
        if found.area_likelihood(area) > 0.5
    ]
    bound = float(found.quantiles(values[0], (UPPER,))[0])
    facts = {"seed": seed, "tails": len(values[0]), "area_at_most_95_m2": bound}
    # Importance sampling has neither a covariance of parameters nor a cost.
    return FitResult(
        "tail size",
        tuple(estimates),
        tuple(map(tuple, np.cov(np.array(values), aweights=found.weights))),
        float(-found.log_likelihood.max()),
        {},
        True,
        "importance sampling",
        (),
        warnings=tuple(warnings),
        effective_samples=found.effective_samples,
        facts=facts,
    )


def report_tables(found: TailPosterior, seed: int) -> tuple[FitResult, dict[str, pd.DataFrame], dict[str, Figure]]:
    """Result, tables and figures of the report."""
    speeds = speeds_table(found, np.arange(0.0, 12.6, 0.5).tolist())
    tables = {
        "areas": areas_table(found),
        "variants": variants_table(found),
        "nuisances": nuisances_table(found),
        "swings": swings_table(found),
    }
    return tail_size_result(found, seed), tables, {"tail_speeds": plot_speeds(found, speeds)}


def _bounds(found: TailPosterior, kept: FloatArray | None = None) -> dict[str, float]:
    values = (found.tails["area"], found.moment(1), found.moment(2))
    bounds = {f"{q}_at_most": found.quantiles(v, (UPPER,), kept)[0] for q, v in zip(_QUANTITIES, values, strict=True)}
    return {**bounds, "area_median_m2": found.quantiles(values[0], (0.5,), kept)[0]}


def variants_table(found: TailPosterior) -> pd.DataFrame:
    """95 % upper bounds, median of the area and likelihood of 0.12 m2 when one choice is made otherwise."""
    tails, extremes, ranges = found.tails, found.extremes, found.ranges
    rows = [("as reported", found, None), ("prior uniform in the area", found, tails["area"])]
    rows.append(("without the rest angle", weigh(ranges, tails, extremes, rest=False), None))
    rows.append(("with the lowest speeds too", weigh(ranges, tails, extremes, lowest=True), None))
    for number, name in enumerate(READINGS):
        rows.append((f"rows are {name}", found, 1.0 * (tails["reading"] == number)))
    rows.append(("force with cos^2 (normal-force law)", found, 1.0 - tails["law"]))
    rows.append(("force with cos (eq. 6.8)", found, tails["law"]))
    for i, one in enumerate(ranges):
        kept = [j for j in range(len(ranges)) if j != i]
        left = weigh([ranges[j] for j in kept], tails, [extremes[j] for j in kept])
        rows.append((f"without {one.table} ({one.wind:g} m/s, Kp {one.kp:g})", left, None))
        if one.rest is not None:
            bare = weigh([ranges[j] for j in kept], tails, [extremes[j] for j in kept], lowest=True)
            rows.append((f"without {one.table}, with the lowest speeds", bare, None))
    return pd.DataFrame(
        [
            {"variant": name, **_bounds(one, kept), "likelihood_of_0.12_m2": one.area_likelihood(0.12, kept)}
            for name, one, kept in rows
        ]
    )


def nuisances_table(found: TailPosterior) -> pd.DataFrame:
    """The same with one parameter of the tail held in a fifth of its prior; what moves the bound most stands first.

    `evidence` is how much more likely the swings are there than with the parameter free.
    """
    rows = []
    columns = {name: scaled(name, found.tails[name]) for name in drawn_names() if name != "area"}
    arm = lever(found.tails)
    columns["lever"] = np.argsort(np.argsort(arm)) / len(arm)
    for name, part in columns.items():
        values = arm if name == "lever" else found.tails[name]
        for words, fifth in _FIFTHS.items():
            kept = 1.0 * (np.floor(5.0 * part).clip(0, 4) == fifth)
            inside = values[kept > 0.0]
            row = {"parameter": name, "held": words, "from": inside.min(), "to": inside.max(), **_bounds(found, kept)}
            rows.append({**row, "evidence": np.sum(found.weights * kept) / kept.mean()})
    table = pd.DataFrame(rows)
    ends = table.groupby("parameter").area_m2_at_most.agg(lambda bounds: bounds.max() / bounds.min())
    return table.assign(effect=table.parameter.map(ends)).sort_values("effect", ascending=False, kind="stable")


def areas_table(found: TailPosterior) -> pd.DataFrame:
    """Likelihood of an area with all else free over that of the most likely area (`TailPosterior.area_likelihood`)."""
    rows = [{"area_m2": area, "likelihood": found.area_likelihood(area)} for area in _LIKELY]
    return pd.DataFrame(rows)


def drawn_areas(found: TailPosterior) -> list[float]:
    """The five areas of the figure, m2."""
    return [*AREAS, float(found.quantiles(found.tails["area"], (0.5,))[0])]


def speeds_table(found: TailPosterior, winds: Sequence[float]) -> pd.DataFrame:
    """Simulated highest relative speed less the wind, over wind, gain and area.

    `others` says which the other numbers of the tail are: `the same`, of the most likely tail of all, or `best`, of the
    one that suits the area best.
    """
    scenario = load_rig_scenario("robot")
    areas = drawn_areas(found)
    likely = found.log_likelihood
    octaves = np.log2(found.tails["area"])
    best = [int(np.argmax(np.where(np.abs(octaves - np.log2(area)) < 0.5, likely, -np.inf))) for area in areas]
    frames = []
    for kp in sorted({one.kp for one in found.ranges}):
        for words, chosen in (("the same", [int(np.argmax(likely))] * len(areas)), ("best", best)):
            index = np.repeat(chosen, len(winds))
            tails = {name: values[index] for name, values in found.tails.items()}
            tails["area"] = np.repeat(areas, len(winds))
            wind = np.tile(np.asarray(winds, float), len(areas))
            extremes = swing_extremes(tails, wind, kp, scenario)
            columns = {"kp": kp, "others": words, "area_m2": tails["area"], "wind_speed_m_per_s": wind}
            rest = np.degrees(extremes.rest)
            frames.append(pd.DataFrame({**columns, "tail_speed_m_per_s": extremes.highest - wind, "rest_deg": rest}))
    return pd.concat(frames, ignore_index=True)


def swings_table(found: TailPosterior) -> pd.DataFrame:
    """All 30 published swings: highest row, tail speed after it, and what the posterior and the five areas give."""
    rows = published_table("robot_tail_drag")
    cells = rows.groupby(["source_table", "wind_speed_m_per_s", "kp", "swing"], sort=False, as_index=False)
    table = pd.DataFrame(cells.relative_velocity_m_per_s.max())
    table["published_tail_speed_m_per_s"] = table.relative_velocity_m_per_s - table.wind_speed_m_per_s
    table["used"] = ~table.source_table.isin(duplicated_robot_tables())
    speeds = speeds_table(found, sorted({one.wind for one in found.ranges}))
    for one, extremes in zip(found.ranges, found.extremes, strict=True):
        here = (table.wind_speed_m_per_s == one.wind) & (table.kp == one.kp) & table.used
        low, middle, high = found.quantiles(extremes.highest - one.wind, (0.025, 0.5, 0.975))
        names = ("posterior_lower95", "posterior_median", "posterior_upper95")
        for name, value in zip(names, (low, middle, high), strict=True):
            table.loc[here, f"{name}_m_per_s"] = value
        same = speeds[(speeds.others == "the same") & (speeds.kp == one.kp) & (speeds.wind_speed_m_per_s == one.wind)]
        for area, speed in same[["area_m2", "tail_speed_m_per_s"]].to_numpy(float).tolist():
            table.loc[here, f"area_{area:.3g}_m2_m_per_s"] = speed
    return table


def plot_speeds(found: TailPosterior, speeds: pd.DataFrame) -> Figure:
    """Published and simulated tail speeds over wind, a panel per gain, a line per area."""
    with styled():
        image, grid = new_figure(10.0, 5.4, columns=2)
        for axes, kp in zip(grid[0], sorted({one.kp for one in found.ranges}), strict=True):
            part = speeds[speeds.kp == kp]
            for colour, (area, lines) in zip(_COLOURS, part.groupby("area_m2", sort=False), strict=True):
                for words, line in lines.groupby("others"):
                    label = f"{area:.3g} m²" if words == "the same" and axes is grid[0][0] else None
                    style = "-" if words == "the same" else ":"
                    axes.plot(line.wind_speed_m_per_s, line.tail_speed_m_per_s, style, color=colour, label=label)
            _draw_published(axes, found, kp)
            axes.set_title(f"Kp {kp:g}")
            axes.set_xlabel("wind [m/s]")
            axes.set_ylim(0.0, None)
        grid[0][0].set_ylabel("highest relative speed less wind [m/s]")
        image.legend(loc="outside upper center", ncols=6, title="line: the same tail; dotted: the one that suits best")
    return image


def _draw_published(axes: Axes, found: TailPosterior, kp: float) -> None:
    """The interval of the nearest whole number thick, that of all readings thin."""
    for number, one in enumerate(one for one in found.ranges if one.kp == kp):
        speed = one.highest - one.wind
        axes.plot([one.wind] * 2, [speed - 1.0, speed + 1.0], color=BLACK, linewidth=1.0)
        label = "published" if number == 0 and kp == min(other.kp for other in found.ranges) else None
        axes.plot([one.wind] * 2, [speed - 0.5, speed + 0.5], color=BLACK, linewidth=5.0, alpha=0.6, label=label)
