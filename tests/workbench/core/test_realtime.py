"""Priority and locked memory: had where permitted, said where not, never asked for."""

import os
import resource
import threading

import pytest

from aerodima.workbench.core import realtime
from aerodima.workbench.core.realtime import (
    is_realtime,
    permitted,
    prefer_realtime,
    restore_ordinary,
)


def in_thread(work):
    """A priority is a thread's own: that of the tests stays as it is."""
    found = []
    thread = threading.Thread(target=lambda: found.append(work()))
    thread.start()
    thread.join()
    return found[0]


def test_what_is_not_permitted_is_said_and_changes_nothing(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(realtime, "_may_lock", lambda: False)
    said = in_thread(lambda: prefer_realtime(40))
    assert "Operation not permitted" in said
    assert "memlock" in said
    assert permitted() == (False, False)
    restore_ordinary()


@pytest.mark.skipif(not permitted()[0], reason="real-time priority is not permitted here")
def test_priority_is_had_by_the_thread_and_by_those_that_it_starts(monkeypatch):
    monkeypatch.setattr(realtime, "_lock_memory", lambda: "memory as it was")

    def work():
        said = prefer_realtime(7)
        seen = (said, is_realtime(), in_thread(lambda: os.sched_getparam(0).sched_priority))
        restore_ordinary()
        return *seen, is_realtime()

    assert in_thread(work) == ("SCHED_RR 7, memory as it was", True, 7, False)
    assert not is_realtime()


def test_memory_is_not_locked_below_a_limit(monkeypatch):
    """What is asked for beyond the limit would fail in the middle of a drive."""
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 << 20, 8 << 20))
    monkeypatch.setattr("builtins.open", lambda *_, **__: _Status())
    assert not realtime._may_lock()


class _Status:
    def __enter__(self):
        return iter(["Name:\tpython\n", "CapEff:\t0000000000000000\n"])

    def __exit__(self, *_):
        pass
