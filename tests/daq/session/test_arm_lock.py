"""One program at a time moves an arm; its death releases the lock."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from kinematic_arm import ROBOT_FILE

from daq.robot.loader import load_robot
from daq.robot.schema import Connection
from daq.session.arm_lock import only_mover
from drivers.core.errors import MotionRefusedError

ARM = load_robot("ur5e").robot
HOLD = """
import sys
from daq.robot.loader import load_robot
from daq.session.arm_lock import only_mover
with only_mover(load_robot("ur5e").robot, host=sys.argv[1]):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


def test_an_arm_that_another_program_moves_is_refused_until_that_is_dead():
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, "192.0.2.9"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    assert other.stdout.readline() == "held\n"
    with (
        pytest.raises(MotionRefusedError, match="another program on this computer is moving this arm"),
        _held("192.0.2.9"),
    ):
        pass
    with _held("192.0.2.8"):  # another arm
        pass
    other.kill()
    other.communicate()
    with _held("192.0.2.9"):
        pass


def test_a_lock_is_released_and_taken_again():
    for _ in range(2):
        with _held("192.0.2.7"):
            pass


def test_a_connection_without_a_place_has_no_lock(tmp_path):
    with only_mover(ROBOT_FILE.robot), only_mover(ROBOT_FILE.robot):
        pass
    assert list(tmp_path.iterdir()) == []


UR = {"driver": "rtde"}
SPELLINGS: list[list[dict[str, object]]] = [
    [
        UR | {"host": host, **port}
        for host in ("localhost", "LocalHost", "localhost.", " 127.0.0.1", "127.1", "0x7f000001", "0.0.0.0", "::1")
        + ("0:0::1", "::ffff:127.0.0.1", "::FFFF:7F00:1")
        for port in ({}, {"port": 30004}, {"port": None})
    ],
    [UR | {"host": "localhost", "port": 30014}, UR | {"port": 30014, "host": "127.0.0.1"}],
    [UR | {"host": host} for host in ("127.0.0.2", "127.2", "::ffff:127.0.0.2")],
    [UR | {"host": host} for host in ("192.0.2.9", "192.0.521", "0xC0000209", "::ffff:192.0.2.9")],
    [UR | {"host": host} for host in ("2001:db8::9", "2001:DB8:0:0::9")],
    [
        {"driver": driver, "interface": "socketcan", "channel": channel, "bitrate": bitrate}
        for driver in ("canopen402", "can_frames")
        for channel in ("can0", "can0 ")
        for bitrate in (500_000, 1_000_000)
    ],
    [{"driver": "can_frames", "interface": "socketcan", "channel": "can1"}],
    [{"driver": "can_frames", "interface": "kvaser", "channel": channel} for channel in (0, "0")],
    [
        {"driver": "can_frames", "interface": "slcan", "channel": channel}
        for channel in ("/dev/null", "/dev/../dev/null", "//dev/null", "/dev/null@115200", "/proc/self/cwd/null")
    ],
    [
        {"driver": "can_frames", "interface": "udp_multicast", "channel": channel}
        for channel in ("ff15:7079::6d63", "FF15:7079:0::6D63")
    ],
]
"""Each list is one arm."""
SPELLED = st.sampled_from([(arm, keys) for arm, spelled in enumerate(SPELLINGS) for keys in spelled])


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(SPELLED, SPELLED)
@example((0, SPELLINGS[0][0]), (0, SPELLINGS[0][1]))  # the usual port, left out
@example((0, SPELLINGS[0][0]), (0, SPELLINGS[0][-1]))  # localhost has two addresses
@example((5, SPELLINGS[5][0]), (5, SPELLINGS[5][-1]))  # one bus, two drivers
def test_of_two_recorders_on_one_arm_the_second_is_refused_however_it_is_spelled(monkeypatch, first, second):
    monkeypatch.chdir("/dev")
    with _only_mover(first[1]):
        if first[0] == second[0]:
            with pytest.raises(MotionRefusedError, match="another program"), _only_mover(second[1]):
                pass
        else:
            with _only_mover(second[1]):
                pass
    with _only_mover(second[1]):
        pass


def _only_mover(keys: dict[str, object]):
    return only_mover(ARM.model_copy(update={"connections": {"arm": Connection.model_validate(keys)}}))


def _held(host: str):
    return only_mover(ARM, host=host)
