from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted_rtde import Cut, Never, Sample, ScriptedController, Step, Text, Wait, data_package, paced, package, steady
from simulated_clock import START, SimulatedClock, simulated_time

from drivers.core.errors import ConnectionFailedError, ConnectionLostError, UsageError
from drivers.rtde import receiver as receiver_module
from drivers.rtde.receiver import RtdeReceiver, Samples

REQUIRED = {"actual_q": "VECTOR6D", "actual_current": "VECTOR6D"}
OPTIONAL = {"joint_temperatures": "VECTOR6D", "robot_mode": "INT32"}
VARIABLES = ["timestamp", *REQUIRED, *OPTIONAL]
Make = Callable[..., ScriptedController]
Connect = Callable[..., RtdeReceiver]


@pytest.fixture
def connect(clock: SimulatedClock) -> Iterator[Connect]:
    made = ExitStack()

    def make(server: ScriptedController, rate: float | None = None, timeout: float = 2.0) -> RtdeReceiver:
        receiver = made.enter_context(closing(receiver_of(server, clock, rate, timeout)))
        receiver.connect()
        return receiver

    with made:
        yield make


def receiver_of(
    server: ScriptedController, clock: SimulatedClock, rate: float | None = None, timeout: float = 2.0
) -> RtdeReceiver:
    return RtdeReceiver("arm", 30004, REQUIRED, OPTIONAL, rate, timeout, server.connect, clock)


def take_until(receiver: RtdeReceiver, count: int) -> list[Samples]:
    batches: list[Samples] = []
    while sum(len(batch.rows) for batch in batches) < count:
        batch = receiver.take(0.2)
        assert batch is not None
        batches.append(batch)
    return batches


def take_all(receiver: RtdeReceiver) -> tuple[list[Samples], str]:
    batches: list[Samples] = []
    try:
        while True:
            batch = receiver.take(1.0)
            if batch is not None:
                batches.append(batch)
    except ConnectionLostError as error:
        return batches, error.message


def clocks(batches: list[Samples]) -> list[float]:
    return [float(clock) for batch in batches for clock in batch.rows["timestamp"]]


def test_every_package_arrives_once_in_order_as_sent_and_stamped_on_arrival(
    clock: SimulatedClock, controller: Make, connect: Connect
) -> None:
    receiver = connect(controller(lambda number: paced(500.0, start=10.0)))
    assert (receiver.rate, str(receiver.version)) == (500.0, "5.22.0.0")
    receiver.start()
    begun = clock.now()
    batches = take_until(receiver, 2001)
    assert clocks(batches) == [10.0 + index / 500 for index in range(2001)]
    rows = np.concatenate([batch.rows for batch in batches])
    assert np.array_equal(rows["actual_q"][:, 0], rows["timestamp"])
    assert np.allclose(rows["joint_temperatures"][:, 5], 9 * (rows["timestamp"] + 0.5))
    assert set(rows["robot_mode"]) == {7}
    host = np.concatenate([batch.host_time for batch in batches])
    np.testing.assert_allclose(host, begun + np.arange(2001) / 500, rtol=0.0, atol=1e-9)
    assert sum(batch.lost for batch in batches) == 0


def test_what_came_while_the_computer_was_busy_is_stamped_late_but_not_lost(
    clock: SimulatedClock, controller: Make, connect: Connect
) -> None:
    server = controller(lambda number: [*steady(10.0, 10), Never()])
    receiver = connect(server)
    receiver.start()
    take_until(receiver, 10)
    clock.stall(0.7)  # longer than the silence that counts as a loss
    clock.sleep(0.03)
    server.send(b"".join(data_package(VARIABLES, Sample(10.0 + index / 500)) for index in range(10, 360)))
    (batch,) = take_until(receiver, 350)
    assert clocks([batch]) == [10.0 + index / 500 for index in range(10, 360)]
    assert set(batch.host_time) == {START + 0.73}
    assert batch.lost == 0


@given(missing=st.sets(st.integers(1, 198), max_size=60), rate=st.sampled_from([500.0, 125.0]))
@settings(max_examples=8)
def test_the_controllers_clock_tells_how_many_are_missing(missing: set[int], rate: float) -> None:
    sent = [sample for index, sample in enumerate(steady(3.0, 200, rate)) if index not in missing]
    with simulated_time() as clock:
        server = ScriptedController(clock, lambda number: [*sent, Never()])
        receiver = receiver_of(server, clock, rate)
        receiver.connect()
        receiver.start()
        batches = take_until(receiver, len(sent))
        assert sum(len(batch.rows) for batch in batches) == len(sent)
        assert sum(batch.lost for batch in batches) == len(missing)
        receiver.close()
        server.close()


