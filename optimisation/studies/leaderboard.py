"""The leaderboard as one piece of work: store, runs, tables, replays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from aerodima.optimisation.studies.contestants import Plan
from aerodima.optimisation.studies.leaderboard_page import write_leaderboard
from aerodima.optimisation.studies.leaderboard_runs import SCENARIO, Leaderboard, measure
from aerodima.optimisation.sweep.rollover_threshold import SPEED
from aerodima.optimisation.sweep.study_engine import Engine, RememberingEngine
from aerodima.workbench.batch.row_store import RowStore, saying_how_to_go_on
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import default_values, load_scenario
from aerodima.workbench.logs.schema import software_versions

Say = Callable[[str], None]


def make_leaderboard(
    out: Path,
    plan: Plan,
    swings: Sequence[str],
    members: Sequence[Member],
    engine: Engine,
    *,
    replays: bool = True,
    force: bool = False,
    say: Say | None = None,
) -> tuple[Leaderboard, list[Path]]:
    """Runs what the folder does not hold yet, and writes tables and page.

    Args:
        out: folder; runs are kept in its `runs.jsonl`.
        plan: how much is run; a wider plan goes on with the runs of a narrower one.
        swings: files or names of optimised swings.
        members: of the ensemble; none leaves the car of the parameter files.
        engine: where to run.
        replays: also write a replay of each controller at the middle speed.
        force: drop the runs of other parameters or versions.
        say: told lines of progress.

    Raises:
        UserError: a swing cannot be read; the folder is in use, or holds the runs of other parameters or versions.
    """
    say = say or (lambda line: None)
    with open_runs(out, force=force) as store:
        remembering = RememberingEngine(engine, store, say)
        with saying_how_to_go_on(say, lambda: f"{len(store.rows)} runs"):
            board = measure(plan, swings, members, remembering)
        say(f"{remembering.ran} runs made, the others were there")
    films = _replays(out, board, plan, say) if replays else {}
    cars = f"{len(members)} cars drawn from the ensemble" if members else "the own car alone"
    how = (
        f"{cars}; speeds {', '.join(f'{speed:g}' for speed in plan.speeds)} m/s; step {1000 * plan.step:g} ms, of the "
        f"claims {1000 * plan.fine_step:g} ms; critical friction on a grid of {plan.friction.tolerance:g}; highest "
        f"speed at {plan.grip:g} times the friction of the own car."
    )
    return board, write_leaderboard(out, board, films, how)


def open_runs(out: Path, *, force: bool = False) -> RowStore:
    """The store of runs below a folder, of these parameters and versions."""
    identity = {
        "schema": "aerodima/leaderboard/3",
        "parameters": default_values(),
        "scenario": load_scenario(SCENARIO).resolved(),
        "versions": software_versions(),
    }
    return RowStore(out / "runs.jsonl", identity, force=force)


def _replays(out: Path, board: Leaderboard, plan: Plan, say: Say) -> dict[str, str]:
    from aerodima.workbench.report.replay_page import write_replay_html
    from aerodima.workbench.simulate.simulation import simulate

    films = {}
    (out / "replays").mkdir(parents=True, exist_ok=True)
    for number, contestant in enumerate(board.contestants):
        say(f"replay of {contestant.name}")
        speed = plan.middle_speed
        settings = [*contestant.at(speed), f"{SPEED}={speed!r}", f"name={contestant.name}"]
        target = f"replays/{number}.html"
        write_replay_html(simulate(load_scenario(SCENARIO, settings)), out / target, force=True)
        films[contestant.name] = target
    return films
