"""Fits of many logs: parallel, resumable, and one bad log does not stop the others.

Every finished log adds a line to `fits.jsonl` in the output folder. A second call with the same
settings reads those lines and only works on what is missing, has changed since, or was fitted by
other versions of the software.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from pydantic import TypeAdapter

from aerodima.optimisation.identify.fit_result import FitResult
from aerodima.workbench.batch.engine_factory import run_batch
from aerodima.workbench.batch.row_store import (
    WORKER_RECORD,
    ProgressBar,
    ProgressLine,
    RowStore,
    content_key,
    no_progress,
    print_resume_hint,
    read_rows,
)
from aerodima.workbench.core.errors import FitError, UserError
from aerodima.workbench.core.file_reading import Json
from aerodima.workbench.core.key_errors import require_unique
from aerodima.workbench.logs.schema import software_versions

JOURNAL = "fits.jsonl"
_RESULT = TypeAdapter(FitResult)
WORKER_KILLED = "its worker process was killed, beside other fits and alone (out of memory?)"
Fit = Callable[[str], FitResult]


@dataclass(frozen=True)
class BatchResult:
    """Outcome of a batch.

    Attributes:
        results: results of the logs that were fitted, in the order of the logs.
        failed: reason why a log could not be fitted, by log.
        reused: number of logs whose outcome was there already.
    """

    results: list[FitResult]
    failed: dict[str, str]
    reused: int = 0


def fit_logs(
    work: Fit,
    logs: Sequence[Path | str],
    out: Path,
    *,
    settings: Json,
    workers: int = 1,
    force: bool = False,
    progress: ProgressLine = no_progress,
) -> BatchResult:
    """Fit every log and keep what is finished in `out`.

    Args:
        work: module-level function, or `functools.partial` of one, that fits the log of a path.
        logs: paths of the logs.
        out: output folder; made when it is not there.
        settings: settings of the fit, JSON-able; results of others are refused unless `force`.
        workers: number of processes.
        force: whether to drop earlier results.
        progress: function that receives lines of progress.

    Raises:
        FitError: a log is named twice, none is named, or the folder holds other settings' results.
    """
    names = _unique(logs)
    keys = {name: _key(name) for name in names}
    identity = {"settings": settings}
    lines = read_rows(out / JOURNAL)
    if lines and lines[0] != json.loads(json.dumps(identity)):
        # A journal of other settings without a result has nothing that could be lost.
        force = force or not any(line.get("result") for line in lines)
    with RowStore(out / JOURNAL, identity, force=force, error=FitError) as store:
        done = {name: store.rows[key] for name, key in keys.items() if key in store.rows}
        missing = [name for name in names if name not in done]
        reused = len(done)
        bar = ProgressBar(progress, len(names), reused)

        def keep(_index: int, line: Json) -> None:
            name = line["log"]
            if line["error"] != WORKER_KILLED:  # a second call tries it again
                store.add(keys[name], line)
            done[name] = line
            bar.advance(Path(name).name)

        with print_resume_hint(progress, lambda: f"{bar.done} of {len(names)} fits"):
            record = out / WORKER_RECORD
            fit_log = partial(_fit_log, work)
            run_batch(fit_log, missing, workers, keep, _failed, progress=progress, record=record)
    outcomes = [done[name] for name in names]
    return BatchResult(
        [
            _RESULT.validate_python(line["result"])
            for line in outcomes
            if line["result"] is not None
        ],
        {line["log"]: line["error"] for line in outcomes if line["error"]},
        reused,
    )


def _unique(logs: Sequence[Path | str]) -> list[str]:
    """Return the names of the logs; FitError when one is named twice, or none is named."""
    names = [str(path) for path in logs]
    if not names:
        raise FitError("no log is named")
    require_unique(names, "log", FitError)
    return names


def _fit_log(work: Fit, name: str) -> Json:
    """Return the outcome of one log as plain data; errors of the log included."""
    try:
        return {"log": name, "result": asdict(work(name)), "error": ""}
    except (UserError, OSError) as error:
        return _failed(name, str(error).removeprefix(f"{name}: "))
    except Exception as error:  # whatever one log brings up must not cost the others
        return _failed(name, f"{type(error).__name__} in its fit: {error}")


def _failed(name: str, reason: str = WORKER_KILLED) -> Json:
    return {"log": name, "result": None, "error": reason}


def _key(name: str) -> str:
    """Make a hash that changes with the log, its file or the versions of the software."""
    try:
        state = Path(name).stat()
    except OSError:
        return f"{name} is missing"
    return content_key(name, state.st_size, state.st_mtime_ns, software_versions())
