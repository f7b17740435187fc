"""The thermometer's driver on ports that need no hardware: loop://, socket:// and a pseudo-terminal."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
import tomllib
import tty
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import serial

from drivers.base import DRIVERS_GROUP, Driver, DriverSettings, Notice
from drivers.errors import ConnectionFailedError, DriverStateError, UsageError
from drivers.gains import DriveGain
from drivers.serial_thermometer import driver as driver_module
from drivers.serial_thermometer import port as port_module
from drivers.serial_thermometer.driver import STREAM, SerialThermometerDriver
from drivers.streams import Block

JOINTS = ("shoulder", "elbow", "wrist")
PATTERN = r"T(?P<channel>\d)=(?P<value>[-+.\d]+)"
CHANNELS = {1: "wrist", 2: "shoulder"}
Make = Callable[..., SerialThermometerDriver]


@pytest.fixture
def make() -> Iterator[Make]:
    made: list[SerialThermometerDriver] = []

    def build(url: str, **keys: object) -> SerialThermometerDriver:
        connection = {"url": url, "pattern": PATTERN, "channels": CHANNELS, "rate": 20, "timeout": 2.0} | keys
        made.append(SerialThermometerDriver(DriverSettings(JOINTS, connection, (DriveGain(1.0),) * 3)))
        return made[-1]

    yield build
    for one in made:
        one.close()


class Pty:
    """A port whose other end a test holds."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug()

    def plug(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self) -> None:
        self.path.unlink()
        os.close(self.master)

    def say(self, text: str) -> None:
        os.write(self.master, text.encode())


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[Pty]:
    port = Pty(tmp_path / "port")
    yield port
    with contextlib.suppress(OSError):
        os.close(port.master)


@contextlib.contextmanager
def talking(say: Callable[[str], object], text: str, period: float = 0.05) -> Iterator[None]:
    """Say a text again and again while the block runs."""
    ending = threading.Event()

    def talk() -> None:
        while not ending.wait(period):
            with contextlib.suppress(OSError):
                say(text)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


def open_talking(driver: SerialThermometerDriver, say: Callable[[str], object]) -> None:
    with talking(say, "T1=20 T2=30\n", 0.02):
        driver.open()


def gather(driver: Driver, done: Callable[[list[Block], list[Notice]], bool], limit: float = 5.0):
    blocks: list[Block] = []
    notices: list[Notice] = []
    end = time.monotonic() + limit
    while not done(blocks, notices) and time.monotonic() < end:
        blocks += driver.read(0.02)
        notices += driver.notices()
    return blocks, notices


def rows(blocks: list[Block]) -> np.ndarray:
    return np.concatenate([block.values["temperature"] for block in blocks] or [np.empty((0, 2))])


def text_of(notices: list[Notice]) -> str:
    return "\n".join(f"{notice.level}: {notice.message}" for notice in notices)


def test_the_driver_is_registered() -> None:
    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    value = project["project"]["entry-points"][DRIVERS_GROUP]["serial_thermometer"]
    assert EntryPoint("serial_thermometer", value, DRIVERS_GROUP).load() is SerialThermometerDriver


def test_states_follow_the_contract(make: Make, pty: Pty) -> None:
    driver: SerialThermometerDriver = make(str(pty.path))
    for call in (driver.streams, driver.start, lambda: driver.read(0.0)):
        with pytest.raises(DriverStateError):
            call()
    driver.stop()
    open_talking(driver, pty.say)
    with pytest.raises(DriverStateError):
        driver.open()
    (layout,) = driver.streams()
    assert (layout.name, layout.rate, layout.essential) == (STREAM, 20.0, False)
    assert layout.channels[0].columns == ("shoulder", "wrist")  # in the joints' order
    assert layout.channels[0].unit == "degC"
    driver.start()
    with pytest.raises(DriverStateError, match="cannot move"):
        driver.command(np.zeros(3))
    assert driver.read(0.0) == ()
    driver.stop()
    driver.stop()
    driver.start()
    driver.close()
    driver.close()
    open_talking(driver, pty.say)  # once more


