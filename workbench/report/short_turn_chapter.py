"""The first chapter of the demo: one case of the short turn in step, what each candidate turns, and in how many."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from aerodima.workbench.figures.figure_style import BLACK, BLUE, GREY, new_figure, styled
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.metrics.turn_course import turn_course
from aerodima.workbench.metrics.turn_metrics import outcome_of
from aerodima.workbench.report.replay_page import replays_in_step
from aerodima.workbench.report.report_page import Bullets, Finding, Plot, Section
from aerodima.workbench.report.short_turn import PULSE, Entry, ShortTurn


def short_turn_chapter(table: ShortTurn, run_logs: Mapping[str, RunLog]) -> tuple[Section, Section]:
    """The replays with a sentence each, and the courses as bars.

    Args:
        table: what was measured.
        run_logs: name of a candidate -> its run in the case that is shown, steered as the last one.
    """
    who = table.entries.candidates
    names = [f"{one.words}: {_ending(run_logs[one.name])}" for one in who]
    shown = Section(
        "Same car, same floor, same steering",
        [
            replays_in_step([run_logs[one.name] for one in who], names),
            Finding([Bullets([_sentence(table, one, run_logs[one.name]) for one in who])]),
            _which_case(table),
        ],
    )
    bars = Plot(
        plot_courses(table),
        "Each with the steering that is best for it. Bar: median; band: least and largest; a dot per case, that of the "
        "replay in black.",
        "Course turned by a pulse of steering by each candidate, with its spread over the cases",
    )
    return shown, Section("How far each turns with its own best steering", [bars, *_how_far(table)])


def lead_of(table: ShortTurn, run_logs: Mapping[str, RunLog]) -> str:
    """One sentence for the top of the page."""
    who = table.entries.candidates
    over = [one.words.lower() for one in who if outcome_of(run_logs[one.name]).result == "flipped"]
    return (
        f"Same car, floor, speed and steering. Rolls over: {_listed(over) or 'nobody'}. The best swing "
        f"known turns the car by {_course(table, who[-1]):.0f}°; without a tail no steering gets it beyond "
        f"{_course(table, who[0]):.0f}°. The tail is a larger one than was built."
    )


def _listed(words: list[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _course(table: ShortTurn, one: Entry) -> float:
    """With its own best steering in the case that is shown, degrees."""
    return float(np.degrees(table.row(one.name)["course_change_rad"]))


def _ending(run_log: RunLog) -> str:
    course = turn_course(run_log).course_change_rad
    if outcome_of(run_log).result == "flipped":
        return "rolls over"
    return "stays upright" if course is None else f"turns {np.degrees(course):.0f}°"


def _sentence(table: ShortTurn, one: Entry, run_log: RunLog) -> str:
    own, angle = float(table.row(one.name)["steering_deg"]), table.steering_deg
    best = f"its own best steering, {own:.1f}°, turns its course by {_course(table, one):.1f}°."
    if own == angle:
        return f"{one.words}: {best} The others are steered alike. {one.chosen}".strip()
    return f"{one.words}: {_ending(run_log)} at {angle:.1f}° of steering; {best} {one.chosen}".strip()


def _which_case(table: ShortTurn) -> str:
    car, speed, floor = table.shown
    gains = 100.0 * table.gains
    place = list(table.gains.index).index(table.shown) + 1
    friction = float(table.row(table.entries.candidates[0].name)["friction"])
    return (
        f"This is no best case. By what the last candidate gains over the first, {gains[table.shown]:+.0f} %, it is "
        f"number {place} from below among the {len(gains)} of the table: the one in the middle, or the lesser of two. "
        f"They range from {gains.iloc[0]:+.0f} to {gains.iloc[-1]:+.0f} %. It is {car} of the ensemble at {speed:g} "
        f"m/s, steered for {PULSE:g} s on a floor of friction {friction:.2f}, {floor:g} times what the published "
        "swing survives at full lock."
    )


def _how_far(table: ShortTurn) -> list[str]:
    course = table.cases.pivot_table(
        index=["car", "speed_m_per_s", "floor"], columns="candidate", values="course_change_rad"
    )
    first, *others = table.entries.candidates
    said = []
    for one in others:
        gain = 100.0 * (course[one.name] / course[first.name] - 1.0)
        worst = gain.groupby(level="car").median().min()
        said.append(f"{one.words}: {gain.median():+.0f} % in the median, {worst:+.0f} % for the worst car")
    cars, floors = course.index.unique("car"), course.index.unique("floor")
    return [
        f"Over the car without a tail: {'; '.join(said)}. {len(cars)} cars on {len(floors)} floors, {len(course)} "
        "cases; none of these cars was used to choose a swing. A run counts that stays clean, rolls by 20° at most "
        "and leaves the turn without sliding.",
        "With the tail as it was built the best swing that was tried gains what the tail's own mass, low in the car, "
        "gains without a tail: docs/short_turn.md. The numbers are in models/short_turn/cases.csv; "
        "python -m tests.short_turn_table makes them again.",
    ]


def plot_courses(table: ShortTurn) -> Figure:
    """Course of each candidate: median, band over the cases, a dot for each."""
    who = table.entries.candidates
    with styled():
        image, grid = new_figure(9.0, 1.0 + 0.55 * len(who))
        axes = grid[0, 0]
        for place, one in enumerate(reversed(who)):
            own = table.cases[table.cases["candidate"] == one.name]
            values = np.degrees(own["course_change_rad"].to_numpy(float))
            median = float(np.median(values))
            axes.barh(place, median, color=BLUE, height=0.5)
            axes.barh(place, np.ptp(values), left=values.min(), color=BLUE, alpha=0.25, height=0.8)
            axes.plot(values, np.full(values.size, place), ".", color=GREY)
            axes.plot(_course(table, one), place, ".", color=BLACK, markersize=10)
            axes.text(values.max() + 0.5, place, f"{median:.1f}°", va="center")
        axes.set_yticks(range(len(who)), [one.words for one in reversed(who)])
        axes.set_xlabel("course turned [deg]")
    return image
