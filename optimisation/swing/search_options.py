"""What may be asked of a search for a swing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from aerodima.optimisation.swing.solver import SolverName
from aerodima.optimisation.swing.transcription import Objective

Told = Callable[[str], None]
"""Takes progress, line by line."""

LATER = ("warm_start", "ensemble", "members", "polish", "feedback")
"""Options that do nothing by default; a swing that did without them does not name them."""


@dataclass(frozen=True)
class SearchOptions:
    """Options of a search; stored with the swing, so that it can be repeated.

    Attributes:
        dof: 1 roll, 2 roll and pitch.
        objective: see `transcription.Problem`.
        seed, starts: of the random starts of the first round.
        knots: of the first mesh; `length` of the swing from its release, s.
        threshold: yaw rate that releases the swing, rad/s; None keeps the scenario's.
        wait: the tail rests this long after the release, s; 0 leaves it free.
        torque: limit of each motor, N m; None is the motor's.
        rounds: at most this many; 0 only polishes: a warm start, or an even swing with the scenario's rate and release.
        trust: how far friction or speed may go beyond those of the profile's run in one round, as a share.
        bound: largest collocation error, rad.
        solver: snopt or ipopt.
        iterations: of the solver; with the seed they make the search repeatable.
        warm_start: name or path of the swing that the search begins with, for the record.
        members: cars drawn from the `ensemble` that the swing must serve as well; 0 is the scenario's car alone.
        polish: candidates that are driven to polish the swing on the full car; 0 is none.
        feedback: gains of a tracker are stored with the swing.
        wall_time: s, of the collocation; a polish has its own limit, the number of candidates.
    """

    dof: int = 1
    objective: Objective = "friction"
    seed: int = 1
    starts: int = 4
    knots: int = 41
    length: float = 1.0
    threshold: float | None = None
    wait: float = 0.0
    torque: float | None = None
    rounds: int = 4
    trust: float = 0.08
    bound: float = 5e-3
    solver: SolverName = "snopt"
    iterations: int = 300
    warm_start: str = ""
    ensemble: str = "car"
    members: int = 0
    polish: int = 0
    feedback: bool = False
    wall_time: float = 600.0

    def stored(self) -> dict[str, float | int | str]:
        """For the provenance of a swing: everything but the wall time, which decides nothing unless it is over."""
        plain = {field.name: field.default for field in fields(self) if field.name in LATER}
        return {
            key: int(value) if isinstance(value, bool) else value
            for key, value in self.__dict__.items()
            if value is not None and key != "wall_time" and (key not in plain or value != plain[key])
        }