def test_lines_become_rows_in_the_joints_order(make: Make, pty: Pty) -> None:
    driver = make(str(pty.path))
    open_talking(driver, pty.say)
    driver.start()
    pty.say("T1=9\n")  # may have been under way
    before = time.monotonic()
    pty.say("T1=20 T2=30\nT2=31\nT1=21\nT1=22\nT1=23\nT2=33\n")
    blocks, _ = gather(driver, lambda blocks, _: len(rows(blocks)) >= 4)
    expected = [[30, 20], [31, 21], [np.nan, 22], [33, 23]]  # a channel that comes again ends a row
    np.testing.assert_array_equal(rows(blocks), expected)
    times = np.concatenate([block.time for block in blocks])
    assert np.all(np.diff(times) > 0)
    assert before - 0.05 < times[0] < times[-1] < time.monotonic()
    np.testing.assert_array_equal(times, np.concatenate([block.host_time for block in blocks]))


def test_an_unfinished_row_comes_after_a_period(make: Make, pty: Pty) -> None:
    driver = make(str(pty.path))
    open_talking(driver, pty.say)
    driver.start()
    pty.say("\nT1=20\n")
    blocks, _ = gather(driver, lambda blocks, _: bool(blocks))
    np.testing.assert_array_equal(rows(blocks), [[np.nan, 20]])


def test_over_a_socket_that_closes_and_comes_back(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_module, "RETRY_PERIOD", 0.1)
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(5.0)
    driver = make(f"socket://127.0.0.1:{listener.getsockname()[1]}")
    opening = threading.Thread(target=driver.open)
    opening.start()
    peer, _ = listener.accept()
    with talking(lambda text: peer.sendall(text.encode()), "T1=20 T2=30\n", 0.01):
        opening.join(5.0)
        driver.start()
        blocks, _ = gather(driver, lambda blocks, _: len(rows(blocks)) >= 20)
    assert len(rows(blocks)) >= 20
    peer.close()
    _, notices = gather(driver, lambda _, notices: "port has gone" in text_of(notices))
    assert "warning: the port has gone" in text_of(notices)
    peer, _ = listener.accept()
    with talking(lambda text: peer.sendall(text.encode()), "T1=25 T2=35\n", 0.01):
        blocks, notices = gather(driver, lambda blocks, _: len(rows(blocks)) >= 5)
    assert "info: the port is open again" in text_of(notices)
    assert rows(blocks)[-1].tolist() == [35.0, 25.0]
    peer.close()
    listener.close()


