"""Real time on this computer: priority over ordinary programs, locked memory, no pauses of Python.

Nothing here asks for rights: the user sets the limits (docs/deployment.md), and what is not
permitted is reported.
"""

import contextlib
import ctypes
import gc
import os
import resource
import sys
import threading

_IPC_LOCK = 14
"""Number of the capability to lock any amount of memory (linux/capability.h)."""
_LOCK = 1 | 2 | 4
"""MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT: pages stay once they have been used; stacks that never grow
cost nothing."""
DRIVE_PRIORITY = 40
"""SCHED_RR priority of what a real computer runs; below the kernel's own threads for interrupts."""
EMULATOR_PRIORITY = 30
"""SCHED_RR priority of the emulated car; below that of what a real computer runs."""
SWITCH_INTERVAL = 0.0005
"""Time for which a thread that computes may keep others waiting, s; Python's own 5 ms are half a
cycle of the loop."""
_SWITCH_INTERVAL_OF_PYTHON = 0.005
"""Python's own switch interval, s."""


def prefer_realtime(priority: int) -> str:
    """Give the calling thread, and those that it starts, SCHED_RR with `priority` (1 to 99), and
    lock the memory.

    Returns:
        The scheduling and the locking that apply now, in words.
    """
    return f"{_set_priority(priority)}, {_lock_memory()}"


def restore_ordinary() -> None:
    """Restore ordinary scheduling of the calling thread; harmless when it never had another."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def is_realtime() -> bool:
    """Tell whether the calling thread has priority over ordinary programs."""
    try:
        return os.sched_getscheduler(0) in (os.SCHED_RR, os.SCHED_FIFO)
    except (OSError, AttributeError):
        return False


def permitted() -> tuple[bool, bool]:
    """Tell whether real-time priority, and locked memory without a limit, are permitted here.

    Changes nothing.
    """
    answers: list[bool] = []

    def attempt() -> None:
        answers.append(_set_priority(1).startswith("SCHED_RR"))

    thread = threading.Thread(target=attempt)  # a priority is a thread's own, and ends with it
    thread.start()
    thread.join()
    return answers[0], _may_lock()


def _set_priority(priority: int) -> str:
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
    except (OSError, AttributeError, ValueError) as error:
        return f"ordinary scheduling ({getattr(error, 'strerror', None) or error})"
    return f"SCHED_RR {priority}"


def _may_lock() -> bool:
    """Tell whether memory may be locked without limit; with one, allocations fail in mid-drive."""
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
        return True
    try:
        with open("/proc/self/status", encoding="ascii") as file:
            effective = next(line for line in file if line.startswith("CapEff"))
    except (OSError, StopIteration):
        return False
    return bool(int(effective.split()[1], 16) >> _IPC_LOCK & 1)


def _lock_memory() -> str:
    if not _may_lock():
        return "memory not locked (limit memlock is not unlimited)"
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_LOCK) != 0:
        return f"memory not locked ({os.strerror(ctypes.get_errno())})"
    return "memory locked"


def prefer_latency() -> None:
    """Make threads give way sooner, and keep existing objects out of garbage collection."""
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_INTERVAL)


def restore_latency() -> None:
    """Restore Python's own settings; harmless if they were never changed."""
    gc.unfreeze()
    sys.setswitchinterval(_SWITCH_INTERVAL_OF_PYTHON)
