"""The thermometer's driver: rows, stamps, silence, loss and return of its port, exactly when they should be."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from each import each
from serial_lines import SerialLine
from simulated_clock import SimulatedClock

from drivers.base import DriverSettings, Notice
from drivers.core.clock import SYSTEM_CLOCK, Clock
from drivers.core.errors import ConnectionFailedError, DriverStateError, UsageError
from drivers.gains import DriveGain
from drivers.serial_thermometer.driver import STREAM, SerialThermometerDriver
from drivers.serial_thermometer.port import CHUNK_BYTES, READ_TIMEOUT
from drivers.streams import Batch

JOINTS = ("shoulder", "elbow", "wrist")
CONNECTION = {
    "pattern": r"T(?P<channel>\d)=(?P<value>[-+.\d]+)",
    "channels": {1: "wrist", 2: "shoulder"},
    "rate": 20,
    "timeout": 2.0,
}
BUFFER_BYTES = 1 << 16
"""Size of the port's buffer in these tests, a sixteenth of the real one."""

LIMIT = 60.0
"""[s] that a test in real time waits for what must come."""
Make = Callable[..., SerialThermometerDriver]


def made(url: str, clock: Clock, **keys: object) -> SerialThermometerDriver:
    return SerialThermometerDriver(
        DriverSettings(JOINTS, CONNECTION | {"url": url} | keys, (DriveGain(1.0),) * 3, clock=clock)
    )


@pytest.fixture
def line(clock: SimulatedClock) -> SerialLine:
    line = SerialLine(clock)
    line.plug_in()
    return line


@pytest.fixture
def opened(clock: SimulatedClock, line: SerialLine) -> Iterator[Make]:
    """Makes a driver that runs; the thermometer spoke 5 ms ago."""
    drivers = ExitStack()

    def make(**keys: object) -> SerialThermometerDriver:
        driver = drivers.enter_context(closing(made(line.path, clock, **keys)))
        begun = clock.now()
        clock.call_at(begun + 0.105, lambda: line.say("12=99\nT1=20 T2=30\nT1"))
        driver.open()
        assert clock.now() == pytest.approx(begun + 0.11, abs=1e-9)
        driver.start()
        assert driver.read(0.0) == ()
        driver.notices()
        clock.sleep(0.005)  # now nothing happens at the moment at which the port's thread looks
        return driver

    with drivers:
        yield make


def listen(driver: SerialThermometerDriver, clock: Clock, seconds: float) -> tuple[list[Batch], list[Notice]]:
    """What a driver says in a while [s]."""
    blocks: list[Batch] = []
    notices: list[Notice] = []
    end = clock.now() + seconds
    while (left := end - clock.now()) > 1e-9:
        blocks += driver.read(min(left, READ_TIMEOUT))
        notices += driver.notices()
    return blocks, notices


def rows(blocks: list[Batch]) -> np.ndarray:
    return np.concatenate([block.values["temperature"] for block in blocks] or [np.empty((0, 2))])


def stamps(blocks: list[Batch]) -> np.ndarray:
    times = np.concatenate([block.time for block in blocks])
    np.testing.assert_array_equal(times, np.concatenate([block.host_time for block in blocks]))
    return times


def told(notices: list[Notice]) -> list[str]:
    return [f"{notice.level}: {notice.message}" for notice in notices]


def test_it_moves_nothing_and_its_columns_are_in_the_joints_order(clock: SimulatedClock, line: SerialLine) -> None:
    driver = made(line.path, clock)
    clock.call_at(clock.now() + 0.5, lambda: line.say("\nT1=20 T2=30\n"))
    driver.open()
    (layout,) = driver.streams()
    assert (layout.name, layout.rate, layout.essential) == (STREAM, 20.0, False)
    assert layout.channels[0].columns == ("shoulder", "wrist")
    assert layout.channels[0].unit == "degC"
    driver.start()
    with pytest.raises(DriverStateError, match="cannot move"):
        driver.command(np.zeros(3))
    before = clock.now()
    assert driver.read(0.25) == ()
    assert clock.now() == before + 0.25
    driver.close()
    assert not line.opened


