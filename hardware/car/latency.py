"""The interpreter's two habits that stop a 100 Hz loop for milliseconds, switched off while the loop turns."""

from __future__ import annotations

import gc
import sys

DRIVE_PRIORITY, EMULATOR_PRIORITY = 40, 30
"""SCHED_RR priorities: the emulated car below what a real computer runs, none above the kernel's own threads for
interrupts."""
SWITCH_INTERVAL = 0.0005
"""s; how long a thread that computes may keep the others waiting. Python's own 5 ms are half a cycle of the loop."""
_SWITCH_INTERVAL_OF_PYTHON = 0.005


def prefer_latency() -> None:
    """Before the loop begins: threads give way sooner, and what exists by now is never looked through for garbage."""
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(SWITCH_INTERVAL)


def restore_latency() -> None:
    """Python's own habits again; harmless when they were never changed."""
    gc.unfreeze()
    sys.setswitchinterval(_SWITCH_INTERVAL_OF_PYTHON)
