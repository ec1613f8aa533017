"""What an error message must name; its sentence is free."""

from collections.abc import Callable, Iterable

import pytest

from aerodima.workbench.core.errors import UserError


def assert_refused(work: Callable[[], object], error: type[Exception], *named: str) -> None:
    """Asserts that `work` raises `error`, and that the message holds each of `named`; that of a
    `UserError` is one line.
    """
    with pytest.raises(error) as caught:
        work()
    message = str(caught.value)
    assert_named(message, named)
    if isinstance(caught.value, UserError):
        assert "\n" not in message


def assert_named(message: str, parts: Iterable[str]) -> None:
    """Asserts that a message holds each of `parts`."""
    missing = [part for part in parts if part not in message]
    assert not missing, f"{missing} not named in: {message}"
