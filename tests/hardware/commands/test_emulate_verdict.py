"""The emulator says at its end whether it kept time."""

from __future__ import annotations

import pytest

from aerodima.hardware.commands.car_commands import _delay_in_words


@pytest.mark.parametrize(("delay", "verdict"), [(0.0042, "in time"), (5.9518, "too slow for that long")])
def test_largest_delay_comes_with_a_verdict(delay: float, verdict: str) -> None:
    said = _delay_in_words(delay)
    assert said.startswith(f"largest delay {1000 * delay:.1f} ms: ")
    assert verdict in said