def test_over_a_loop(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    ports: list[serial.SerialBase] = []
    real = serial.serial_for_url

    def kept(*args: object, **kwargs: object) -> serial.SerialBase:
        ports.append(real(*args, **kwargs))
        return ports[-1]

    monkeypatch.setattr(serial, "serial_for_url", kept)
    driver = make("loop://", baudrate=1_000_000)
    with talking(lambda text: ports and ports[-1].write(text.encode()), "T1=20 T2=30\n", 0.01):
        driver.open()
        driver.start()
        blocks, _ = gather(driver, lambda blocks, _: len(rows(blocks)) >= 10)
    assert len(rows(blocks)) >= 10
    assert np.all(rows(blocks) == [30.0, 20.0])


def test_five_thousand_lines_a_second_without_loss(make: Make, pty: Pty) -> None:
    lines, rate = 5000, 5000.0
    driver = make(str(pty.path), channels={1: "elbow"}, rate=rate, baudrate=1_000_000, range=[-60, 3000])
    open_talking(driver, pty.say)
    driver.start()
    pty.say("\n")

    def send() -> None:
        begin = time.monotonic()
        for number in range(0, lines, 50):
            pty.say("".join(f"T1={(number + step) / 10:.1f}\n" for step in range(50)))
            time.sleep(max(0.0, begin + (number + 50) / rate - time.monotonic()))

    sender = threading.Thread(target=send)
    sender.start()
    blocks, notices = gather(driver, lambda blocks, _: sum(len(block.time) for block in blocks) >= lines, 15.0)
    sender.join()
    np.testing.assert_allclose(rows(blocks)[:, 0], np.arange(lines) / 10)
    assert np.all(np.diff(np.concatenate([block.time for block in blocks])) > 0)
    assert "ignored" not in text_of(notices)


def test_hostile_lines_are_counted_in_one_notice(make: Make, pty: Pty) -> None:
    driver = make(str(pty.path))
    open_talking(driver, pty.say)
    driver.start()
    pty.say("\n" + "rubbish\n" * 30 + "T1=+-+\n" * 3 + "T1=999\n" + "T7=1\n")
    with talking(pty.say, "T1=20 T2=30\nmore rubbish\n"):
        blocks, notices = gather(driver, lambda blocks, _: len(rows(blocks)) >= 5)
    assert len(rows(blocks)) >= 5
    (told,) = [notice for notice in notices if "ignored" in notice.message]
    assert told.level == "warning"
    assert "do not match the pattern" in told.message
    assert "channel(s) '7' come" in text_of(notices)
    driver.stop()
    assert "more rubbish" in text_of(list(driver.notices()))  # the rest is told at the end


def test_silence_is_told_once_and_so_is_its_end(make: Make, pty: Pty) -> None:
    driver = make(str(pty.path))
    open_talking(driver, pty.say)
    driver.start()
    _, notices = gather(driver, lambda _, notices: bool(notices), 2.0)
    assert text_of(notices).startswith("warning: no temperature for 0.2")
    _, more = gather(driver, lambda _, notices: bool(notices), 0.4)
    assert more == []
    pty.say("\nT1=20 T2=30\n")
    _, notices = gather(driver, lambda _, notices: bool(notices))
    assert text_of(notices).startswith("info: speaks again after")


@pytest.mark.parametrize(("required", "level"), [(False, "warning"), (True, "error")])
def test_unplugged_and_plugged_in_again(
    make: Make, pty: Pty, monkeypatch: pytest.MonkeyPatch, required: bool, level: str
) -> None:
    monkeypatch.setattr(port_module, "RETRY_PERIOD", 0.1)
    monkeypatch.setattr(driver_module, "STILL_GONE_PERIOD", 0.3)
    driver = make(str(pty.path), required=required)
    open_talking(driver, pty.say)
    assert driver.streams()[0].essential is required
    driver.start()
    pty.say("\nT1=20 T2=30\nT1=2")
    gather(driver, lambda blocks, _: bool(blocks))
    pty.unplug()
    _, notices = gather(driver, lambda _, notices: "still gone" in text_of(notices))
    assert f"{level}: the port has gone" in text_of(notices)
    assert "were cut off" in text_of(notices)
    assert "warning: the port is still gone after" in text_of(notices)
    pty.plug()
    with talking(pty.say, "T1=25 T2=35\n"):
        blocks, notices = gather(driver, lambda blocks, _: bool(blocks))
    assert "info: the port is open again after" in text_of(notices)
    assert rows(blocks)[0].tolist() == [35.0, 25.0]


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("", "not a single character"),
        ("hello\n", "do not match the pattern; the last one: 'hello'"),
        ("T5=20\n", r"only of channel\(s\) '5'"),
        ("T1=20", "but no whole line"),
    ],
)
def test_a_port_without_temperatures_is_refused_at_opening(make: Make, pty: Pty, said: str, message: str) -> None:
    driver = make(str(pty.path), timeout=0.3)
    with talking(pty.say, said, 0.02), pytest.raises(ConnectionFailedError, match=message):
        driver.open()
    with pytest.raises(DriverStateError):
        driver.start()


@pytest.mark.parametrize(
    ("url", "kind", "message"),
    [
        (
            "/dev/no-such-port",
            ConnectionFailedError,
            r"^/dev/no-such-port: cannot be opened: No such file or directory \(is it",
        ),
        ("socket://127.0.0.1:1", ConnectionFailedError, "cannot be opened"),
        ("carrier-pigeon://coop", UsageError, "pigeon"),
    ],
)
def test_a_port_that_is_none_is_refused(make: Make, url: str, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        make(url).open()


def test_two_readers_of_one_port_are_refused(make: Make, pty: Pty) -> None:
    open_talking(make(str(pty.path)), pty.say)
    with pytest.raises(ConnectionFailedError, match="another program has opened it"):
        make(str(pty.path)).open()


def test_what_nobody_reads_is_dropped_and_told(make: Make, pty: Pty, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_module, "BUFFER_BYTES", 2000)
    driver = make(str(pty.path))
    open_talking(driver, pty.say)
    driver.start()
    for _ in range(40):
        pty.say("T1=20.125 T2=30.125\nT" * 9)
        time.sleep(0.02)
    driver._port.close()
    blocks, notices = gather(driver, lambda _, notices: "dropped" in text_of(notices), 1.0)
    assert "characters were dropped because nobody read them" in text_of(notices)
    assert {value for value in rows(blocks).ravel() if not np.isnan(value)} == {20.125, 30.125}
