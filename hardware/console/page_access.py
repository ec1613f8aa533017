"""Who may open the page: a token that works once, a session cookie afterwards, and only pages of our own address."""

from __future__ import annotations

import secrets
from collections.abc import Mapping

HOST = "127.0.0.1"
_BYTES = 24


class Access:
    """The keys of one run of the console. A console that is started again has new ones.

    Args:
        port: on which it listens.
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
        """A session for the token, which is worth nothing from now on; None for a wrong or used one."""
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return None
        self._token = secrets.token_urlsafe(_BYTES)
        session = secrets.token_urlsafe(_BYTES)
        self._sessions.add(session)
        return session

    def refusal(self, headers: Mapping[str, str], origin_needed: bool) -> str:
        """Why a request must be refused whoever sends it, empty if it need not be.

        A foreign Host is a name that was made to point here; a foreign Origin is a page of somebody else.

        Args:
            headers: with names in lower case.
            origin_needed: browsers name the origin of a WebSocket always, that of a page sometimes.
        """
        host, origin = headers.get("host", ""), headers.get("origin")
        if host not in self._hosts:
            return f"Host {host!r}; allowed: {', '.join(self._hosts)}"
        if (origin is not None or origin_needed) and origin != f"http://{host}":
            return f"Origin {origin!r}; allowed: http://{host}"
        return ""

    def knows(self, headers: Mapping[str, str]) -> bool:
        """Whether the request carries the cookie of a session."""
        # Programs on other ports set cookies here as well, and theirs may be malformed.
        pairs = (pair.strip().partition("=") for pair in headers.get("cookie", "").split(";"))
        return any(name == self.cookie and value in self._sessions for name, _, value in pairs)
