"""The server of the live page: a process of its own on loopback, which reads shared rows and sends them to browsers.

It answers only requests to its own address (a foreign name that leads to 127.0.0.1 has another `Host`), from its own
pages (`Origin`), with the token of its address. What browsers send is ignored. A browser that does not read is dropped,
and so is a connection that asks for nothing, or is one too many.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import os
import secrets
import signal
import socket
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

import numpy as np

from daq.live.shared_rows import RowsHandle, SharedRows
from drivers.core.arrays import FloatArray

if TYPE_CHECKING:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.requests import HTTPConnection, Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

PERIOD = 0.05
"""Between two messages to a page [s]."""
GROUPS = 5
"""Groups of rows in a message."""
WAITING = 40
"""Messages that may wait for a browser, two seconds; then it is dropped."""
MOST_CLIENTS = 16
MOST_CONNECTIONS = 64
"""Pages that are being loaded among them."""
LOADING = 10.0
"""[s] after which a connection is dropped that is no socket of a page by then."""
MOST_ALARMS = 1000
LARGEST_MESSAGE = 4096
"""Bytes of a message of a browser; nothing that it sends is of use."""
FAREWELL = 0.3
"""[s] in which pages receive the end of the session."""

KEPT = 6000
"""Groups that a page gets when it is opened: a minute of 100 groups a second."""


class Envelope:
    """Smallest and largest values of groups of rows, as bytes for a page.

    A message is the number of groups n and of channels c (uint32 each), their first and last times (n, 2) float64, and
    smallest and largest values (n, 2, c) float32, little-endian.
    """

    def __init__(self) -> None:
        self._times: deque[FloatArray] = deque(maxlen=KEPT)
        self._values: deque[FloatArray] = deque(maxlen=KEPT)

    def add(self, rows: FloatArray, groups: int) -> bytes:
        """Group new rows (N, 1 + c), N ≥ 1, time first; the message of at most so many groups."""
        starts = np.unique(np.linspace(0, len(rows), min(groups, len(rows)), endpoint=False).astype(np.intp))
        ends = np.append(starts[1:], len(rows)) - 1
        times = np.column_stack([rows[starts, 0], rows[ends, 0]])
        values = np.stack([np.fmin.reduceat(rows[:, 1:], starts), np.fmax.reduceat(rows[:, 1:], starts)], axis=1)
        self._times.extend(times)
        self._values.extend(values)
        return _message(times, values)

    @property
    def history(self) -> bytes | None:
        """The message of all groups that are kept; None without any."""
        return _message(np.array(self._times), np.array(self._values)) if self._times else None


def _message(times: FloatArray, values: FloatArray) -> bytes:
    head = np.array([len(times), values.shape[2]], dtype="<u4")
    limit = float(np.finfo(np.float32).max)
    return head.tobytes() + times.astype("<f8").tobytes() + np.clip(values, -limit, limit).astype("<f4").tobytes()


class LivePage:
    """What the pages show of the session's rows.

    `about` is the first message to a page: names of arm and channels, kinematics. Every request carries the token.
    """

    def __init__(self, rows: SharedRows, about: str, token: str, port: int) -> None:
        self._rows, self._about, self._token = rows, about, token
        self._hosts = frozenset({f"127.0.0.1:{port}", f"localhost:{port}"})
        self._read = 0
        self._envelope = Envelope()
        self._alarms: deque[str] = deque(maxlen=MOST_ALARMS)
        self._clients: dict[asyncio.Queue[bytes | str], asyncio.Task[None]] = {}

    def permitted(self, request: HTTPConnection) -> bool:
        """Return whether a request is to this address, of no foreign page, and carries the token."""
        origin = request.headers.get("origin")
        return (
            request.headers.get("host") in self._hosts
            and (origin is None or origin.removeprefix("http://") in self._hosts)
            and hmac.compare_digest(request.query_params.get("token", "").encode(), self._token.encode())
        )

    async def page(self, request: Request) -> Response:
        """The page itself."""
        from starlette.responses import HTMLResponse, PlainTextResponse

        if not self.permitted(request):
            return PlainTextResponse("forbidden: use the address that dynid printed\n", status_code=403)
        nonce = secrets.token_urlsafe(16)
        text = files("daq.live").joinpath("page_files", "page.html").read_text(encoding="utf-8")
        policy = f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'"
        headers = {
            "Content-Security-Policy": f"{policy}; img-src data:; frame-ancestors 'none'",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
        return HTMLResponse(text.replace("NONCE", nonce), headers=headers)

    async def socket(self, client: WebSocket) -> None:
        """A page's connection: what it missed, then what is new, until it leaves or does not keep up."""
        from starlette.websockets import WebSocketDisconnect

        if not self.permitted(client) or len(self._clients) >= MOST_CLIENTS:
            await client.close()  # before it is accepted: 403
            return
        await client.accept()
        waiting: asyncio.Queue[bytes | str] = asyncio.Queue(WAITING)
        history = self._envelope.history
        for message in (self._about, *([history] if history else ()), f"[{','.join(self._alarms)}]"):
            waiting.put_nowait(message)
        sending = self._clients[waiting] = asyncio.ensure_future(_send(client, waiting))
        ignoring = asyncio.ensure_future(_ignore(client))
        try:
            with suppress(WebSocketDisconnect, RuntimeError, OSError):
                await asyncio.wait((sending, ignoring), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._clients.pop(waiting, None)
            for task in (sending, ignoring):
                task.cancel()

    def show(self, message: bytes | str) -> None:
        """Give all pages a message; one that does not read is dropped."""
        for waiting, sending in list(self._clients.items()):
            try:
                waiting.put_nowait(message)
            except asyncio.QueueFull:
                sending.cancel()
                del self._clients[waiting]

    def alarm(self, message: str) -> None:
        """Keep an alarm, a JSON object, for pages that are opened later, and show it."""
        self._alarms.append(message)
        self.show(f"[{message}]")

    async def show_rows(self) -> None:
        """Show what is new, period by period."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            rows, self._read = self._rows.read(self._read)
            if len(rows):
                self.show(self._envelope.add(rows, GROUPS))
            due = max(due + PERIOD, loop.time())  # what the last one took does not delay the next
            await asyncio.sleep(due - loop.time())


async def _send(client: WebSocket, waiting: asyncio.Queue[bytes | str]) -> None:
    while True:
        message = await waiting.get()
        await (client.send_bytes(message) if isinstance(message, bytes) else client.send_text(message))


async def _ignore(client: WebSocket) -> None:
    """Read what a browser sends, to know when it leaves."""
    while (await client.receive())["type"] != "websocket.disconnect":
        pass


def serve(pipe: Connection, handle: RowsHandle, about: str, token: str, listening: socket.socket) -> None:
    """Serve the page until the pipe ends: the server's process.

    The pipe has an alarm per message; `about` is the first message to a page. Every request must carry the token, and
    the server's socket is on loopback.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.disable()  # what a browser gets wrong is no news for the terminal of the recording
    import uvicorn

    rows = SharedRows.attach(handle)
    page = LivePage(rows, about, token, listening.getsockname()[1])
    ended = asyncio.Event()
    config = uvicorn.Config(
        application(page, pipe, ended),
        http=_bounded_protocol(),
        log_config=None,
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=LARGEST_MESSAGE,
        lifespan="on",
        timeout_graceful_shutdown=1,
        server_header=False,
    )
    try:
        asyncio.run(_served(uvicorn.Server(config), listening, ended))
    finally:
        rows.close()


def _bounded_protocol() -> type[asyncio.Protocol]:
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class BoundedProtocol(H11Protocol):
        """HTTP whose connections are few and short."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            if len(self.connections) > MOST_CONNECTIONS:
                transport.abort()
            else:
                self.loop.call_later(LOADING, self._drop)

        def _drop(self) -> None:
            if self in self.connections:  # a page's socket has another protocol by now
                self.transport.abort()

    return BoundedProtocol


async def _served(server: uvicorn.Server, listening: socket.socket, ended: asyncio.Event) -> None:
    serving = asyncio.ensure_future(server.serve(sockets=[listening]))
    ending = asyncio.ensure_future(ended.wait())
    await asyncio.wait((serving, ending), return_when=asyncio.FIRST_COMPLETED)
    server.should_exit = True
    await serving


def application(page: LivePage, pipe: Connection, ended: asyncio.Event) -> Starlette:
    """The routes, and what runs beside them."""
    from starlette.applications import Starlette
    from starlette.routing import Route, WebSocketRoute

    @asynccontextmanager
    async def beside(_: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.ensure_future(page.show_rows()), asyncio.ensure_future(_alarms(page, pipe, ended))]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()

    routes = [Route("/", page.page), WebSocketRoute("/socket", page.socket)]
    return Starlette(routes=routes, lifespan=beside)


async def _alarms(page: LivePage, pipe: Connection, ended: asyncio.Event) -> None:
    """Show alarms until the session ends; then say so."""
    reader = asyncio.StreamReader(limit=1 << 20)
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(os.dup(pipe.fileno()), "rb"))
    while line := await reader.readline():
        page.alarm(line.decode())
    page.show(json.dumps({"kind": "ended"}))
    await asyncio.sleep(FAREWELL)
    ended.set()
