"""One worker process as its engine sees it, and what runs in it."""

from __future__ import annotations

import gc
import importlib
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

REPLACE_AT = 0.7
"""Share of its memory limit that the next piece would fill: then a worker is replaced. Dask pauses at 0.8."""
WORTH_REPLACING = 0.05
"""Share of the limit that a worker's memory must have grown by; a worker that is full from the start stays."""
_GIGABYTE = 1.0e9


@dataclass
class Worker:
    """What is known of one worker process; memory in bytes, `first` is that after its first piece."""

    name: str
    threads: int
    limit: float
    has_nanny: bool
    pid: int = 0
    memory: float = 0.0
    first: float = 0.0
    pieces: int = 0
    status: str = "running"
    stopped: int = 0
    idle: int = 0

    @property
    def per_piece(self) -> float:
        """How much more memory each piece left behind, bytes."""
        return (self.memory - self.first) / (self.pieces - 1) if self.pieces > 1 else 0.0

    @property
    def is_full(self) -> bool:
        """Whether the next piece would fill the worker, and a new worker would have more room."""
        grown = self.memory - self.first
        return 0.0 < self.limit * WORTH_REPLACING < grown and self.memory + self.per_piece > REPLACE_AT * self.limit

    @property
    def held(self) -> str:
        """Its memory and limit, in words."""
        limit = f" of {self.limit / _GIGABYTE:.2f}" if self.limit else ""
        return f"{self.memory / _GIGABYTE:.2f}{limit} GB"

    def is_stopped(self) -> bool:
        """Whether its process, on this computer, was stopped by a signal."""
        import psutil

        try:
            return bool(self.pid) and bool(psutil.Process(self.pid).status() == psutil.STATUS_STOPPED)
        except psutil.NoSuchProcess:
            return False

    def __str__(self) -> str:
        return f"worker {self.name} (process {self.pid or 'unknown'})"


def do_piece(work: Callable[[Any], Any], item: Any) -> tuple[Any, float, int, int]:
    """In the worker: the result, how long it took (s), the process and its memory afterwards (bytes)."""
    start = time.monotonic()
    result = work(item)
    seconds = time.monotonic() - start
    gc.collect()  # a dead diagram is a cycle that weighs megabytes and looks like a few small objects
    return result, seconds, os.getpid(), _memory()


def get_ready(module: str | None) -> tuple[None, float, int, int]:
    """In a new worker: imports what pieces need, and keeps it out of the collector's rounds."""
    start = time.monotonic()
    if module is not None:
        importlib.import_module(module)
    gc.collect()
    gc.freeze()
    return None, time.monotonic() - start, os.getpid(), _memory()


def _memory() -> int:
    import psutil

    return int(psutil.Process().memory_info().rss)
