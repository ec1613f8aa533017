"""What an error message must name; its sentence is free."""

from __future__ import annotations

from collections.abc import Callable

import pytest


def assert_refused(work: Callable[[], object], error: type[Exception], *named: str) -> None:
    """Asserts that `work` raises `error`, and that the message holds each of `named`."""
    with pytest.raises(error) as caught:
        work()
    missing = [part for part in named if part not in str(caught.value)]
    assert not missing, f"{missing} not named in: {caught.value}"
