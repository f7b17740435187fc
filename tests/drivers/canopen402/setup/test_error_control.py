"""Drives that watch dynid and are watched by it: what is written into them, what goes over the bus, what is told."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from canopen_bench import RATE, READ, Bench, bench
from scripted_drives import FRAME_TIME, ScriptedDrive

from drivers.base import Attributing
from drivers.can.receiver import POLL
from drivers.canopen402.setup.error_control import RELEASE_LIMIT
from drivers.core.errors import ConnectionFailedError, ConnectionLostError

NO_OBJECT, VALUE_RANGE, READ_ONLY = 0x06020000, 0x06090030, 0x06010002
GUARDING: dict[str, object] = {"period": 0.05, "factor": 3}


def drives(**aborts: int) -> list[ScriptedDrive]:
    """Three drives; the second refuses objects, given as x1016_0=abort code."""
    refused = {(int(name[1:].split("_")[0], 16), int(name.split("_")[1])): code for name, code in aborts.items()}
    return [ScriptedDrive(1), ScriptedDrive(2, aborts=refused), ScriptedDrive(3)]


def beats(one: Bench, own_id: int = 127) -> list[float]:
    """When heartbeats of dynid were seen [s]."""
    seen = zip(one.bus.times, one.bus.seen, strict=True)
    found = [(time, data) for time, (identifier, data) in seen if identifier == 0x700 + own_id]
    assert {data for _, data in found} <= {b"\x05"}
    return [time for time, _ in found]


def test_drives_that_move_watch_dynids_heartbeat_and_quick_stop_without_it() -> None:
    with bench(begin="open", heartbeat=0.05) as one:
        for drive in one.drives:
            assert drive.number(0x1016, 1) == 127 << 16 | 150
            assert drive.number(0x1016, 2) == 0
            assert drive.number(0x6007) == 3
            assert drive.number(0x1017) == 50
        one.clock.sleep(0.975)  # nobody reads or commands
        assert one.said("warning") == []
        np.testing.assert_allclose(np.array(beats(one)) - one.begun, 0.05 * np.arange(20), atol=1e-9)
        one.driver.close()
        # The drives do not take dynid's leaving for a loss.
        assert [drive.number(0x1016, 1) for drive in one.drives] == [0, 0, 0]
        one.clock.sleep(0.2)
        assert len(beats(one)) == 20


def test_a_stall_makes_no_burst_of_heartbeats() -> None:
    with bench(begin="open", heartbeat=0.05) as one:
        one.clock.sleep(0.125)
        one.clock.stall(0.32)  # six are due in it
        one.clock.sleep(0.08)
        expected = [0.0, 0.05, 0.1, 0.445, 0.445, 0.495]
        np.testing.assert_allclose(np.array(beats(one)) - one.begun, expected, atol=1e-9)


def test_where_nothing_moves_nothing_is_written_and_nothing_sent() -> None:
    with bench(mode="none", heartbeat=0.05) as one:
        one.read_rows(20)
        assert [drive.number(0x1016, 1) for drive in one.drives] == [0, 0, 0]
        assert [drive.number(0x6007) for drive in one.drives] == [1, 1, 1]
        assert beats(one) == []
        assert one.said("warning") == []


def test_an_entry_that_is_dynids_already_or_free_is_taken_and_no_other() -> None:
    changed = drives()
    changed[0].objects[0x1016, 1] = 5 << 16 | 700  # watches another node
    changed[1].objects |= {(0x1016, 1): 5 << 16 | 700, (0x1016, 2): 100 << 16 | 9}  # from a session that was killed
    changed[2].objects |= {(0x1016, 1): 5 << 16 | 700, (0x1016, 2): 6 << 16 | 700}
    with bench(changed, begin="open", own_id=100) as one:
        assert [drive.number(0x1016, 1) for drive in one.drives] == [5 << 16 | 700] * 3
        assert [drive.number(0x1016, 2) for drive in one.drives] == [100 << 16 | 300] * 2 + [6 << 16 | 700]
        one.clock.sleep(0.45)
        assert len(beats(one, 100)) == 5
        assert beats(one, 127) == []
        (told,) = one.said("warning")
        assert told.startswith("elbow (node 3): no consumer heartbeat time (0x1016), or none free")


@pytest.mark.parametrize(
    ("refused", "words"),
    [
        ({"x1016_0": NO_OBJECT, "x6007_0": NO_OBJECT}, "lift (node 2): no consumer heartbeat time (0x1016), or none"),
        ({"x1016_1": READ_ONLY, "x1016_2": READ_ONLY}, "such a drive cannot notice that dynid or the bus is gone"),
        ({"x6007_0": NO_OBJECT}, "lift (node 2): 0x6007 (abort connection option) does not exist; what such a drive"),
        ({"x1017_0": NO_OBJECT}, "'guarding' instead of 'heartbeat' polls such drives"),
    ],
)
def test_what_a_drive_lacks_is_told_once(refused: dict[str, int], words: str) -> None:
    with bench(drives(**refused), begin="open") as one:
        (told,) = one.said("warning")
        assert words in told
        assert "lift (node 2)" in told
        assert "pan" not in told


@pytest.mark.parametrize(("kept", "warned"), [(0, True), (1, False), (2, False), (-1, True)])
def test_an_abort_option_that_cannot_be_changed(kept: int, warned: bool) -> None:
    class Stubborn(ScriptedDrive):
        def answer(self, request: bytes, now: float) -> bytes | None:
            if request[1:3] == b"\x07\x60" and request[0] != 0x40:
                return b"\x80" + request[1:4] + VALUE_RANGE.to_bytes(4, "little")
            return super().answer(request, now)

    changed = [ScriptedDrive(1), Stubborn(2, objects={(0x6007, 0): kept}), ScriptedDrive(3)]
    with bench(changed, begin="open") as one:
        told = one.said("warning")
        assert [f"0x6007 (abort connection option) stays {kept}" in text for text in told] == [True] * warned


def test_another_device_with_dynids_id_is_found() -> None:
    with bench([ScriptedDrive(node) for node in (1, 2, 3, 127)], begin="closed") as one:
        with pytest.raises(ConnectionFailedError, match="has node id 127, under which dynid would send") as caught:
            one.driver.open()
        assert "own_id" in caught.value.hint
    with bench([ScriptedDrive(node) for node in (1, 2, 3, 127)], own_id=126) as one:
        one.read_rows(2)


@contextmanager
def guarded(changed: list[ScriptedDrive] | None = None, **keys: object) -> Iterator[Bench]:
    with bench(changed or drives(), guarding=GUARDING, **keys) as one:  # type: ignore[arg-type]
        yield one


def test_guarding_asks_every_drive_and_is_watched_in_turn() -> None:
    with guarded() as one:
        for drive in one.drives:
            assert [drive.number(index) for index in (0x1017, 0x100C, 0x100D, 0x6007)] == [0, 50, 3, 3]
            assert drive.number(0x1016, 1) == 0
        one.read_rows(60)
        assert beats(one) == []
        for node in (1, 2, 3):
            moments = np.array([moment for moment, whom in one.bus.requests if whom == node])
            expected = 0.05 * (np.arange(len(moments)) + (node - 1) / 3)
            np.testing.assert_allclose(moments - one.begun, expected, atol=8 * FRAME_TIME)
            assert len(moments) == math.ceil((one.clock.now() - one.begun) / 0.05 - (node - 1) / 3)
        assert one.said("warning") == one.said("error") == []
        one.driver.close()
        assert [drive.number(0x100D) for drive in one.drives] == [0, 0, 0]


def test_a_drive_that_answers_no_guarding_is_a_lost_one() -> None:
    with guarded() as one:
        one.read_rows(20)
        one.drives[1].beats = False
        first = one.begun + 0.05 / 3 + 0.05 * math.ceil((one.clock.now() - one.begun) / 0.05 - 1 / 3)
        one.read(lambda: one.said("error"))
        # Three requests and the time of an answer; seen with the next frame that comes.
        assert 0.0 <= one.clock.now() - first - 3 * 0.05 < READ + 1 / RATE
        assert one.said("error") == ["lift (node 2): no answer to 3 requests of node guarding; is its power on?"]
        one.drives[1].beats = True
        one.read(lambda: "lift: it answers node guarding again" in one.said("info"))


def test_a_toggle_bit_that_stays_is_an_error() -> None:
    with guarded() as one:
        one.read_rows(5)
        one.drives[2].alternates = False
        one.read(lambda: one.said("error"))
        assert "elbow (node 3)" in one.said("error")[0]
        assert "without a toggle bit that alternates" in one.said("error")[0]


def test_an_answer_says_that_a_drive_is_no_longer_operational() -> None:
    with guarded() as one:
        one.read_rows(30)
        one.drives[0].nmt = 0x04
        with pytest.raises(ConnectionLostError):
            one.read(lambda: False)
        assert "pan: the drive is no longer operational, but stopped" in one.said("error")


def test_guarding_without_a_motion_lets_no_drive_watch() -> None:
    left = drives()
    left[0].objects[0x100D, 0] = 7  # of an earlier session
    with guarded(left, mode="none") as one:
        one.read_rows(20)
        assert [drive.number(0x100D) for drive in one.drives] == [0, 0, 0]
        assert one.bus.requests
        assert one.said("error") == []


def test_a_drive_without_life_guarding_cannot_notice() -> None:
    with guarded(drives(x100D_0=NO_OBJECT)) as one:
        (told,) = one.said("warning")
        assert told.startswith("lift (node 2): no life guarding (0x100C, 0x100D)")


def test_a_drive_that_missed_dynid_ends_the_session_where_it_was_to_watch() -> None:
    missed = bytes.fromhex("30 81 11 00 00 00 00 00")
    with bench() as one:
        one.read_rows(2)
        one.bus.send(0x82, missed)
        one.read(lambda: one.said("error"))
        (said,) = one.said("error")
        assert said.startswith(
            "lift: heartbeat or life guarding missed (EMCY 0x8130, register: generic, communication)"
        )
        assert "it stopped receiving from dynid" in said
    with bench(mode="none") as one:  # it missed somebody else
        one.read_rows(2)
        one.bus.send(0x82, missed)
        one.read(lambda: one.said("warning"))
        assert one.said("error") == []


def test_a_silent_drive_has_a_name() -> None:
    with bench() as one:
        assert isinstance(one.driver, Attributing)
        one.read_rows(10)
        assert one.driver.silence("joints", 0.05) == ""
        one.drives[1].present = False
        end = one.clock.now() + 0.115
        while one.clock.now() < end:
            one.driver.read(0.01)
        assert one.driver.silence("joints", 0.05) == "no answer to SYNC of lift (node 2) for 0.11 s"
        assert one.driver.silence("thermal", 0.05) == ""
        for drive in one.drives:
            drive.present = False
        one.clock.sleep(0.15)
        assert one.driver.silence("joints", 0.05).startswith("no answer to SYNC of any drive for 0.")
        one.clock.stall(0.1)
        assert one.driver.silence("joints", 0.05).startswith("no SYNC sent for 0.1")  # nor was anything read
        one.driver._sync.stop()
        one.clock.sleep(0.1)
        assert one.driver.silence("joints", 0.05).startswith("no SYNC sent for 0.2")
        one.driver.stop()
        assert one.driver.silence("joints", 0.05) == ""


def test_leaving_takes_no_time_where_nobody_answers() -> None:
    with bench(begin="open") as one:
        for drive in one.drives:
            drive.present = False
        begun = one.clock.now()
        one.driver.close()
        assert RELEASE_LIMIT <= one.clock.now() - begun < RELEASE_LIMIT + 1e-3 + POLL
