"""What does the live page cost, and does a slow browser slow a recording? `python -m studies.recording.live_page 60`.

Records a simulated UR5e over RTDE at 500 Hz for so many seconds with `dynid record --browser`, beside two busy
processes. The page is open in headless Chromium and in three readers of its socket; a fifth never reads. Prints what
the recording lost, the shares of a core of recorder and server, and what the fifth was given. Then, without a bus,
rows with this computer's time go through the page to Chromium: how old the newest one is when it has been drawn.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from daq.live.page import browser_page
from daq.robot.loader import load_robot
from studies.recording.lossless import GRACE, RATE, ROBOT, SHELL_LOOP, cpu_seconds

sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))
from chromium import TIME_LIMIT, chromium, chromium_path

HOST = "127.0.0.62"
HANDSHAKE = (
    "GET /socket?{query} HTTP/1.1\r\nHost: {netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


def never_reading(address: str) -> socket.socket:
    """A browser's connection that is opened and then left."""
    parts = urlsplit(address)
    client = socket.socket()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    client.connect((parts.hostname, parts.port))
    client.sendall(HANDSHAKE.format(query=parts.query, netloc=parts.netloc).encode())
    return client


def read_all(address: str, counts: list[int]) -> None:
    """Read a page's messages until it ends, and count them."""
    count = 0
    with (
        suppress(ConnectionClosed, OSError),
        connect(address.replace("http", "ws").replace("/?", "/socket?"), open_timeout=TIME_LIMIT) as client,
    ):
        while True:
            client.recv()
            count += 1
    counts.append(count)


def server_of(recorder: int) -> int:
    """The newest process that a recorder started: the page's server."""
    children = Path(f"/proc/{recorder}/task/{recorder}/children").read_text().split()
    names = {int(child): Path(f"/proc/{child}/cmdline").read_bytes() for child in children}
    return max(child for child, command in names.items() if b"spawn_main" in command)


def recorded(seconds: float, folder: Path) -> dict[str, object]:
    """The recording with five browsers."""
    dynid = str(Path(sys.executable).with_name("dynid"))
    # The arm is the instrument here: it must keep its 500 Hz, where that is permitted.
    command = ["nice", "-n", "-10", dynid, "sim", ROBOT, "--host", HOST, "--no-ui"]
    sim = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    busy = []
    try:
        assert sim.stdout is not None
        sim.stdout.readline()
        busy = [subprocess.Popen(["sh", "-c", SHELL_LOOP.format(seconds=round(seconds + GRACE))]) for _ in range(2)]
        out = folder / "run.h5"
        command = [dynid, "record", ROBOT, "--host", HOST, "--duration", str(seconds), "-o", str(out)]
        recorder = subprocess.Popen(
            [*command, "--browser", "--no-ui", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert recorder.stderr is not None
        address = next(line for line in recorder.stderr if line.startswith("live page: ")).split()[-1]
        counts: list[int] = []
        readers = [threading.Thread(target=read_all, args=(address, counts)) for _ in range(3)]
        for reader in readers:
            reader.start()
        silent = never_reading(address)
        program = chromium_path()
        assert program is not None
        with chromium(program) as browser:
            tab = browser.new_page()
            tab.resize(1400)
            tab.send("Page.navigate", url=address)
            time.sleep(5.0)  # imports are over by then
            processes = {"dynid record": recorder.pid, "its page's server": server_of(recorder.pid)}
            since, before = time.monotonic(), {name: cpu_seconds(process) for name, process in processes.items()}
            time.sleep(seconds / 2)
            elapsed = time.monotonic() - since
            used = {name: (cpu_seconds(process) - before[name]) / elapsed for name, process in processes.items()}
            drawn = int(tab.evaluate("document.documentElement.dataset.drawn"))
        printed, said = recorder.communicate()
        report = json.loads(printed)
        silent.settimeout(10.0)
        unread = 0
        with suppress(OSError):
            while chunk := silent.recv(1 << 20):
                unread += len(chunk)
        for reader in readers:
            reader.join()
        stream = report["streams"]["joints"]
        return {
            "recorded [s]": stream["duration"],
            "samples": stream["samples"],
            "lost": stream["lost"],
            "ended": report["stopped_by"] or said.strip() or "at its end",
            **{f"share of a core, {name} [%]": 100.0 * share for name, share in used.items()},
            "messages to each reader": sorted(counts),
            "frames in Chromium": drawn,
            "bytes that the silent one had waiting": unread,
        }
    finally:
        for process in (sim, *busy):
            process.terminate()
            process.wait(10.0)


def ages(seconds: float) -> dict[str, object]:
    """Age [ms] of the newest row in each frame that Chromium draws."""
    robot_file = load_robot(ROBOT)
    channels = [
        f"{quantity}/{joint}"
        for quantity in ("measured", "predicted", "residual", "band", "position")
        for joint in robot_file.robot.joint_names
    ]
    program = chromium_path()
    assert program is not None
    with browser_page(robot_file, channels) as page, chromium(program) as browser:
        tab = browser.new_page()
        tab.resize(1400)
        tab.send("Page.navigate", url=page.address)
        stopping = threading.Event()

        def write() -> None:
            begun, number = time.time(), 0
            while not stopping.is_set():
                page.append(np.array([time.time()]), np.sin(time.time() * np.arange(1, 31))[None])
                number += 1
                time.sleep(max(0.0, begun + number / RATE - time.time()))

        writer = threading.Thread(target=write)
        writer.start()
        time.sleep(3.0)
        tab.evaluate("""window.lags = []; new MutationObserver(() =>
          window.lags.push(1000 * Number(document.documentElement.dataset.lag)))
          .observe(document.documentElement, {attributeFilter: ["data-lag"]})""")
        time.sleep(seconds)
        lags = np.array(tab.evaluate("window.lags"))
        stopping.set()
        writer.join()
    middle, most = np.percentile(lags, [50, 99])
    return {"age when drawn, median [ms]": middle, "99 % [ms]": most, "frames per second": len(lags) / seconds}


if __name__ == "__main__":
    length = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    with tempfile.TemporaryDirectory() as name:
        figures = {**recorded(length, Path(name)), **ages(min(length, 20.0))}
    print("| figure | value |\n|---|---:|")
    for words, value in figures.items():
        print(f"| {words} | {value:.4g} |" if isinstance(value, float) else f"| {words} | {value} |")
