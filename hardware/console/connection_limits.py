"""Connections that ask for nothing: closed after a while, and the oldest of them when there are too many.

Without a limit some thousand connections without a request take every file that the console may open, and the operator
cannot come back after a restart of the browser.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_TIME = 3.0
"""s in which a connection must have made its whole request, the first one or the next."""
MOST_WAITING = 64
"""Connections without a request; a browser opens six. The oldest is closed for the next one: what has just been opened,
as by the operator, has its turn."""


def impatient_http() -> type[H11Protocol]:
    """uvicorn's HTTP side with these limits; one class for each server."""
    waiting: dict[ImpatientHttp, asyncio.TimerHandle] = {}

    class ImpatientHttp(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._wait()
            if len(waiting) > MOST_WAITING:
                next(iter(waiting))._give_up()

        def connection_lost(self, exc: Exception | None) -> None:
            self._done()
            super().connection_lost(exc)

        def handle_events(self) -> None:
            super().handle_events()
            if self.cycle is not None and not self.cycle.response_complete:
                self._done()

        def handle_websocket_upgrade(self, event: Any) -> None:
            self._done()
            super().handle_websocket_upgrade(event)

        def on_response_complete(self) -> None:
            self._wait()
            super().on_response_complete()

        def _wait(self) -> None:
            self._done()
            waiting[self] = self.loop.call_later(REQUEST_TIME, self._give_up)

        def _done(self) -> None:
            timer: Any = waiting.pop(self, None)
            if timer is not None:
                timer.cancel()

        def _give_up(self) -> None:
            self._done()
            self.transport.abort()  # `close` would wait for a peer that takes nothing

    return ImpatientHttp
