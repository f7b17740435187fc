"""Recorded columns become joint torques: gains, signs, order, and what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from each import each

from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import DataError
from drivers.streams import UNITS
from ident.signals.joint_signals import joint_positions, read_joint_signals

ROBOT = """
name: two
model:
  mdh:
    - {joint: a, alpha: 0, d: 0, r: 0}
    - {joint: b, antecedent: a, alpha: pi/2, d: 0, r: 0}
joints:
  - {name: a, position: [-3, 3], velocity: 3}
  - {name: b, position: [-3, 3], velocity: 3}
drives:
"""


def robot(*drives: str) -> RobotFile:
    lines = "".join(f"  - {drive}\n" for drive in drives)
    text = ROBOT + lines if drives else ROBOT.replace("drives:\n", "")
    return parse_robot(text, where="two", folder=None)


TORQUE = "{joint: %s, signal: torque}"
GAINS = ("{joint: a, gain: 10}", "{joint: b, gain: -4}")


def recording(columns: tuple[str, ...] = ("a", "b"), stream: str = JOINTS_STREAM, **quantities) -> Recording:
    time = np.arange(4) / 100
    channels = {
        name: Channel(name, np.asarray(values, dtype=float), UNITS[name], columns)
        for name, values in quantities.items()
    }
    return Recording(robot_text="", streams={stream: Stream(stream, time, time, channels)})


POSITION = np.arange(8.0).reshape(4, 2)
CURRENT = POSITION + 0.5


def test_torque_is_gain_times_current_sign_included():
    motion = read_joint_signals(recording(position=POSITION, current=CURRENT), robot(*GAINS).robot)
    assert np.array_equal(motion.torque, CURRENT * [10.0, -4.0])
    assert np.array_equal(motion.position, POSITION)
    assert "current" in motion.torque_origin
    assert motion.gains_used == ("a", "b")
    assert motion.velocity is None


def test_voltage_is_taken_where_the_drives_say_so():
    drives = ("{joint: a, gain: 10, signal: voltage}", "{joint: b, gain: -4, signal: voltage}")
    motion = read_joint_signals(recording(position=POSITION, voltage=CURRENT), robot(*drives).robot)
    assert np.array_equal(motion.torque, CURRENT * [10.0, -4.0])


def test_columns_go_by_name_whatever_their_order_and_company():
    swapped = recording(("gripper", "b", "a"), position=np.c_[np.full(4, 99.0), POSITION[:, ::-1]],
                        current=np.c_[np.full(4, np.nan), CURRENT[:, ::-1]],
                        velocity=np.c_[np.full(4, 99.0), POSITION[:, ::-1] + 1])  # fmt: skip
    motion = read_joint_signals(swapped, robot(*GAINS).robot)
    assert np.array_equal(motion.position, POSITION)
    assert np.array_equal(motion.torque, CURRENT * [10.0, -4.0])
    assert np.array_equal(motion.velocity, POSITION + 1)


def test_a_current_with_known_gains_goes_before_a_recorded_torque():
    both = recording(position=POSITION, current=CURRENT, torque=np.zeros((4, 2)))
    assert np.array_equal(read_joint_signals(both, robot(*GAINS).robot).torque, CURRENT * [10.0, -4.0])


def test_recorded_torque_is_used_where_no_gain_is_known():
    both = recording(position=POSITION, current=CURRENT, torque=CURRENT - 7)
    motion = read_joint_signals(both, robot().robot)
    assert np.array_equal(motion.torque, CURRENT - 7)
    assert motion.torque_origin == "torque as recorded"
    assert motion.gains_used == ()


def test_a_gain_on_a_torque_signal_scales_the_torque():
    drives = ("{joint: a, gain: -1, signal: torque}", "{joint: b, signal: torque}")
    motion = read_joint_signals(recording(position=POSITION, torque=CURRENT), robot(*drives).robot)
    assert np.array_equal(motion.torque, CURRENT * [-1.0, 1.0])
    assert motion.gains_used == ("a",)


def test_an_unknown_gain_is_named_with_what_to_write():
    with pytest.raises(DataError, match="gain of b is unknown") as caught:
        read_joint_signals(recording(position=POSITION, current=CURRENT), robot("{joint: a, gain: 10}").robot)
    assert "joint: b, gain" in caught.value.hint
    assert "--robot" in caught.value.hint


def test_recordings_without_what_is_needed_are_refused():
    arm = robot(*GAINS).robot
    with pytest.raises(DataError, match="no position"):
        read_joint_signals(recording(current=CURRENT), arm)
    with pytest.raises(DataError, match=r"neither torque nor current.*position, velocity"):
        read_joint_signals(recording(position=POSITION, velocity=POSITION), arm)
    with pytest.raises(DataError, match="records current alone, but the signal of the robot file's drives is torque"):
        read_joint_signals(
            recording(position=POSITION, current=CURRENT), robot(*(TORQUE % name for name in "ab")).robot
        )
    with pytest.raises(DataError, match="no stream 'joints'; streams: thermometer"):
        read_joint_signals(recording(stream="thermometer", position=POSITION), arm)
    with pytest.raises(DataError, match=r"no column for joint.*b") as caught:
        read_joint_signals(recording(("a", "other"), position=POSITION, current=CURRENT), arm)
    assert "--robot" in caught.value.hint


@each("quantity", ["position", "current", "velocity"])
@each("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_no_numbers_are_named_by_sample_and_joint(quantity, value):
    values = {"position": POSITION.copy(), "current": CURRENT.copy(), "velocity": POSITION.copy()}
    values[quantity][2, 1] = value
    with pytest.raises(DataError, match="first at sample 2") as caught:
        read_joint_signals(recording(**values), robot(*GAINS).robot)
    assert caught.value.where.endswith(f"{'torque' if quantity == 'current' else quantity} of b")


@pytest.mark.parametrize(("samples", "message"), [(0, "holds no samples"), (1, "its 1 samples"), (4, "its 4 samples")])
def test_recordings_that_last_no_time_are_refused(samples, message):
    run = recording(position=POSITION, current=CURRENT)
    joints = run.streams[JOINTS_STREAM]
    none = {name: replace(one, values=one.values[:samples]) for name, one in joints.channels.items()}
    short = replace(joints, time=np.ones(samples), host_time=np.ones(samples), channels=none)
    for read in (read_joint_signals, joint_positions):
        with pytest.raises(DataError, match=message):
            read(replace(run, streams={JOINTS_STREAM: short}), robot(*GAINS).robot)


def test_positions_alone_need_no_torque():
    positions = joint_positions(recording(position=POSITION), robot().robot)
    assert np.array_equal(positions.position, POSITION)
    assert np.array_equal(positions.time, np.arange(4) / 100)