def test_lines_become_rows_stamped_at_their_ends(opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    driver = opened()
    spoken = clock.now()
    line.say("=9\nT1=20 T2=30\nT2=31\nT1=21\nT1=22\nT1=23\nT2=33\n")
    blocks, notices = listen(driver, clock, 0.02)
    expected = [[30, 20], [31, 21], [np.nan, 22], [33, 23]]  # a channel that comes again ends a row
    np.testing.assert_array_equal(rows(blocks), expected)
    # The 45 characters came within 10 ms, which end 5 ms from when they were sent: they are spread over these.
    ends = np.array([15, 27, 33, 45]) / 45
    np.testing.assert_allclose(stamps(blocks), spoken - 0.005 + 0.01 * ends, rtol=0, atol=1e-9)
    assert notices == []


def test_stamps_lie_where_the_baud_rate_puts_the_characters(
    opened: Make, clock: SimulatedClock, line: SerialLine
) -> None:
    driver = opened(baudrate=115_200)
    spoken = clock.now()
    line.say("\nT1=20 T2=30\nT1=21 T2=31\nT1=2")
    blocks, _ = listen(driver, clock, 0.02)
    after = np.array([12 + 4, 4]) * 10 / 115_200  # characters behind each line end, ten bits each
    np.testing.assert_allclose(stamps(blocks), spoken + 0.005 - after, rtol=0, atol=1e-9)


def test_an_unfinished_row_comes_after_a_period(opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    driver = opened()
    line.say("\nT1=20\n")
    stamp = clock.now() + 0.005
    blocks, _ = listen(driver, clock, 0.005 + 0.0499)
    assert blocks == []
    blocks, _ = listen(driver, clock, 0.0101)
    np.testing.assert_array_equal(rows(blocks), [[np.nan, 20]])
    assert stamps(blocks) == pytest.approx([stamp], abs=1e-9)


def test_five_thousand_lines_a_second(opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    driver = opened(channels={1: "elbow"}, rate=5000, baudrate=1_000_000, range=[-60, 3000])
    line.say("\n")
    begun = clock.now()

    def send() -> None:
        text = "".join(f"T1={number / 10:.1f}\n" for number in range(5000))
        for number, start in enumerate(range(0, len(text), 97)):  # wherever they are cut
            clock.sleep_until(begun + 0.002 * number)
            line.say(text[start : start + 97])

    sender = clock.thread(send, "sender")
    sender.start()
    blocks, notices = listen(driver, clock, 1.0)
    sender.join()
    np.testing.assert_array_equal(rows(blocks)[:, 0], np.arange(5000) / 10)
    assert np.all(np.diff(stamps(blocks)) > 0)
    assert notices == []


def test_hostile_lines_are_counted_in_one_notice(opened: Make, clock: SimulatedClock, line: SerialLine) -> None:
    driver = opened()
    line.say("\n" + "rubbish\n" * 30 + "T1=+-+\n" * 3 + "T1=999\n" + "T7=1\n")
    begun = clock.now()
    for number in range(110):
        clock.call_at(begun + 0.05 + 0.1 * number, lambda: line.say("T1=20 T2=30\nmore rubbish\n"))
    blocks, notices = listen(driver, clock, 11.0)
    np.testing.assert_array_equal(rows(blocks), [[30.0, 20.0]] * 110)
    assert told(notices) == [
        "warning: 34 lines ignored: 30 do not match the pattern, 3 have no number for the value,"
        " 1 have a temperature outside the accepted range; the last one: 'T1=999'",
        "warning: values of channels that 'channels' does not name: '7'",
        "warning: 100 lines ignored: 100 do not match the pattern; the last one: 'more rubbish'",
    ]
    assert [notice.time - begun for notice in notices] == pytest.approx([0.005, 0.005, 10.005], abs=READ_TIMEOUT + 1e-6)
    driver.stop()
    assert told(list(driver.notices())) == [
        "warning: 10 lines ignored: 10 do not match the pattern; the last one: 'more rubbish'"
    ]


@pytest.mark.parametrize(("rate", "allowed"), [(20, 0.25), (100, 0.2), (2, 2.5)])
def test_silence_is_told_once_and_so_is_its_end(
    opened: Make, clock: SimulatedClock, line: SerialLine, rate: float, allowed: float
) -> None:
    driver = opened(rate=rate)
    line.say("\nT1=20 T2=30\n")
    heard = clock.now() + 0.005
    _, notices = listen(driver, clock, 0.005 + allowed - 1e-6)
    assert notices == []
    _, notices = listen(driver, clock, 100.0)
    assert [notice.level for notice in notices] == ["warning"]
    assert notices[0].message.startswith("no temperature for ")
    assert allowed < notices[0].time - heard <= allowed + 3 * READ_TIMEOUT + 1e-9
    line.say("\nT1=20 T2=30\n")
    _, notices = listen(driver, clock, 0.02)
    assert told(notices) == [f"info: sends again after {100.0 + allowed:.1f} s"]


def test_a_stall_of_the_computer_is_not_taken_for_silence(
    opened: Make, clock: SimulatedClock, line: SerialLine
) -> None:
    driver = opened(required=True)
    line.say("\nT1=20 T2=30\n")
    listen(driver, clock, 0.1)
    clock.stall(0.6)
    line.say("T1=21 T2=31\n")  # came meanwhile, and the port's thread has not had its turn yet
    assert driver.read(0.0) == ()
    assert driver.notices() == []
    blocks, notices = listen(driver, clock, 0.02)
    np.testing.assert_array_equal(rows(blocks), [[31.0, 21.0]])
    assert notices == []


@pytest.mark.parametrize(("required", "level"), [(False, "warning"), (True, "error")])
def test_unplugged_and_plugged_in_again(
    opened: Make, clock: SimulatedClock, line: SerialLine, required: bool, level: str
) -> None:
    driver = opened(required=required)
    assert driver.streams()[0].essential is required
    line.say("\nT1=20 T2=30\nT1=2")
    blocks, _ = listen(driver, clock, 0.1)
    np.testing.assert_array_equal(rows(blocks), [[30.0, 20.0]])
    gone = clock.now()
    line.pull_out()
    clock.call_at(gone + 130.5, line.plug_in)
    clock.call_at(gone + 131.203, lambda: line.say("\nT1=25 T2=35\n"))
    blocks, notices = listen(driver, clock, 131.25)
    assert told(notices) == [
        f"{level}: the port is gone: Input/output error; it is opened again when it is back",
        "warning: 1 line ignored: 1 were cut off; the last one: 'T1=2'",
        "warning: the port is still gone after 60 s, 60 attempts",
        "warning: the port is still gone after 120 s, 120 attempts",
        "info: the port is open again after 131.0 s, attempt 131",
    ]
    assert [notice.time - gone for notice in notices] == pytest.approx(
        [0, 0, 60, 120, 131], abs=2 * READ_TIMEOUT + 1e-6
    )
    np.testing.assert_array_equal(rows(blocks), [[35.0, 25.0]])
    assert stamps(blocks)[0] - gone == pytest.approx(131.203, abs=READ_TIMEOUT)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("", "within 0.3 s, not a single character"),
        ("hello\n", "within 0.3 s; 14 line.* do not match the pattern; the last one: 'hello'"),
        ("T5=20\n", r"within 0.3 s; only of channels that .* '5'"),
        ("T1=20", "within 0.3 s; 75 characters, but no whole line"),
    ],
)
def test_a_port_without_temperatures_is_refused_at_opening(
    clock: SimulatedClock, line: SerialLine, said: str, message: str
) -> None:
    driver = made(line.path, clock, timeout=0.3)
    begun = clock.now()
    for number in range(15):
        clock.call_at(begun + 0.015 + 0.018 * number, lambda: line.say(said))
    with pytest.raises(ConnectionFailedError, match=message):
        driver.open()
    assert begun + 0.3 <= clock.now() < begun + 0.3 + READ_TIMEOUT + 1e-9  # until the port's thread has ended
    assert not line.opened
    with pytest.raises(DriverStateError):
        driver.start()


def test_a_port_that_goes_away_while_it_is_opened_is_refused(clock: SimulatedClock, line: SerialLine) -> None:
    gone = clock.now() + 0.7
    clock.call_at(gone, line.pull_out)
    with pytest.raises(ConnectionFailedError, match="the port is gone: Input/output error"):
        made(line.path, clock).open()
    assert clock.now() == gone


@each(
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
def test_a_port_that_is_none_is_refused(url: str, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message):
        made(url, SYSTEM_CLOCK).open()


def test_what_nobody_reads_is_dropped_and_told(
    opened: Make, clock: SimulatedClock, line: SerialLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.serial_thermometer.port.BUFFER_BYTES", BUFFER_BYTES)
    driver = opened()
    spoken = "T1=20.125 T2=30.125\n" * (CHUNK_BYTES // 10)
    kept = BUFFER_BYTES // CHUNK_BYTES
    line.say("\nT1=99")  # goes on in what will be dropped
    listen(driver, clock, 0.02)
    for number in range(kept + 10):
        line.say(spoken[number * CHUNK_BYTES % 20 :][:CHUNK_BYTES])
        clock.sleep(READ_TIMEOUT)
    blocks, notices = listen(driver, clock, 0.1)
    assert told(notices) == [
        "warning: 1 line ignored: 1 were cut off; the last one: 'T1=99'",
        f"warning: {10 * CHUNK_BYTES} characters were dropped because they were not read",
    ]
    np.testing.assert_array_equal(rows(blocks), [[30.125, 20.125]] * (BUFFER_BYTES // 20 - 1))


@pytest.mark.realtime
def test_over_a_socket_that_closes_and_comes_back() -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(LIMIT)
    driver = made(f"socket://127.0.0.1:{listener.getsockname()[1]}", SYSTEM_CLOCK, timeout=LIMIT)
    blocks: list[Batch] = []
    notices: list[Notice] = []

    def hear(done: Callable[[], bool], spoken: bytes = b"") -> None:
        end = time.monotonic() + LIMIT
        while not done():
            assert time.monotonic() < end, told(notices)
            if spoken:
                peer.sendall(spoken)  # pyserial throws away what comes before the port is quite open
            blocks.extend(driver.read(0.1))
            notices.extend(driver.notices())

    opening = threading.Thread(target=driver.open)
    opening.start()
    peer, _ = listener.accept()
    while opening.is_alive():
        peer.sendall(b"T1=20 T2=30\n")
        opening.join(0.1)
    try:
        driver.start()
        peer.sendall(b"\n" + b"T1=21 T2=31\n" * 20)
        hear(lambda: rows(blocks)[:, 1].tolist().count(21.0) >= 20)
        np.testing.assert_array_equal(rows(blocks)[-20:], [[31.0, 21.0]] * 20)
        peer.shutdown(socket.SHUT_WR)
        hear(lambda: any("the port is gone" in message for message in told(notices)))
        peer.close()
        peer, _ = listener.accept()
        hear(lambda: 25.0 in rows(blocks), b"T1=25 T2=35\n")
        assert any("info: the port is open again" in message for message in told(notices))
        assert rows(blocks)[-1].tolist() == [35.0, 25.0]
    finally:
        driver.close()
        peer.close()
        listener.close()


def test_a_reading_thread_that_breaks_is_told(
    clock: SimulatedClock, line: SerialLine, opened: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = opened()

    def broken(_: object) -> None:
        raise KeyError("a bug")

    monkeypatch.setattr(driver._port, "_put", broken)
    line.say("T1=20\n")
    clock.sleep(0.05)
    (breakdown,) = clock.breakdowns()
    assert str(breakdown) == f"the thread 'thermometer {line.path}' broke: KeyError: 'a bug'"
