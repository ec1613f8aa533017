"""Messages of Drake's log that are always true here and tell the user nothing.

Drake speaks through Python's logger `drake`. A message is dropped by its exact text, so that anything new is seen.
"""

import logging


class _ExactMessage(logging.Filter):
    """Drops records whose whole text is `message`."""

    def __init__(self, message: str):
        super().__init__()
        self._message = message

    def filter(self, record: logging.LogRecord) -> bool:
        return record.getMessage() != self._message

    def __eq__(self, other: object) -> bool:
        """Equal filters are added to a logger only once."""
        return isinstance(other, _ExactMessage) and other._message == self._message

    def __hash__(self) -> int:
        return hash(self._message)


def drop_message(message: str) -> None:
    """Keeps one message of Drake, given by its exact text, out of the log from now on."""
    logging.getLogger("drake").addFilter(_ExactMessage(message))