def test_a_package_in_pieces_arrives_whole(controller: Make, connect: Connect) -> None:
    stream = b"".join(data_package(VARIABLES, Sample(1.0 + index / 500)) for index in range(5))
    steps: list[Step] = []
    for index in range(0, len(stream), 37):
        steps += [stream[index : index + 37], Wait(0.001)]
    receiver = connect(controller(lambda number: [*steps, Never()]))
    receiver.start()
    assert len(clocks(take_until(receiver, 5))) == 5


def test_refused_variables_are_left_out_and_told(controller: Make, connect: Connect) -> None:
    refuse = {"joint_temperatures": "NOT_FOUND", "robot_mode": "IN_USE"}
    server = controller(lambda number: [*steady(0.5, 3), Never()], refuse=refuse)
    receiver = connect(server)
    assert receiver.recipe.variables == ("timestamp", "actual_q", "actual_current")
    told = " ".join(notice.message for notice in receiver.notices())
    assert "joint_temperatures (NOT_FOUND)" in told
    assert "robot_mode (IN_USE)" in told
    assert receiver.notices() == []
    receiver.start()
    assert clocks(take_until(receiver, 3)) == [0.5, 0.502, 0.504]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"refuse": {"actual_current": "NOT_FOUND"}}, "refuses actual_current"),
        ({"refuse": {"timestamp": "NOT_FOUND"}}, "refuses timestamp"),
        ({"types": {"actual_q": "DOUBLE"}}, "actual_q is a DOUBLE"),
        ({"types": {"actual_q": "QUATERNION"}}, "unknown type 'QUATERNION'"),
        ({"accept_protocol": False}, "does not support RTDE version 2"),
        ({"greeting": b"SSH-2.0-OpenSSH_9.6\r\n"}, "not RTDE"),
        ({"greeting": b"\0\0\0\0"}, "not RTDE"),
        ({"mute_at": "V"}, "no answer within 0.3 s"),
        ({"mute_at": "O"}, "no answer within 0.3 s"),
    ],
)
def test_who_is_not_a_controller_is_refused(
    clock: SimulatedClock, controller: Make, connect: Connect, options: dict[str, object], words: str
) -> None:
    server = controller(lambda number: [], **options)
    with pytest.raises(ConnectionFailedError, match=words) as caught:
        connect(server, timeout=0.3)
    assert clock.now() == pytest.approx(START + (0.3 if "no answer" in words else 0.0), abs=1e-9)
    assert caught.value.where == "arm:30004"


def test_nobody_there() -> None:
    def refuse(host: str, port: int, timeout: float) -> socket.socket:
        assert (host, port, timeout) == ("arm", 30004, 0.5)
        raise ConnectionRefusedError(111, "Connection refused")

    with pytest.raises(ConnectionFailedError, match="cannot connect: Connection refused"):
        RtdeReceiver("arm", 30004, REQUIRED, {}, None, 0.5, refuse).connect()


@pytest.mark.parametrize("host", ["a" * 300, "bad\0host"])
def test_names_that_cannot_be(host: str) -> None:
    with pytest.raises(ConnectionFailedError, match="cannot connect"):
        RtdeReceiver(host, 30004, REQUIRED, {}, None, 0.5).connect()


def test_a_trickle_of_other_messages_does_not_outlast_the_time_limit(
    clock: SimulatedClock, controller: Make, connect: Connect
) -> None:
    hello = package("M", b"\2hi\2me\3")
    server = controller(lambda number: [], mute_at="V", greeting=hello, chatter=hello)
    with pytest.raises(ConnectionFailedError, match="no answer"):
        connect(server, timeout=0.42)
    assert clock.now() == pytest.approx(START + 0.42, abs=1e-9)


@each(("major", "rate"), [(3, 500.0), (5, 300.0), (5, 1000.0)])
def test_a_rate_that_the_controller_does_not_have(controller: Make, connect: Connect, major: int, rate: float) -> None:
    with pytest.raises(UsageError, match="'rate' is"):
        connect(controller(lambda number: [], major=major), rate=rate)


def test_the_maximum_rate_of_an_older_controller(controller: Make, connect: Connect) -> None:
    server = controller(lambda number: [], major=3)
    assert connect(server).rate == 125.0
    assert server.asked[0][0] == 125.0


