"""All rows of the report: what the thesis states, recomputed from the runs of the ensemble or from its own tables."""

from collections.abc import Sequence
from dataclasses import fields, replace

from aerodima.optimisation.calibration.calibration_plan import SPEED_IN_TURN
from aerodima.optimisation.calibration.calibration_runs import Datum, yaw_rate_of
from aerodima.optimisation.calibration.reproduction_evidence import (
    CLOSE,
    NO_FLICK_THROTTLE,
    ClaimRow,
    Evidence,
    basis_of,
    change_row,
    figure_row,
    missing_row,
    recomputed_row,
    share_row,
)
from aerodima.optimisation.identify.published_check import recompute_averages, robot_tail_line, robot_tail_rows
from aerodima.workbench.metrics.published_values import (
    FILTERED,
    SIGNALS,
    PublishedValues,
    TurnMetrics,
    flip_bracket,
    published_values,
)
from aerodima.workbench.report.report_page import metric_name, metric_unit
from aerodima.workbench.resources import published_table

MISSING = (
    ("Fig. 6.8", "throttle to steady speed", "the data of the figure are not in the text; the line is assumed"),
    (
        "Fig. 7.8, 7.10 to 7.13",
        "metrics over speed and tail speed",
        "no data of the figures; ours: `aerodima sweep run turn`",
    ),
    ("Fig. 7.9", "yaw penalty of the tail", "no data of the figure; ours: `aerodima sweep run mount`"),
    ("Table 2.1, chapter 5", "drag and lift of eight sail shapes", "CFD goals of the shapes are not in the text"),
    ("Tables 4.9 to 4.11, 10.x", "coefficients of the cheetah tails", "the wind-tunnel logs are not published"),
    ("Table 4.3", "positions of the rig", "printed as an image only"),
    ("7.2", "IMU and GPS signals of the physical turns", "the logs are not published; one run each is tabulated"),
    ("7.2.1", "Euler angle range of the physical flip", "neither unit nor axis are stated (ERRATA E35)"),
    ("8.1", "design speed of 20 m/s", "no run at that speed is published"),
)


OUTCOMES = ("tailless bracket", "tailed bracket", "real car with tail")
"""What stands in the rows of the brackets, by the names of the plan."""
PRINTED = 0.01
"""Last printed digit of a gain, %."""


def all_rows(evidence: Evidence) -> list[ClaimRow]:
    """Every row, in the order of the thesis; what agreement with it is worth follows from the plan of the ensemble."""
    return [
        *_tables_of_chapter_4_and_6(),
        *_brackets(evidence),
        *(_figure(evidence, datum) for datum in evidence.data),
        *_changes(evidence),
        *_gains(),
        *_kohut(evidence),
        _no_flick(evidence),
        *(missing_row(*entry) for entry in MISSING),
    ]


def _said(evidence: Evidence) -> str:
    return f"{len(evidence.members)} members of the ensemble"


def _tables_of_chapter_4_and_6() -> list[ClaimRow]:
    averages = recompute_averages()
    rows = []
    for entry in averages.to_dict("records"):
        rows.append(
            recomputed_row(
                str(entry["table"]),
                f"weighted average: {entry['quantity']}",
                "",
                float(entry["published"]),
                float(entry["weighted"]),
                bool(entry["agrees"]),
                "recomputed from the printed single fits (eqs 4.29 to 4.31)",
            )
        )
    mean = float(robot_tail_rows().cd.mean())
    line = robot_tail_line()
    rows.append(
        recomputed_row(
            "6.3.3",
            "one drag coefficient for the robot tail",
            "1",
            2.0,
            mean,
            abs(mean - 2.0) <= CLOSE * 2.0,
            f"mean of 160 distinct printed values; line {line['slope'].value:.4f} v + {line['intercept'].value:.3f}",
        )
    )
    return rows


def _brackets(evidence: Evidence) -> list[ClaimRow]:
    none, swing = flip_bracket("tailless"), flip_bracket("tailed")
    fastest = _physical("tailed").metrics.speed_m_per_s
    said = _said(evidence)
    tailless, tailed, real = (evidence.basis_of_outcome(name) for name in OUTCOMES)
    survived, flipped = evidence.survived("none", none.survived), evidence.flipped("none", none.flipped)
    return [
        share_row("7.1.1", f"no tail: survives {none.survived:g} m/s", survived, said, tailless),
        share_row("7.1.1", f"no tail: flips at {none.flipped:g} m/s", flipped, said, tailless),
        share_row(
            "7.1.2",
            f"tail: survives {swing.survived:g} m/s",
            evidence.survived("swing", swing.survived),
            f"{said}; tails as the ensemble has them, see how it was made{_tipped(evidence, 'swing', swing.survived)}",
            tailed,
        ),
        share_row(
            "7.1.2",
            f"tail: flips at {swing.flipped:g} m/s",
            evidence.flipped("swing", swing.flipped),
            f"{said}; flips in the turn only, tipping over before it is not counted",
            tailed,
        ),
        share_row(
            "7.2.2",
            f"tail: survives {fastest:g} m/s",
            evidence.survived("swing", fastest),
            f"{said}; turn of the simulation, tail swung at 8 rad/s{_tipped(evidence, 'swing', fastest)}",
            real,
        ),
    ]


def _tipped(evidence: Evidence, mode: str, speed: float) -> str:
    """What of the weight says nothing about a turn, because it tipped over before or failed."""
    share = evidence.tipped(mode, speed)
    return f"; {share:.0%} of the weight tipped over before its turn" if share > 0.0 else ""


