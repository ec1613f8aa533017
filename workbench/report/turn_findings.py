"""What a set of turns comes to, and the sentences that say it. Every number is an argument; none is written here."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from aerodima.workbench.figures.figure_style import MODE_STYLES, modes_of
from aerodima.workbench.metrics.published_values import Comparison, FlipBracket, PublishedValues
from aerodima.workbench.metrics.run_summary import RunSummary
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING
from aerodima.workbench.report.report_page import degrees, metric_name, percent, span

SPEED_ROUNDING = 0.015
"""Published speeds are rounded to 0.01 m/s: speeds this close (m/s) are the same."""


@dataclass(frozen=True)
class Bracket:
    """What the runs of one tail mode say about rollover.

    Attributes:
        survived: highest commanded speed survived, m/s; None if none was.
        flipped: lowest commanded speed flipped at, m/s; None if none was.
        lowest: lowest speed of the runs, m/s.
        highest: highest, m/s.
    """

    survived: float | None
    flipped: float | None
    lowest: float
    highest: float


def bracket_of(summaries: Sequence[RunSummary]) -> Bracket:
    """Bracket of the runs of one tail mode."""
    speeds = [s.commanded_speed for s in summaries]
    return Bracket(
        survived=max((s.commanded_speed for s in summaries if s.survived), default=None),
        flipped=min((s.commanded_speed for s in summaries if not s.survived), default=None),
        lowest=min(speeds),
        highest=max(speeds),
    )


def bracket_in_words(bracket: Bracket) -> str:
    """For example `survives up to 3.33 m/s and flips from 3.61 m/s on`."""
    if bracket.flipped is None:
        return f"survives every speed from {bracket.lowest:.2f} to {bracket.highest:.2f} m/s"
    if bracket.survived is None:
        return f"flips at every speed from {bracket.lowest:.2f} to {bracket.highest:.2f} m/s"
    if bracket.survived < bracket.flipped:
        return f"survives up to {bracket.survived:.2f} m/s and flips from {bracket.flipped:.2f} m/s on"
    return (
        f"flips first at {bracket.flipped:.2f} m/s, yet survives {bracket.survived:.2f} m/s: survival is not monotone "
        "in the speed"
    )


def mode_and_bracket(summaries: Sequence[RunSummary], mode: str) -> str:
    """Tail mode and bracket of its runs, in words."""
    bracket = bracket_of([s for s in summaries if s.tail_mode == mode])
    return f"{MODE_STYLES[mode].words.capitalize()}: {bracket_in_words(bracket)}"


def bracket_verdict(bracket: Bracket, published: FlipBracket) -> str:
    """How a bracket compares with the published one, in words and m/s."""
    said = f"Published: survives {published.survived:.2f} m/s, flips at {published.flipped:.2f} m/s."
    if bracket.survived is None:
        return f"{said} The runs do not meet this: none of them survives."
    if bracket.flipped is None:
        if bracket.highest < published.flipped - SPEED_ROUNDING:
            return f"{said} No run is fast enough to tell."
        more = bracket.highest - published.flipped
        reach = f"{more:.2f} m/s faster than that" if more > SPEED_ROUNDING else "as fast as that"
        return (
            f"{said} The first half is met, the second is not: the car of this report is upright at "
            f"{bracket.highest:.2f} m/s, {reach}, and where it would flip is not known from these runs."
        )
    same = (
        abs(bracket.survived - published.survived) <= SPEED_ROUNDING
        and abs(bracket.flipped - published.flipped) <= SPEED_ROUNDING
    )
    if same:
        return f"{said} The runs meet this bracket."
    survived, flipped = bracket.survived - published.survived, bracket.flipped - published.flipped
    return f"{said} The runs differ by {survived:+.2f} m/s (survived) and {flipped:+.2f} m/s (flipped)."


def misses_in_words(comparisons: Sequence[Comparison], most: int = 3) -> str:
    """The largest differences relative to the published figures."""
    ordered = sorted(comparisons, key=lambda c: -abs(c.relative))
    parts = [f"{metric_name(c.metric)} {percent(c.relative)}" for c in ordered[:most]]
    return ", ".join(parts[:-1]) + f" and {parts[-1]}" if len(parts) > 1 else "".join(parts)


def close_metrics(comparisons: Sequence[Comparison], share: float) -> int:
    """How many metrics lie within `share` of the published figure."""
    return sum(abs(c.relative) <= share for c in comparisons)


def tipping_sentences(car: dict[str, Any], gravity: float, published: PublishedValues, run: RunSummary) -> list[str]:
    """Why flip bracket and published lateral acceleration do not go together, from the statics of a rigid car.

    Args:
        car: section `car` of the scenario; a log from before tyres had shapes stood on ellipsoids.
        gravity: m/s2.
        published: the row of the tailless car.
        run: the run that corresponds to it.
    """
    edge = 0.5 * float(car["tyre_width"]) if car.get("tyre_shape") == "cylinder" else 0.0
    half_width, height = 0.5 * float(car["track"]) + edge, float(car["com_height"])
    threshold = gravity * half_width / height
    peak = published.metrics.max_linear_acceleration_m_per_s2
    raw = run.metrics.raw.max_linear_acceleration_m_per_s2
    filtered = run.metrics.filtered.max_linear_acceleration_m_per_s2
    first = (
        f"A rigid car whose tyres stand {half_width:.3f} m beside its middle, with its centre of mass at {height:.3f} "
        f"m, tips from {threshold:.2f} m/s² of lateral acceleration on; springs and tyres let this one lean, so it "
        f"tips at less. The published car all but flips at this speed, and its largest lateral acceleration is "
        f"{peak:.2f} m/s², {percent(peak / threshold - 1.0)} beside the rigid car's."
    )
    second = (
        f"With the friction of {float(car['tyre_friction']):.2f} that it takes to flip this car, the run reaches "
        f"{raw:.2f} m/s² raw ({raw - peak:+.2f}) and {filtered:.2f} m/s² filtered ({filtered - peak:+.2f})."
    )
    cornering = published.metrics.speed_m_per_s * published.metrics.max_yaw_rate_rad_per_s
    third = (
        f"The published figures are not of one steady turn either: speed times largest yaw rate is {cornering:.2f} "
        f"m/s², {cornering - peak:+.2f} m/s² beside the published largest acceleration, so the car slid."
    )
    return [first, second, third if cornering > peak else ""]


def reference_run(summaries: Sequence[RunSummary]) -> RunSummary | None:
    """The fastest clean run without tail: what any claim about a faster turn is measured against."""
    clean = [s for s in summaries if s.tail_mode == "none" and s.clean]
    return max(clean, key=lambda s: s.commanded_speed, default=None)


def faster_claim(summaries: Sequence[RunSummary], mode: str, reference: RunSummary) -> str:
    """Whether runs of a tail mode may be called a faster turn than the reference: clean, and turned as far."""
    needed = LEAST_HEADING * reference.metrics.heading_change_rad
    clean = [s for s in summaries if s.tail_mode == mode and s.clean]
    faster = [s for s in clean if s.commanded_speed > reference.commanded_speed + SPEED_ROUNDING]
    words = MODE_STYLES[mode].words
    if not faster:
        return f"{words.capitalize()}: no clean run is faster than the reference."
    valid = [s for s in faster if s.metrics.heading_change_rad >= needed]
    if valid:
        best = max(valid, key=lambda s: s.commanded_speed)
        gain = best.commanded_speed / reference.commanded_speed - 1.0
        return (
            f"{words.capitalize()}: turns faster, up to {best.commanded_speed:.2f} m/s ({percent(gain)}) with "
            f"{degrees(best.metrics.heading_change_rad)} of heading change."
        )
    most = max(faster, key=lambda s: s.metrics.heading_change_rad)
    share = most.metrics.heading_change_rad / reference.metrics.heading_change_rad
    return (
        f"{words.capitalize()}: no claim of a faster turn holds. Of the clean runs that are faster, up to "
        f"{max(s.commanded_speed for s in faster):.2f} m/s, the one that turns furthest ({most.commanded_speed:.2f} "
        f"m/s) changes its heading by {degrees(most.metrics.heading_change_rad)}, {100 * share:.0f} % of the "
        "reference."
    )


def held_beside_swing(summaries: Sequence[RunSummary]) -> str:
    """At how many speeds the swung tail leaned less than the held one, and where the difference is largest."""
    held = {s.commanded_speed: s for s in summaries if s.tail_mode == "held" and s.survived}
    pairs = [
        (held[s.commanded_speed], s)
        for s in summaries
        if s.tail_mode == "swing" and s.survived and s.commanded_speed in held
    ]
    if not pairs:
        return ""
    lean = [math.degrees(b.metrics.peak_roll_rad - a.metrics.peak_roll_rad) for a, b in pairs]
    less = sum(change < 0.0 for change in lean)
    most = max(range(len(pairs)), key=lambda place: abs(lean[place]))
    return (
        f"Held and swung side by side: at {less} of {len(pairs)} speeds the swinging car leans less than the one that "
        f"holds its tail; the largest difference of the peak roll is {lean[most]:+.1f}° at "
        f"{pairs[most][1].commanded_speed:.2f} m/s (swing less held)."
    )


def trigger_sentences(summaries: Sequence[RunSummary], threshold: float, steering_back: float) -> list[str]:
    """At which speeds the swing begins late (after the wheels are steered back) or never, and why."""
    swings = [s for s in summaries if s.tail_mode == "swing"]
    never = [s for s in swings if s.trigger_time is None]
    late = [s for s in swings if s.trigger_time is not None and s.trigger_time >= steering_back]
    sentences = []
    for run in late:
        assert run.trigger_time is not None
        sentences.append(
            f"At {run.commanded_speed:.2f} m/s the swing begins only at {run.trigger_time:.2f} s, "
            f"{run.trigger_time - steering_back:.2f} s after the wheels were steered back."
        )
    for run in never:
        sentences.append(
            f"At {run.commanded_speed:.2f} m/s the tail never swings: the IMU's yaw rate reaches {run.peak_gyro:.2f} "
            "rad/s."
        )
    if sentences:
        slowest = max([*late, *never], key=lambda s: s.commanded_speed).metrics.raw
        cornering = slowest.average_linear_acceleration_m_per_s2 / slowest.speed_m_per_s
        sentences.insert(
            0,
            f"The controller waits for a yaw rate of {threshold:g} rad/s into the turn. Sliding tyres give an upright "
            "car no more than their friction, so its yaw rate falls as the speed rises: at "
            f"{slowest.speed_m_per_s:.2f} m/s a mean lateral acceleration of "
            f"{slowest.average_linear_acceleration_m_per_s2:.2f} m/s² bends the path at {cornering:.2f} rad/s only, "
            "and the threshold is met late or never.",
        )
    elif swings:
        sentences.append(f"In every run the yaw rate passes {threshold:g} rad/s while the wheels are still steered.")
    return sentences


def impulse_sentence(summaries: Sequence[RunSummary]) -> str:
    """Ranges of the impulses by cause over the runs of one tail mode."""
    runs = [s.over_window for s in summaries if s.over_window is not None]
    parts = [
        f"{words} {span([getattr(run, cause) for run in runs])}"
        for cause, words in (("aerodynamic", "air"), ("weight", "weight"), ("inertial", "inertia"))
    ]
    return ", ".join(parts) + " N m s"


def jolt_sentence(summaries: Sequence[RunSummary]) -> str:
    """Says that raw peaks of the lateral acceleration are jolts where filtering takes away a large part of them."""
    jolted = [s for s in summaries if s.metrics.jolted]
    if not jolted:
        return ""
    torque = max(s.metrics.tail_torque_peak_n_m or 0.0 for s in jolted)
    modes = ", ".join(MODE_STYLES[mode].words for mode in modes_of(jolted))
    raw = span([s.metrics.raw.max_linear_acceleration_m_per_s2 for s in jolted])
    filtered = span([s.metrics.filtered.max_linear_acceleration_m_per_s2 for s in jolted])
    return (
        f"In {len(jolted)} runs ({modes}) the largest raw lateral acceleration, {raw} m/s², is a jolt of the tail "
        f"motor at the IMU (up to {torque:.1f} N m) and not cornering: in the IMU's 100 Hz after the 5 Hz filter "
        f"{filtered} m/s² are left."
    )
