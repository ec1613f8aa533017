"""Kills one worker at a random moment of each of many short studies, while the computer is busy
with other work.

Fails if a run is missing from a table, stands in it twice, or a study takes longer than
`MOST_SECONDS`.

Example: python -m tests.kill_loop --kills 100
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from aerodima.workbench.batch.engine_factory import open_engine
from aerodima.workbench.batch.row_store import RowStore, read_rows
from tests.soak import workers

PIECES, SECONDS = 12, 0.1
"""Of one study, and how long each piece takes, s."""
MOST_SECONDS = 90.0


def piece(number: int) -> int:
    """Takes `SECONDS`."""
    time.sleep(SECONDS)
    return number * number


def kill_one(draw: random.Random, killed: list[int]) -> None:
    """Kills one of the workers that are there."""
    victim = draw.choice(sorted(workers()))
    os.kill(victim, signal.SIGKILL)
    killed.append(victim)


def main() -> int:
    """Run from the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.kill_loop", description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    draw = random.Random(arguments.seed)
    wrong = 0
    longest = 0.0
    killed = list[int]()
    busy = [
        subprocess.Popen(["nice", sys.executable, "-c", "while True: pass"])
        for _ in range(os.cpu_count() or 1)
    ]
    try:
        with TemporaryDirectory() as folder, open_engine(2, progress=lambda _line: None) as engine:
            for number in range(arguments.kills):
                begun = time.monotonic()
                path = Path(folder) / f"{number}.jsonl"
                killer = threading.Timer(
                    draw.uniform(0.0, 0.8 * PIECES * SECONDS), kill_one, (draw, killed)
                )
                with RowStore(path, {"study": number}) as store:
                    killer.start()
                    results = engine.map(
                        piece,
                        range(PIECES),
                        lambda index, result: store.add(str(index), {"square": result}),
                    )
                killer.join()
                table = Counter(line["key"] for line in read_rows(path) if "key" in line)
                whole = results == [n * n for n in range(PIECES)] and table == Counter(
                    map(str, range(PIECES))
                )
                wrong += not whole
                longest = max(longest, time.monotonic() - begun)
                print(
                    f"{number + 1}/{arguments.kills} {'whole' if whole else 'NOT WHOLE'}",
                    flush=True,
                )
            events = engine.events
    finally:
        for process in busy:
            process.kill()
    print(
        f"killed: {len(killed)}, studies with a run lost or repeated: {wrong}, longest "
        f"{longest:.1f} s, {events}"
    )
    return 0 if not wrong and longest < MOST_SECONDS and len(killed) == arguments.kills else 1


if __name__ == "__main__":
    sys.exit(main())