def _physical(configuration: str) -> PublishedValues:
    return next(r for r in published_values() if (r.platform, r.configuration) == ("physical", configuration))


def _figure(evidence: Evidence, datum: Datum) -> ClaimRow:
    name = metric_name(datum.metric)
    if datum.use == "commanded":
        missing = "an input of the run: the speed is commanded, so nothing is predicted"
        return missing_row(datum.source, name, missing)
    mode, speed = datum.turn.tail_mode, datum.turn.speed
    note = f"{_said(evidence)}, {evidence.survived(mode, speed):.0%} of the weight survived, numbers of these"
    note += f"; {SIGNALS['physical' if datum.column.startswith(FILTERED) else 'simulated']}"
    note += _tipped(evidence, mode, speed)
    if datum.metric == "roll_integral_rad":
        note += "; the printed sum has no time step, one is inferred (ERRATA E35)"
    if datum.metric == SPEED_IN_TURN:
        note += "; mean Kohut over mean yaw rate, if Kohut was taken sample by sample (ERRATA E36)"
    if datum.metric != yaw_rate_of(datum.metric):
        note += "; the yaw rate times the commanded speed, no figure of its own"
    return figure_row(
        datum.source,
        name,
        metric_unit(datum.metric),
        datum.figure,
        evidence.column(mode, speed, datum.column),
        evidence.weights,
        note,
        basis_of(datum),
    )


def _changes(evidence: Evidence) -> list[ClaimRow]:
    """Tailed against tailless, best runs of each platform (ERRATA E34); each follows from two rows of figures."""
    rows = []
    for platform, places in (("simulated", ("Table 7.1", "Table 7.2")), ("physical", ("Table 7.3", "Table 7.4"))):
        for field in fields(TurnMetrics):
            if field.name == "speed_m_per_s":
                continue
            none, swing = (evidence.datum(place, field.name) for place in places)
            before, after = (evidence.column(d.turn.tail_mode, d.turn.speed, d.column) for d in (none, swing))
            note = (
                f"{_said(evidence)}; two runs at two speeds, so most of a change is the speed's; follows from the rows"
            )
            note += f" of {none.source} and {swing.source}"
            fitted = [datum.source for datum in (none, swing) if basis_of(datum) == "calibrated to"]
            if fitted:
                note += f", calibrated to that of {' and '.join(fitted)}"
            if field.name != yaw_rate_of(field.name):
                note += "; the yaw rate times the commanded speed, no figure of its own"
            found = change_row(
                f"{none.source} to {swing.source[-3:]}",
                f"{metric_name(field.name)}, best run with tail over best without ({platform})",
                100.0 * (swing.figure / none.figure - 1.0),
                100.0 * (after / before - 1.0),
                evidence.weights,
                note,
            )
            rows.append(replace(found, basis="calibrated to" if fitted else "prediction"))
    return rows


def _gains() -> list[ClaimRow]:
    """Claims that are arithmetic on the thesis' own numbers."""
    none, swing = flip_bracket("tailless"), flip_bracket("tailed")
    slow, fast = _physical("tailless").metrics, _physical("tailed").metrics
    claims: Sequence[tuple[str, str, float, float, str]] = (
        ("7.1.3", "simulated gain of speed, flip to flip", 23.0, 100 * (swing.flipped / none.flipped - 1), "E32"),
        ("7.2.3", "physical gain of speed", 81.01, 100 * (fast.speed_m_per_s / slow.speed_m_per_s - 1), "E33"),
        (
            "abstract, 7.2.3",
            "physical change of the roll integral",
            -37.16,
            100 * (fast.roll_integral_rad / slow.roll_integral_rad - 1),
            "E33",
        ),
        (
            "abstract, 7.2.3",
            "physical gain of the largest Kohut",
            88.80,
            100 * (fast.max_kohut_deg_m_per_s2 / slow.max_kohut_deg_m_per_s2 - 1),
            "E33",
        ),
    )
    return [
        recomputed_row(
            place,
            claim,
            "%",
            figure,
            ours,
            abs(ours - figure) <= PRINTED,
            f"arithmetic on the printed numbers only (ERRATA {erratum})",
        )
        for place, claim, figure, ours, erratum in claims
    ]


def _kohut(evidence: Evidence) -> list[ClaimRow]:
    datum = evidence.datum("Table 7.1", "max_kohut_deg_m_per_s2")
    none = datum.turn.speed
    ours = evidence.column(datum.turn.tail_mode, none, datum.column)
    rows = []
    for robot in published_table("kohut_robots").to_dict("records"):
        share = float(evidence.weights @ (ours > float(robot["kohut_deg_m_per_s2"])))
        rows.append(
            share_row(
                "Table 3.1",
                f"larger Kohut, no tail, than {robot['robot']} ({robot['kohut_deg_m_per_s2']:g})",
                share,
                f"{_said(evidence)} at {none:g} m/s; other robots as printed, not simulated; speed times yaw rate, so "
                "a faster robot has more of it without turning better",
                basis_of(datum),
            )
        )
    return rows


def _no_flick(evidence: Evidence) -> ClaimRow:
    speed = evidence.held_speed
    return share_row(
        "7.2.2",
        f"a held tail keeps the car upright at {100 * NO_FLICK_THROTTLE:.0f} % throttle, as where it did not swing",
        evidence.survived("held", speed),
        f"{_said(evidence)}, tail held, {speed:.2f} m/s by the assumed throttle line; shows that "
        f"holding suffices in the model, not why the robot's trigger was silent{_tipped(evidence, 'held', speed)}",
    )
