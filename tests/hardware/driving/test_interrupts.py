"""Alarms of a controller's tick that come while the tick ends."""

import signal

from aerodima.hardware.driving.interrupts import _deadlines, stop_on_signals, time_limit


def test_an_alarm_while_a_tick_ends_raises_nothing_and_leaves_no_deadline(monkeypatch):
    set_timer = signal.setitimer

    def late(*timer):
        signal.raise_signal(signal.SIGALRM)
        set_timer(*timer)

    with stop_on_signals(str, str), time_limit(5.0):
        monkeypatch.setattr(signal, "setitimer", late)
    assert not _deadlines
