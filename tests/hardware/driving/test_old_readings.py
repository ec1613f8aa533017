"""The benchmark of a drive tells a reply that was not used from one that came late."""

from types import SimpleNamespace

import can
import numpy as np

from tests.benchmarks.bench_drive import Drive, count_old_readings, count_unanswered

BEGIN = 1000.0


def _frames(times):
    return [
        can.Message(timestamp=time, arbitration_id=0, data=[motor], is_rx=True)
        for motor in (1, 2)
        for time in times
    ]


def _drive(given, received):
    """Three cycles at 0, 10 and 20 ms that all show the reply of -3 ms."""
    reads = np.array([0.0, 0.01, 0.02])
    columns = dict.fromkeys(
        ("status_tail_pitch_age_s", "status_tail_roll_age_s"), np.append(0.0, reads + 0.003)
    )
    log = SimpleNamespace(
        time=np.arange(4) * 0.01,
        extra={"begin_unix_s": BEGIN},
        signal=lambda name: columns.get(name, np.zeros(4)),
    )
    frames = (_frames([BEGIN + time for time in (-0.003, *times)]) for times in (given, received))
    return Drive(log, (1, 2), *frames, car_delay=0.0)


def test_a_reading_is_old_by_whoever_had_the_newer_reply():
    assert count_old_readings(_drive([0.004], [0.005])) == {"unused": 4}
    assert count_old_readings(_drive([0.004], [0.03])) == {"delivered_late": 4}
    assert count_old_readings(_drive([0.0195], [0.03])) == {"given_late": 4}


def test_frames_of_the_teensy_are_answered_too():
    asked = [can.Message(arbitration_id=motor, is_rx=rx) for motor in (1, 2) for rx in (0, 1)]
    assert count_unanswered([*asked, *_frames([0.0])], (1, 2)) == 2
