"""The console on 127.0.0.1: pages, one WebSocket per page, nothing for anybody else."""

from __future__ import annotations

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
from aerodima.workbench.core.errors import HardwareError, UserError

_TURN = 0.01
"""Time between two looks at the radio, s."""
_SHOW = 0.05
"""Time between two states that a page gets, s."""
_FAREWELL = 0.3
"""s in which pages learn that the console has failed, before it ends."""
_MOST_BYTES = 4096
"""Longest message that a page may send, bytes."""
_BACKLOG = 16
"""Connections that are accepted in one go; more of them could take every file before the first one
is looked at."""
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
Say = Callable[[str], None]


def open_socket(port: int) -> socket.socket:
    """A socket that listens on a port of 127.0.0.1; 0 takes a free one.

    `HardwareError` if the port is in use.
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
    """The pages and the WebSocket of a console.

    Args:
        say: receives the next address when one has been used.
        end: of the server; called when a part of the console has died.
    """
    pages = {
        name: files("aerodima.hardware.console").joinpath("page", name).read_text(encoding="utf-8")
        for name in _PAGES
    }
    headers = _headers(console.view)

    async def page(request: Request) -> Response:
        if refusal := access.refusal(request.headers, origin_needed=False):
            return PlainTextResponse(f"refused: {refusal}\n", 403, headers)
        token = request.query_params.get("token")
        if token is not None:
            return enter(token)
        if not access.knows(request.headers):
            text = (
                "Open the address that the console's terminal shows; it works once, and not "
                "after a restart.\n"
            )
            return PlainTextResponse(text, 403, headers)
        name = request.path_params.get("name") or "index.html"
        if name not in pages:
            return PlainTextResponse("no such page\n", 404, headers)
        return Response(pages[name], media_type=_TYPES[name.rpartition(".")[2]], headers=headers)

    def enter(token: str) -> Response:
        session = access.redeem(token)
        if session is None:
            text = (
                "This address was used or is wrong; the console's terminal shows the one that "
                "is valid.\n"
            )
            return PlainTextResponse(text, 403, headers)
        say(f"opened; for another browser: {access.url}")
        answer = RedirectResponse("/", 303, headers)
        answer.set_cookie(access.cookie, session, httponly=True, samesite="strict", path="/")
        return answer

    async def connect(websocket: WebSocket) -> None:
        if access.refusal(websocket.headers, origin_needed=True) or not access.knows(
            websocket.headers
        ):
            await websocket.close(1008)  # before it is accepted: the browser gets status 403
            return
        await websocket.accept()
        await _watched(console, _serve_page(console, websocket))

    @contextlib.asynccontextmanager
    async def turning(_: Starlette) -> AsyncIterator[None]:
        tasks = [
            asyncio.create_task(_watched(console, _turn(console))),
            asyncio.create_task(_end(console, end)),
        ]
        # A second Ctrl-C ends the server without asking for an end.
        with contextlib.suppress(asyncio.CancelledError):
            yield
        for task in tasks:
            task.cancel()

    routes = [Route("/", page), Route("/{name}", page), WebSocketRoute("/socket", connect)]
    return Starlette(routes=routes, lifespan=turning)


def run_server(listener: socket.socket, console: Console, access: Access, say: Say) -> None:
    """Serves until Ctrl-C; ends in order by SIGTERM too, which then does what it did before.

    Raises:
        HardwareError: a part of the console has died; pages have the reason, and the car was sent
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
    """The server of the app, with limits for what others send and for what they do not send."""
    config = uvicorn.Config(
        app,
        log_level="warning",
        http=impatient_http(),
        ws="websockets-sansio",
        ws_max_size=_MOST_BYTES,
        ws_ping_interval=1.0,
        ws_ping_timeout=2.0,
        ws_per_message_deflate=False,
        server_header=False,
        backlog=_BACKLOG,
        timeout_graceful_shutdown=1,
    )
    return uvicorn.Server(config)


async def _watched(console: Console, task: Coroutine[Any, Any, None]) -> None:
    """Any exception that nobody meant ends the console: half of one is worse than none."""
    try:
        await task
    except Exception as error:
        console.fail(error)


async def _end(console: Console, end: Callable[[], None]) -> None:
    while not console.failure:
        await asyncio.sleep(_TURN)
    await asyncio.sleep(_FAREWELL)
    end()


async def _turn(console: Console) -> None:
    while True:
        console.turn(time.monotonic())
        await asyncio.sleep(_TURN)


async def _serve_page(console: Console, websocket: WebSocket) -> None:
    page = console.enter(time.monotonic())
    sender = asyncio.create_task(_show(console, websocket, page))
    try:
        while True:
            await _hear(console, websocket, page)
    except WebSocketDisconnect:
        pass
    finally:
        sender.cancel()
        console.leave(page)


async def _hear(console: Console, websocket: WebSocket, page: int) -> None:
    event = await websocket.receive()
    if event["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(event.get("code", 1005))
    try:
        console.hear(page, read_message(event.get("text") or ""), time.monotonic())
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
        await asyncio.sleep(_SHOW)


async def _send(websocket: WebSocket, content: object) -> None:
    text = json.dumps(content, allow_nan=False)
    # The page has gone, whatever that is called; `_serve_page` sees it.
    with contextlib.suppress(Exception):
        await websocket.send_text(text)


def _headers(view: str | None) -> dict[str, str]:
    if view is None:
        frames = "'none'"
    else:
        frames = "{0.scheme}://{0.netloc}".format(urlsplit(view))
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
