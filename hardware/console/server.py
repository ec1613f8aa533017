"""The console on 127.0.0.1: pages, one WebSocket per page, nothing for anybody else."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import files
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from hardware.console.access import HOST, Access
from hardware.console.console import Console
from hardware.console.messages import read_message
from workbench.errors import HardwareError, UserError

_TURN, _SHOW = 0.01, 0.05
"""s between two looks at the radio; between two states that a page gets."""
_MOST_BYTES = 4096
_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
_PAGES = ("index.html", "console.css", "console.js", "inputs.js", "news.js", "plots.js")
Say = Callable[[str], None]


def open_socket(port: int) -> socket.socket:
    """A socket that listens on a port of 127.0.0.1; 0 takes a free one. `HardwareError` if the port is in use."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((HOST, port))
        listener.listen(16)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or "allowed: 0 to 65535"
        raise HardwareError(f"--port {port}: {reason}; choose another, or 0 for any free one") from None
    return listener


def make_app(console: Console, access: Access, say: Say) -> Starlette:
    """The pages and the WebSocket of a console.

    Args:
        say: is told the next address when one has been used.
    """
    pages = {name: files("hardware.console").joinpath("page", name).read_text(encoding="utf-8") for name in _PAGES}
    headers = _headers(console.view)

    async def page(request: Request) -> Response:
        if refusal := access.refusal(request.headers, origin_needed=False):
            return PlainTextResponse(f"refused: {refusal}\n", 403, headers)
        token = request.query_params.get("token")
        if token is not None:
            return enter(token)
        if not access.knows(request.headers):
            text = "Open the address that the console's terminal shows; it works once, and not after a restart.\n"
            return PlainTextResponse(text, 403, headers)
        name = request.path_params.get("name") or "index.html"
        if name not in pages:
            return PlainTextResponse("no such page\n", 404, headers)
        return Response(pages[name], media_type=_TYPES[name.rpartition(".")[2]], headers=headers)

    def enter(token: str) -> Response:
        session = access.redeem(token)
        if session is None:
            text = "This address was used or is wrong; the console's terminal shows the one that is valid.\n"
            return PlainTextResponse(text, 403, headers)
        say(f"opened; for another browser: {access.url}")
        answer = RedirectResponse("/", 303, headers)
        answer.set_cookie(access.cookie, session, httponly=True, samesite="strict", path="/")
        return answer

    async def connect(websocket: WebSocket) -> None:
        if access.refusal(websocket.headers, origin_needed=True) or not access.knows(websocket.headers):
            await websocket.close(1008)  # before it is accepted: the browser gets status 403
            return
        await websocket.accept()
        await _serve_page(console, websocket)

    @contextlib.asynccontextmanager
    async def turning(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(_turn(console))
        yield
        task.cancel()

    routes = [Route("/", page), Route("/{name}", page), WebSocketRoute("/socket", connect)]
    return Starlette(routes=routes, lifespan=turning)


def run_server(listener: socket.socket, console: Console, access: Access, say: Say) -> None:
    """Serves until Ctrl-C; ends in order by SIGTERM too, which then does what it did before."""
    config = uvicorn.Config(
        make_app(console, access, say),
        log_level="warning",
        ws="websockets-sansio",
        ws_max_size=_MOST_BYTES,
        ws_ping_interval=1.0,
        ws_ping_timeout=2.0,
        ws_per_message_deflate=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listener])


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
        await _send(websocket.send_text, {"type": "refused", "text": str(error)})


async def _show(console: Console, websocket: WebSocket, page: int) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the page has gone; `_serve_page` hears of it
        await _send(websocket.send_text, console.welcome())
        while True:
            await _send(websocket.send_text, console.state(page, time.monotonic()))
            await asyncio.sleep(_SHOW)


async def _send(send: Callable[[str], Awaitable[None]], content: object) -> None:
    await send(json.dumps(content, allow_nan=False))


def _headers(view: str | None) -> dict[str, str]:
    frames = "'none'" if view is None else "{0.scheme}://{0.netloc}".format(urlsplit(view))
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
        f"frame-src {frames}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
    return {
        "Content-Security-Policy": policy,
        "Origin-Agent-Cluster": "?1",  # a process of its own in the browser: the view that it shows cannot hold it up
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
