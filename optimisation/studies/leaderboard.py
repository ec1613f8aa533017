"""The leaderboard as one piece of work: store, runs, tables, replays."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from aerodima.optimisation.studies.contestants import Contestant, Plan, standard_contestants, swing_player, trackings_of
from aerodima.optimisation.studies.leaderboard_page import write_leaderboard
from aerodima.optimisation.studies.leaderboard_runs import SCENARIO, Leaderboard, Measurer
from aerodima.optimisation.sweep.rollover_threshold import SPEED
from aerodima.optimisation.sweep.study_engine import RememberingEngine, RunEngine
from aerodima.workbench.batch.engine import ProgressLine, silent
from aerodima.workbench.batch.row_store import RowStore, saying_how_to_go_on
from aerodima.workbench.config.ensemble import Member
from aerodima.workbench.config.scenario import default_values, load_scenario
from aerodima.workbench.controllers.law_of_scenario import refuse_other_car
from aerodima.workbench.logs.schema import software_versions
from aerodima.workbench.metrics.turn_metrics import LEAST_HEADING


def make_leaderboard(
    out: Path,
    plan: Plan,
    swings: Sequence[str],
    members: Sequence[Member],
    engine: RunEngine,
    *,
    replays: bool = True,
    force: bool = False,
    progress: ProgressLine = silent,
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
        progress: takes lines of text.

    Raises:
        UserError: a swing cannot be read or is for another car; the folder is in use, or holds the runs of other
            parameters or versions.
    """
    for place in swings:
        player = swing_player(place)
        refuse_other_car(load_scenario(SCENARIO, player.settings), way_out="")
    with open_runs(out, force=force) as store:
        remembering = RememberingEngine(engine, store, progress)
        with saying_how_to_go_on(progress, lambda: f"{len(store.rows)} runs"):
            board = measure(plan, swings, members, remembering)
        progress(f"{remembering.ran} runs made, the others were there")
    films = _replays(out, board, plan, progress) if replays else {}
    cars = f"{len(members)} cars drawn from the ensemble" if members else "the nominal car alone"
    how = (
        f"{cars}; speeds {', '.join(f'{speed:g}' for speed in plan.speeds)} m/s; step {1000 * plan.step:g} ms, of the "
        f"claims {1000 * plan.fine_step:g} ms; critical friction on a grid of {plan.friction.tolerance:g}; highest "
        f"speed at {plan.grip:g} times the friction of the nominal car."
    )
    return board, write_leaderboard(out, board, films, how)


def measure(plan: Plan, swings: Sequence[str], members: Sequence[Member], engine: RememberingEngine) -> Leaderboard:
    """Runs everything.

    Args:
        plan: how much.
        swings: files or names.
        members: of the ensemble; none leaves the nominal car.
        engine: that remembers.
    """
    board = Measurer(plan, members, engine)
    contestants = standard_contestants(swings)
    contestants.insert(3, board.best_fixed_speed())
    claims = board.claims(contestants)
    frictions = board.critical_frictions(contestants)
    players = [way for swing in _best_swing(contestants, claims, plan) for way in trackings_of(swing)]
    robustness = board.robustness(players) if plan.perturbed and players else pd.DataFrame()
    runs = board.own_friction(contestants)
    speeds = board.highest_speeds(contestants)
    survival = board.survival_map(contestants)
    return Leaderboard(claims, frictions, runs, speeds, survival, robustness, tuple(contestants))


def _best_swing(contestants: Sequence[Contestant], claims: pd.DataFrame, plan: Plan) -> list[str]:
    """The swing file of the controller that claims most at the middle speed; turning far enough counts first."""
    best: tuple[tuple[bool, float], list[str]] = ((False, 0.0), [])
    for contestant in contestants:
        playing = [setting.partition("=")[2] for setting in contestant.at(plan.middle_speed)]
        played = [swing for swing in contestant.swings if swing in playing]
        here = claims[(claims["controller"] == contestant.name) & (claims["speed_m_per_s"] == plan.middle_speed)]
        for row in here.to_dict("records"):
            rank = (bool(row["heading_ratio"] >= LEAST_HEADING), float(row["critical_friction"]))
            if played and rank > best[0]:
                best = (rank, played)
    return best[1]


def open_runs(out: Path, *, force: bool = False) -> RowStore:
    """The store of runs below a folder, of these parameters and versions."""
    identity = {
        "schema": "aerodima/leaderboard/5",
        "parameters": default_values(),
        "scenario": load_scenario(SCENARIO).resolved(),
        "versions": software_versions(),
    }
    return RowStore(out / "runs.jsonl", identity, force=force)


def _replays(out: Path, board: Leaderboard, plan: Plan, progress: ProgressLine) -> dict[str, str]:
    from aerodima.workbench.report.replay_page import write_replay_html
    from aerodima.workbench.simulate.simulation import simulate

    films = {}
    (out / "replays").mkdir(parents=True, exist_ok=True)
    for number, contestant in enumerate(board.contestants):
        progress(f"replay of {contestant.name}")
        speed = plan.middle_speed
        settings = [*contestant.at(speed), f"{SPEED}={speed!r}", f"name={contestant.name}"]
        target = f"replays/{number}.html"
        write_replay_html(simulate(load_scenario(SCENARIO, settings)), out / target, force=True)
        films[contestant.name] = target
    return films
