"""Access to the page: who may open it, and for how long a connection may ask for nothing.

A token works once, a session cookie afterwards, and only for pages of our own address. Without a
limit some thousand connections without a request take every file that the console may open, and the
operator cannot come back after a restart of the browser: such a connection is closed after a while,
and the oldest of them when there are too many.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Mapping
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

HOST = "127.0.0.1"
_BYTES = 24
"""Number of random bytes in a token or session."""
REQUEST_TIME = 3.0
"""Time in which a connection must have made its whole request, the first one or the next, s."""
MAX_WAITING = 64
"""Largest number of connections without a request; a browser opens six. The oldest is closed for
the next one: one that has just been opened, for example by the operator, gets its turn."""


class Access:
    """The keys of one run of the console. A console that is started again has new ones.

    Args:
        port: port on which the console listens.
    """

    def __init__(self, port: int) -> None:
        self._hosts = (f"{HOST}:{port}", f"localhost:{port}")
        self._port = port
        self._sessions: set[str] = set()
        self._token = secrets.token_urlsafe(_BYTES)
        self.cookie = f"aerodima_console_{port}"
        """Name of the cookie: browsers share cookies between the ports of a host."""

    @property
    def url(self) -> str:
        """The address that opens the page once."""
        return f"http://{HOST}:{self._port}/?token={self._token}"

    def redeem(self, token: str) -> str | None:
        """Returns a session for the token, which is then used up; None for a wrong or used one."""
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return None
        self._token = secrets.token_urlsafe(_BYTES)
        session = secrets.token_urlsafe(_BYTES)
        self._sessions.add(session)
        return session

    def refusal(self, headers: Mapping[str, str], origin_needed: bool) -> str:
        """Returns why a request must be refused whoever sends it, empty if it need not be.

        A foreign Host is a name that was made to point here; a foreign Origin is a page of somebody
        else.

        Args:
            headers: headers of the request, with names in lower case.
            origin_needed: whether the request must name its origin; browsers always do so for a
                WebSocket, and sometimes for a page.
        """
        host = headers.get("host", "")
        origin = headers.get("origin")
        if host not in self._hosts:
            return f"Host {host!r}; allowed: {', '.join(self._hosts)}"
        if (origin is not None or origin_needed) and origin != f"http://{host}":
            return f"Origin {origin!r}; allowed: http://{host}"
        return ""

    def knows(self, headers: Mapping[str, str]) -> bool:
        """Returns whether the request carries the cookie of a session."""
        # Programs on other ports set cookies here as well, and theirs may be malformed.
        pairs = (pair.strip().partition("=") for pair in headers.get("cookie", "").split(";"))
        return any(name == self.cookie and value in self._sessions for name, _, value in pairs)


def impatient_http() -> type[H11Protocol]:
    """Makes uvicorn's HTTP side with these limits; one class for each server."""
    waiting: dict[ImpatientHttp, asyncio.TimerHandle] = {}

    class ImpatientHttp(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._wait()
            if len(waiting) > MAX_WAITING:
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
