"""One program at a time moves an arm; its death releases the lock."""

from __future__ import annotations

import subprocess
import sys

import pytest
from kinematic_arm import ROBOT_FILE

from daq.robot.loader import load_robot
from daq.session.arm_lock import only_mover
from drivers.errors import MotionRefusedError

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
    with pytest.raises(MotionRefusedError, match="another program on this computer moves this arm"), _held("192.0.2.9"):
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


def _held(host: str):
    return only_mover(ARM, host=host)
