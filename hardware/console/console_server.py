"""The console on 127.0.0.1: pages, one WebSocket per page, nothing for anybody else."""

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from importlib.resources import files
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from aerodima.hardware.console.console import Console
from aerodima.hardware.console.page_access import HOST, Access, impatient_http
from aerodima.hardware.console.page_messages import read_message
from aerodima.hardware.driving.speaker import Say
from aerodima.workbench.core.errors import HardwareError, UserError

_POLL_PERIOD = 0.01
"""Time between two polls of the radio, s."""
_STATE_PERIOD = 0.05
"""Time between two states that a page gets, s."""
_FAREWELL = 0.3
"""Time in which pages learn that the console has failed, before it ends, s."""
_MAX_BYTES = 4096
"""Longest message that a page may send, bytes."""
_BACKLOG = 16
"""Number of connections that are accepted in one go; more of them could take every file before the
first one is looked at."""
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_PAGES = (
    "index.html",
    "console.css",
    "console.js",
    "gamepads.js",
    "inputs.js",
    "news.js",
    "plots.js",
)


def open_socket(port: int) -> socket.socket:
    """Opens a socket that listens on a port of 127.0.0.1; 0 takes a free one.

    Raises `HardwareError` if the port is in use.
    """
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen(_BACKLOG)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or "allowed: 0 to 65535"
        raise HardwareError(
            f"--port {port}: {reason}; choose another, or 0 for any free one"
        ) from None
    return listener


def make_app(console: Console, access: Access, say: Say, end: Callable[[], None]) -> Starlette:
    """Makes the pages and the WebSocket of a console.

    Args:
        say: function that receives the next address when one has been used.
        end: function that ends the server; called when a part of the console has died.
    """

    @contextlib.asynccontextmanager
    async def polling(_: Starlette) -> AsyncIterator[None]:
        tasks = [
            asyncio.create_task(_watched(console, _poll(console))),
            asyncio.create_task(_end(console, end)),
        ]
        # A second Ctrl-C ends the server without asking for an end.
        with contextlib.suppress(asyncio.CancelledError):
            yield
        for task in tasks:
            task.cancel()

    door = _Door(console, access, say)
    routes = [
        Route("/", door.page),
        Route("/{name}", door.page),
        WebSocketRoute("/socket", door.connect),
    ]
    return Starlette(routes=routes, lifespan=polling)


class _Door:
    """Answers to requests: pages and WebSockets for whoever has a session, refusals for others."""

    def __init__(self, console: Console, access: Access, say: Say) -> None:
        self._console = console
        self._access = access
        self._say = say
        self._headers = _headers(console.view)
        folder = files("aerodima.hardware.console").joinpath("page")
        self._pages = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in _PAGES}

    async def page(self, request: Request) -> Response:
        """Answers a request for a page, or for a session with the token of an address."""
        if refusal := self._access.refusal(request.headers, origin_needed=False):
            return self._text(f"refused: {refusal}", 403)
        token = request.query_params.get("token")
        if token is not None:
            return self._open_session(token)
        if not self._access.knows(request.headers):
            return self._text(
                "Open the address that the console's terminal shows; it works once, and not "
                "after a restart.",
                403,
            )
        name = request.path_params.get("name") or "index.html"
        if name not in self._pages:
            return self._text("no such page", 404)
        media_type = _TYPES[name.rpartition(".")[2]]
        return Response(self._pages[name], media_type=media_type, headers=self._headers)

    def _open_session(self, token: str) -> Response:
        session = self._access.redeem(token)
        if session is None:
            return self._text(
                "This address was used or is wrong; the console's terminal shows the one that "
                "is valid.",
                403,
            )
        self._say(f"opened; for another browser: {self._access.url}")
        answer = RedirectResponse("/", 303, self._headers)
        answer.set_cookie(self._access.cookie, session, httponly=True, samesite="strict", path="/")
        return answer

    def _text(self, text: str, status: int) -> Response:
        return PlainTextResponse(f"{text}\n", status, self._headers)

    async def connect(self, websocket: WebSocket) -> None:
        """Serves a page's WebSocket until it disconnects."""
        headers = websocket.headers
        access = self._access
        if access.refusal(headers, origin_needed=True) or not access.knows(headers):
            await websocket.close(1008)  # before it is accepted: the browser gets status 403
            return
        await websocket.accept()
        await _watched(self._console, _serve_page(self._console, websocket))


