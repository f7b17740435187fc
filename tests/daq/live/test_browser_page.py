"""The live page in a browser, and what its server refuses."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from unittest.mock import AsyncMock
from urllib.parse import urlsplit

import numpy as np
import pytest
from chromium import chromium, chromium_path
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from daq.live import page as live_page
from daq.live.page import Alarm, BrowserPage, browser_page, require_browser
from daq.live.page_server import MOST_CONNECTIONS, WAITING, LivePage
from daq.live.shared_rows import SharedRows
from daq.robot.loader import load_robot
from drivers.core.errors import UsageError
from ident.excite.constraints.placements import place_arm
from ident.model.dynamic_model import build_model

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

ROBOT = load_robot("ur5e")
JOINTS = ROBOT.robot.joint_names
QUANTITIES = ("measured", "predicted", "residual", "band", "position")
POSITION = np.array([0.3, -1.2, 1.0, -0.5, 0.2, 0.1])


@pytest.fixture(scope="module")
def page() -> Iterator[BrowserPage]:
    """A session with five seconds of samples and an alarm."""
    with browser_page(ROBOT, [f"{quantity}/{joint}" for quantity in QUANTITIES for joint in JOINTS]) as shown:
        for number in range(2500):
            time = number / 500
            torque = 10 * np.sin(time * np.arange(1, 7))
            row = np.concatenate([torque + 0.1, torque, np.full(6, 0.1), np.ones(6), POSITION])
            shown.append(np.array([time]), row[None])
        shown.alarm(Alarm(float("nan"), "x" * 10_000))  # does not fit into a pipe at once: left out
        shown.alarm(Alarm(float("nan"), "at no time"))
        shown.alarm(Alarm(2.5, "external torque <b>3 N·m</b>", JOINTS[1]))
        yield shown


def answer(page: BrowserPage, path: str | None = None, **headers: str) -> int:
    parts = urlsplit(page.address)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=60)
    connection.request("GET", path or f"/?{parts.query}", headers=headers)
    response = connection.getresponse()
    response.read()
    return response.status


def socket_address(page: BrowserPage) -> str:
    return page.address.replace("http", "ws").replace("/?", "/socket?")


def test_only_its_own_address_with_its_token_is_answered(page):
    parts = urlsplit(page.address)
    own = f"{parts.hostname}:{parts.port}"
    assert parts.hostname == "127.0.0.1"
    assert answer(page) == 200
    assert answer(page, Origin=f"http://{own}", Host=f"localhost:{parts.port}") == 200
    for headers in (
        {"Host": f"evil.example:{parts.port}"},  # a name that leads here: DNS rebinding
        {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": f"https://{own}"},
    ):
        assert answer(page, **headers) == 403
        origin = headers.get("Origin")
        if origin is not None:
            with pytest.raises(InvalidStatus, match="403"):
                connect(socket_address(page), origin=origin)
    for path in ("/", "/?token=", "/?token=%FF", f"/?{parts.query}x"):
        assert answer(page, path) == 403
    with pytest.raises(InvalidStatus, match="403"):
        connect(socket_address(page) + "x")
    for path in ("/etc/passwd", f"/page.html?{parts.query}", f"/%2e%2e/?{parts.query}"):
        assert answer(page, path) == 404


def test_what_a_browser_sends_is_ignored_and_rubbish_ends_its_own_connection_alone(page, capfd):
    with connect(socket_address(page)) as client:
        about = json.loads(client.recv())
        assert [one["quantity"] for one in about["channels"][::6]] == list(QUANTITIES)
        for rubbish in ("{", '{"kind": "stop"}', b"\0\xff", "x" * 4000):
            client.send(rubbish)
        assert isinstance(client.recv(), bytes)
        with suppress(ConnectionClosed):
            client.send("x" * 100_000)
            while True:
                client.recv()
    with connect(socket_address(page)) as client, suppress(ConnectionClosed):
        client.socket.sendall(b"\x81\x81\0\0\0\0\xff")  # no UTF-8
        while True:
            client.recv()
    parts = urlsplit(page.address)
    for rubbish in (b"\0" * 100, b"GET / HTTP/1.1\r\nHost: " + b"x" * 100_000, b"GET \xff\xff HTTP/9\r\n\r\n"):
        with socket.create_connection((parts.hostname, parts.port)) as raw, suppress(OSError):
            raw.sendall(rubbish)
            raw.shutdown(socket.SHUT_WR)
            while raw.recv(4096):
                pass
    assert answer(page) == 200
    assert capfd.readouterr().err == ""  # the terminal is the recording's


def test_connections_that_ask_for_nothing_are_few_and_disturb_no_page(page):
    parts = urlsplit(page.address)
    with connect(socket_address(page)) as client, ExitStack() as idle:
        for _ in range(3 * MOST_CONNECTIONS):
            raw = idle.enter_context(socket.create_connection((parts.hostname, parts.port)))
        with suppress(OSError):
            assert raw.recv(1) == b""  # one too many
        client.recv()
    for _ in range(MOST_CONNECTIONS):  # closed now, the server may not know of all yet
        with suppress(OSError, http.client.HTTPException):
            assert answer(page) == 200
            return
    raise AssertionError("no page any more")


def test_the_page_draws_pauses_zooms_and_keeps_its_alarms(page, tmp_path):
    program = chromium_path()
    if program is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium fonts-dejavu-core")
    drawn = "new Promise((done) => { const look = () => Number(document.documentElement.dataset.end) > 4.9"
    wait = (
        drawn
        + " && document.querySelectorAll('#alarms li').length === 2 ? done(true) : setTimeout(look, 5); look(); })"
    )
    with chromium(program) as browser:
        tab = browser.new_page()
        tab.resize(1400)
        for _ in range(2):  # the second time: after a reload
            tab.send("Page.navigate", url=page.address)
            browser.wait_for_load(tab._session)
            tab.evaluate(wait)
            assert tab.evaluate("document.querySelector('#alarms li').textContent") == (
                f"2.50 s {JOINTS[1]}: external torque <b>3 N·m</b>"
            )
            assert tab.evaluate("document.querySelectorAll('#joints section').length") == 6
            assert tab.evaluate("document.querySelectorAll('#joints canvas').length") == 12
            key = tab.evaluate("document.querySelectorAll('.key')[1].textContent")
            assert key == "residual: 0.100 … 0.100 N·m"
            painted = """Array.from(document.querySelectorAll('canvas')).every((one) =>
              one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some((value) => value))"""
            assert tab.evaluate(painted)
            browser.loaded.discard(tab._session)
        before = tab.evaluate("document.documentElement.dataset.end")
        tab.evaluate("at('pause').click()")
        page.append(np.array([5.1]), np.concatenate([np.zeros(24), POSITION])[None])
        tab.evaluate(
            "new Promise((done) => { const look = () => latest() > 5 ? done(true) : setTimeout(look, 5); look(); })"
        )
        tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")
        assert tab.evaluate("document.documentElement.dataset.end") == before
        assert tab.evaluate("at('in').click(); at('span').textContent") == "15 s"
        tab.evaluate("at('pause').click()")
        tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")
        assert float(tab.evaluate("document.documentElement.dataset.end")) == 5.1
        place = json.loads(tab.evaluate("document.documentElement.dataset.arm"))
        model = build_model(ROBOT)
        last = [joint.name for joint in model.joints].index(JOINTS[-1])
        np.testing.assert_allclose(place, place_arm(model, POSITION[:, None]).origin[last, :, 0], atol=1e-6)
        tab.resize(400)
        assert tab.evaluate("document.documentElement.scrollWidth") <= 400
        assert tab.problems == []


def test_a_client_that_never_reads_is_dropped_and_the_others_get_everything():
    class Client:
        """A browser whose messages are sent, or wait for ever."""

        headers = {"host": "127.0.0.1:80"}  # noqa: RUF012
        query_params = {"token": "t"}  # noqa: RUF012

        def __init__(self, reads: bool) -> None:
            self.reads, self.got = reads, list[bytes | str]()
            self.accept = self.close = AsyncMock()
            self.receive = asyncio.Event().wait

        async def send(self, message: bytes | str) -> None:
            await (asyncio.sleep(0) if self.reads else asyncio.Event().wait())
            self.got.append(message)

        send_bytes = send_text = send

    async def session() -> tuple[Client, Client, bool]:
        served = LivePage(SharedRows.create(("a",), 2), "about", "t", 80)
        clients = Client(True), Client(False)
        tasks = [asyncio.ensure_future(served.socket(client)) for client in clients]
        for number in range(3 * WAITING):
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            served.show(b"%d" % number)
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        served._rows.close()
        dropped = tasks[1].done() and not tasks[0].done()
        tasks[0].cancel()
        return *clients, dropped

    reading, silent, dropped = asyncio.run(session())
    assert dropped
    assert silent.got == []
    assert reading.got[-1] == b"%d" % (3 * WAITING - 1)
    assert len(reading.got) >= 3 * WAITING


def test_the_session_ends_the_page_and_a_missing_package_is_named(monkeypatch, capsys):
    stack = ExitStack()
    with browser_page(ROBOT, ["position/elbow_joint"], title="<i>arm</i>") as page:
        assert page.address in capsys.readouterr().err
        client = stack.enter_context(connect(socket_address(page)))
        assert json.loads(client.recv())["title"] == "<i>arm</i>"
    messages = []
    with suppress(ConnectionClosed):
        while True:
            messages.append(client.recv())
    assert json.loads(messages[-1]) == {"kind": "ended"}
    stack.close()
    page.alarm(Alarm(0.0, "nobody listens"))
    monkeypatch.setattr(live_page, "find_spec", lambda name: None if name == "uvicorn" else sys)
    with pytest.raises(UsageError, match=r"needs uvicorn.*dynid\[browser\]"):
        require_browser()
