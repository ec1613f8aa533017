"""The interpreter's habits while a loop turns, and after it."""

import gc
import sys

import pytest

from aerodima.workbench.core.realtime import SWITCH_INTERVAL, prefer_latency, restore_latency


def test_habits_change_and_come_back():
    before = sys.getswitchinterval()
    prefer_latency()
    try:
        assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL)
        assert gc.get_freeze_count() > 0
    finally:
        restore_latency()
    assert sys.getswitchinterval() == pytest.approx(before)
    assert gc.get_freeze_count() == 0