def run_server(listener: socket.socket, console: Console, access: Access, say: Say) -> None:
    """Serves until Ctrl-C or SIGTERM; after an orderly end the SIGTERM is raised again and does
    what it did before.

    Raises:
        HardwareError: a part of the console has died; pages show the reason, and the car was sent
            to rest.
    """

    def end() -> None:
        server.should_exit = True

    server = make_server(make_app(console, access, say, end))
    with contextlib.suppress(KeyboardInterrupt):
        server.run(sockets=[listener])
    if console.failure:
        raise HardwareError(f"the console has failed: {console.failure}")


def make_server(app: Starlette) -> uvicorn.Server:
    """Makes the server of the app, with limits for what others send and fail to send."""
    config = uvicorn.Config(
        app,
        log_level="warning",
        http=impatient_http(),
        ws="websockets-sansio",
        ws_max_size=_MAX_BYTES,
        ws_ping_interval=1.0,
        ws_ping_timeout=2.0,
        ws_per_message_deflate=False,
        server_header=False,
        backlog=_BACKLOG,
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)


async def _watched(console: Console, task: Coroutine[Any, Any, None]) -> None:
    """Runs a task; ends the console at any exception: half a console is worse than none."""
    try:
        await task
    except Exception as error:
        console.fail(error)


async def _end(console: Console, end: Callable[[], None]) -> None:
    while not console.failure:
        await asyncio.sleep(_POLL_PERIOD)
    await asyncio.sleep(_FAREWELL)
    end()


async def _poll(console: Console) -> None:
    while True:
        console.poll(time.monotonic())
        await asyncio.sleep(_POLL_PERIOD)


async def _serve_page(console: Console, websocket: WebSocket) -> None:
    page = console.connect(time.monotonic())
    sender = asyncio.create_task(_show(console, websocket, page))
    try:
        while True:
            await _receive(console, websocket, page)
    except WebSocketDisconnect:
        pass
    finally:
        sender.cancel()
        console.disconnect(page)


async def _receive(console: Console, websocket: WebSocket, page: int) -> None:
    event = await websocket.receive()
    if event["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(event.get("code", 1005))
    try:
        console.handle(page, read_message(event.get("text") or ""), time.monotonic())
    except UserError as error:
        await _send(websocket, {"type": "refused", "text": str(error)})
    except Exception as error:
        console.fail(error)


async def _show(console: Console, websocket: WebSocket, page: int) -> None:
    await _watched(console, _show_states(console, websocket, page))
    await _send(websocket, {"type": "failed", "text": console.failure})


async def _show_states(console: Console, websocket: WebSocket, page: int) -> None:
    await _send(websocket, console.welcome())
    while not console.failure:
        await _send(websocket, console.state(page, time.monotonic()))
        await asyncio.sleep(_STATE_PERIOD)


async def _send(websocket: WebSocket, content: object) -> None:
    text = json.dumps(content, allow_nan=False)
    # The page has gone, whatever the exception; `_serve_page` sees it.
    with contextlib.suppress(Exception):
        await websocket.send_text(text)


def _headers(view: str | None) -> dict[str, str]:
    frames = "'none'" if view is None else "{0.scheme}://{0.netloc}".format(urlsplit(view))
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src "
        "'self' data:; "
        f"frame-src {frames}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        # a process of its own in the browser: the view that it shows cannot hold it up
        "Origin-Agent-Cluster": "?1",
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