def broken(tail: Iterable[Step]) -> Callable[[int], Iterable[Step]]:
    return lambda number: [*steady(1.0, 20), *tail]


TALK = [Text(3, "x", "still here"), Wait(0.3), Text(3, "x", "and here"), Wait(0.19), Text(3, "", "y"), Never()]
SAME = [step for _ in range(10) for step in (Sample(1.0 + 19 / 500), Wait(0.1))]


@pytest.mark.parametrize(
    ("tail", "words", "after"),
    [
        ([Never()], "no data for 0.5 s", 0.5),
        (TALK, "no data for 0.5 s", 0.5),
        (SAME, "no data for 0.5 s", 0.5),
        ([Wait(0.49), Sample(1.04), Never()], "no data for 0.5 s", 0.99),
        ([Cut()], "closed", 0.0),
        ([b"\0\0\0"], "not RTDE", 0.0),
        ([package("P", b"\1")], "does not match the requested recipe", 0.0),
        ([b"HTTP/1.1 400 Bad Request\r\n\r\n"], "not RTDE", 0.0),
        ([package("U", b"\1" + bytes(8))], "does not match the requested recipe", 0.0),
        ([package("U", b"\2" + data_package(VARIABLES, Sample(2.0))[4:])], "does not match the requested recipe", 0.0),
        ([Sample(0.5)], "clock jumped", 0.0),
        ([Sample(float("nan"))], "clock jumped", 0.0),
        ([package("M", b"\xff")], "ends in the middle", 0.0),
    ],
)
def test_what_came_before_a_failure_is_handed_out_and_then_nothing(
    clock: SimulatedClock, controller: Make, connect: Connect, tail: list[Step], words: str, after: float
) -> None:
    receiver = connect(controller(broken(tail)))
    receiver.start()
    begun = clock.now()
    batches, message = take_all(receiver)
    assert clock.now() - begun == pytest.approx(after, abs=1e-9)
    assert clocks(batches)[:20] == [1.0 + index / 500 for index in range(20)]
    assert sum(len(batch.rows) for batch in batches) == (21 if after == 0.99 else 20)
    assert words in message
    for _ in range(2):
        with pytest.raises(ConnectionLostError):
            receiver.take(0.1)


def test_a_flood_of_what_is_known_already_does_not_outlast_the_silence_limit(
    clock: SimulatedClock, controller: Make, connect: Connect
) -> None:
    def flood(number: int) -> Iterator[Step]:
        yield from steady(1.0, 20)
        for _ in range(200):
            clock.stall(0.01)  # whenever the receiver looks, there is something
            server.send(data_package(VARIABLES, Sample(1.0 + 19 / 500)))
            yield Wait(0.0)

    server = controller(flood)
    receiver = connect(server)
    receiver.start()
    begun = clock.now()
    assert "no data for 0.5 s" in take_all(receiver)[1]
    assert clock.now() - begun == pytest.approx(0.5, abs=0.021)


def test_repeated_packages_are_left_out(controller: Make, connect: Connect) -> None:
    twice = [sample for sample in steady(1.0, 50) for _ in range(2)]
    receiver = connect(controller(lambda number: [*twice, Never()]))
    receiver.start()
    batches = take_until(receiver, 50)
    assert clocks(batches) == [1.0 + index / 500 for index in range(50)]
    receiver.take(0.05)
    notices = receiver.notices()
    assert sum(int(notice.message.split()[0]) for notice in notices) == 50
    assert {notice.level for notice in notices} == {"warning"}


@each(
    ("before", "after", "lost", "said"),
    [(1.0, 2.0, 500 - 20, "connected again"), (100.0, 1.0, 0, "clock started again")],
)
def test_reconnecting_gives_new_values_and_counts_the_gap_unless_the_clock_started_again(
    controller: Make, connect: Connect, before: float, after: float, lost: int, said: str
) -> None:
    scripts = [[*steady(before, 20), Cut()], [*steady(after, 20), Never()]]
    receiver = connect(controller(lambda number: scripts[number]))
    receiver.start()
    take_all(receiver)
    receiver.reconnect()
    batches = take_until(receiver, 20)
    assert clocks(batches) == [after + index / 500 for index in range(20)]
    assert sum(batch.lost for batch in batches) == lost
    assert any(said in notice.message for notice in receiver.notices())


def test_reconnecting_drops_what_was_not_taken(clock: SimulatedClock, controller: Make, connect: Connect) -> None:
    scripts = [[*steady(1.0, 20), Cut()], [*steady(2.0, 5), Never()]]
    receiver = connect(controller(lambda number: scripts[number]))
    receiver.start()
    clock.sleep(0.2)
    receiver.reconnect()
    assert clocks(take_until(receiver, 5)) == [2.0 + index / 500 for index in range(5)]


