"""Pages in headless Chromium, driven over its DevTools protocol on a pair of pipes."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

TIME_LIMIT = 60.0
"""Longest wait for an answer of the browser [s]."""

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-pipe",
)

DRAWN = """new Promise((done) => {
  const look = () => document.documentElement.dataset.drawn === undefined ? setTimeout(look, 5) : done(true);
  look();
})"""


class BrowserPage:
    """One page; `problems` are its uncaught errors, console errors and refused requests."""

    def __init__(self, browser: Chromium, session: str) -> None:
        self._browser = browser
        self._session = session
        self.problems: list[str] = []

    def send(self, method: str, **parameters: Any) -> Any:
        return self._browser.send(method, self._session, **parameters)

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression; a promise is waited for."""
        answer = self.send("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{answer['exceptionDetails']}")
        return answer["result"].get("value")

    def resize(self, width: int, height: int = 900) -> None:
        """Set the window's size [px] and wait until the page has followed."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))")

    def open(self, path: Path, width: int) -> None:
        """Load a file at a width [px] and wait until its figures are drawn."""
        self.problems.clear()
        self.resize(width)
        self._browser.loaded.discard(self._session)
        self.send("Page.navigate", url=path.resolve().as_uri())
        self._browser.wait_for_load(self._session)
        self.evaluate(DRAWN)

    def drag(self, x: float, y: float, to_x: float, to_y: float) -> None:
        """Press the mouse at one place, move, and release it at another [px of the window]."""
        steps = [
            ("mousePressed", x, y),
            *(("mouseMoved", x + (to_x - x) * k / 4, y + (to_y - y) * k / 4) for k in (1, 2, 3, 4)),
        ]
        for kind, px, py in (*steps, ("mouseReleased", to_x, to_y)):
            self.send("Input.dispatchMouseEvent", type=kind, x=px, y=py, button="left", buttons=1, clickCount=1)

    def downloads(self, folder: Path, expression: str) -> list[Path]:
        """Files that an expression makes the page offer, saved into a folder."""
        folder.mkdir(parents=True)
        self._browser.finished.clear()
        self._browser.send(
            "Browser.setDownloadBehavior", behavior="allow", downloadPath=str(folder), eventsEnabled=True
        )
        self.evaluate(expression)
        self._browser.wait_for_download()
        return list(folder.iterdir())

    def screenshot(self, path: Path) -> None:
        """The whole page as PNG."""
        size = self.send("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        image = self.send("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(image["data"]))

    def pdf(self) -> bytes:
        """The page printed on A4."""
        printed = self.send("Page.printToPDF", paperWidth=8.27, paperHeight=11.69, preferCSSPageSize=True)
        return base64.b64decode(printed["data"])


class Chromium:
    """A browser process with one end of its two pipes."""

    def __init__(self, process: subprocess.Popen[bytes], to_browser: int, from_browser: int) -> None:
        self._process = process
        self._to, self._from = to_browser, from_browser
        self._buffer = b""
        self._last = 0
        self._pages: dict[str, BrowserPage] = {}
        self.loaded: set[str] = set()
        self.finished: list[str] = []

    def send(self, method: str, session: str | None = None, **parameters: Any) -> Any:
        """Send a command and wait for its answer; events that come first are kept."""
        self._last += 1
        number = self._last
        message = {"id": number, "method": method, "params": parameters, **({"sessionId": session} if session else {})}
        text = json.dumps(message).encode() + b"\0"
        while text:
            text = text[os.write(self._to, text) :]
        while True:
            message = self._receive(method)
            if message.get("id") == number:
                if "error" in message:
                    raise AssertionError(f"{method}: {message['error']}")
                return message["result"]

    def wait_for_load(self, session: str) -> None:
        while session not in self.loaded:
            self._receive("load")

    def wait_for_download(self) -> None:
        while not self.finished:
            self._receive("download")
        assert self.finished == ["completed"]

    def new_page(self) -> BrowserPage:
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self._pages[session] = BrowserPage(self, session)
        for domain in ("Page", "Runtime", "Log"):
            page.send(f"{domain}.enable")
        return page

    def _receive(self, waiting_for: str) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._from], [], [], TIME_LIMIT)[0]:
                raise AssertionError(f"the browser did not answer {waiting_for} within {TIME_LIMIT:g} s")
            received = os.read(self._from, 1 << 20)
            if not received:
                raise AssertionError(f"the browser ended with status {self._process.poll()} during {waiting_for}")
            self._buffer += received
        raw, self._buffer = self._buffer.split(b"\0", 1)
        message: dict[str, Any] = json.loads(raw)
        self._note(message)
        return message

    def _note(self, message: dict[str, Any]) -> None:
        session, method, parameters = message.get("sessionId", ""), message.get("method"), message.get("params", {})
        if method == "Browser.downloadProgress" and parameters["state"] != "inProgress":
            self.finished.append(parameters["state"])
        page = self._pages.get(session)
        if page is None:
            return
        if method == "Page.loadEventFired":
            self.loaded.add(session)
        elif method == "Runtime.exceptionThrown":
            page.problems.append(json.dumps(parameters["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert", "warning"):
            page.problems.append(json.dumps(parameters["args"]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            page.problems.append(parameters["entry"]["text"])


def chromium_path() -> str | None:
    """The installed browser; None where there is none."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def chromium(program: str) -> Iterator[Chromium]:
    """Start a browser with an empty profile, and end it with all its processes."""
    read_commands, write_commands = os.pipe()
    read_answers, write_answers = os.pipe()
    with tempfile.TemporaryDirectory(prefix="dynid-chromium-", ignore_cleanup_errors=True) as profile:
        # The protocol is spoken on file descriptors 3 and 4.
        shell = f'exec "$@" 3<&{read_commands} 4>&{write_answers}'
        process = subprocess.Popen(
            ["bash", "-c", shell, "chromium", program, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(read_commands, write_answers),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(read_commands)
        os.close(write_answers)
        browser = Chromium(process, write_commands, read_answers)
        try:
            yield browser
            browser.send("Browser.close")
        finally:
            os.close(write_commands)  # Chromium ends when its pipe is closed, whatever happened before
            os.close(read_answers)
            try:
                process.wait(TIME_LIMIT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