def test_reconnecting_to_another_controller_is_refused(controller: Make, connect: Connect) -> None:
    server = controller(lambda number: [*steady(1.0, 2), Never()])
    receiver = connect(server)
    receiver.start()
    server.refuse["robot_mode"] = "NOT_FOUND"
    with pytest.raises(ConnectionFailedError, match="other variables"):
        receiver.reconnect()
    with pytest.raises(ConnectionLostError, match="not connected"):
        receiver.take(0.1)


def test_a_pause_is_no_gap(controller: Make, connect: Connect) -> None:
    starts = iter([1.0, 50.0])
    server = controller(lambda number: [*steady(next(starts), 10), Never()])
    receiver = connect(server)
    for begin in (1.0, 50.0):
        receiver.start()
        batches = take_until(receiver, 10)
        assert clocks(batches) == [begin + index / 500 for index in range(10)]
        assert sum(batch.lost for batch in batches) == 0
        receiver.pause()
    assert (server.pauses, server.connections) == (2, 1)


def test_what_is_not_taken_is_bounded_and_counted(
    clock: SimulatedClock, controller: Make, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(receiver_module, "BUFFER_SECONDS", 0.1)
    receiver = connect(controller(lambda number: [*steady(1.0, 200), Never()]))
    receiver.start()
    clock.sleep(0.3)
    batch = receiver.take(1.0)
    assert batch is not None
    assert len(batch.rows) == 50
    assert receiver.overflow == 150
    assert batch.rows["timestamp"][-1] == 1.0 + 199 / 500
    assert any("oldest samples were dropped" in notice.message for notice in receiver.notices())


def test_text_messages_become_notices(controller: Make, connect: Connect) -> None:
    steps = [Text(level, "safety", f"level {level}") for level in range(4)]
    receiver = connect(controller(lambda number: [*steps, *steady(1.0, 3), Never()]))
    receiver.start()
    take_until(receiver, 3)
    found = [(notice.level, notice.message) for notice in receiver.notices()]
    assert found == [
        ("error", "safety: level 0"),
        ("error", "safety: level 1"),
        ("warning", "safety: level 2"),
        ("info", "safety: level 3"),
    ]


@given(st.lists(st.binary(min_size=1, max_size=200), min_size=1, max_size=4))
@settings(max_examples=25)
def test_garbage_in_the_stream_never_hangs(chunks: list[bytes]) -> None:
    with simulated_time() as clock:
        server = ScriptedController(clock, lambda number: [*steady(1.0, 3), *chunks, Cut()])
        receiver = receiver_of(server, clock)
        receiver.connect()
        receiver.start()
        batches, _ = take_all(receiver)
        assert clocks(batches)[:3] == [1.0, 1.002, 1.004]
        receiver.close()
        server.close()


@given(st.lists(st.binary(min_size=1, max_size=100), min_size=1, max_size=3))
@settings(max_examples=25)
def test_garbage_in_place_of_answers_is_a_failed_connection(chunks: list[bytes]) -> None:
    # Beginning with a size that cannot be, so that no chunk is an answer by chance.
    with simulated_time() as clock:
        server = ScriptedController(clock, lambda number: [], greeting=struct.pack(">H", 1) + b"".join(chunks))
        with pytest.raises(ConnectionFailedError):
            receiver_of(server, clock, timeout=0.5).connect()
        server.close()


def test_closing_ends_the_thread_and_is_safe_twice(controller: Make, connect: Connect) -> None:
    receiver = connect(controller(broken([Never()])))
    receiver.start()
    assert sum(thread.name.startswith("rtde ") for thread in threading.enumerate()) == 1
    receiver.close()
    receiver.close()
    assert not any(thread.name.startswith("rtde ") for thread in threading.enumerate())
    with pytest.raises(ConnectionLostError, match="not connected"):
        receiver.take(0.1)


def test_a_receiving_thread_that_breaks_is_told(
    clock: SimulatedClock, controller: Make, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = connect(controller(lambda number: paced(500.0, start=10.0)))

    def broken() -> None:
        raise KeyError("a bug")

    monkeypatch.setattr(receiver, "_receive_until_pause", broken)
    receiver.start()
    clock.sleep(0.01)
    assert [str(one) for one in clock.breakdowns()] == [f"the thread 'rtde {receiver.where}' broke: KeyError: 'a bug'"]
