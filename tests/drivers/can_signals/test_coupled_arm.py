"""A coupled arm on a table of CAN signals: what is recorded and judged as torque is the joints', not the motors'."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_clock import SimulatedClock
from table_arm_bench import JOINTS, RATE, ROBOT_FILE, connection_of, noted_by, opened, read_for, served

from daq.robot.loader import parse_robot
from daq.session.connections import driver_settings
from daq.session.supervisor import Limits, Supervisor
from drivers.streams import Batch

# The motor of the fore arm sits in the base: it turns with the upper arm, too, and bears gravity for both joints.
COUPLED_FILE = parse_robot(
    ROBOT_FILE.text.replace(
        "\nmodel:\n", "\nmodel:\n  coupling: {foreArm_joint: {foreArm_joint: 1, upperArm_joint: 1}}\n"
    ),
    where="coupled aubo_i5",
    folder=None,
)
COUPLED = COUPLED_FILE.robot
UPPER = JOINTS.index("upperArm_joint")


@pytest.fixture
def batches_and_truth(clock: SimulatedClock) -> tuple[list[Batch], np.ndarray, tuple[str, ...]]:
    """What the driver hands over in half a second, the plant's joint torque, and what the recording calls it."""
    with served(clock, COUPLED_FILE) as server, opened(connection_of(server), clock, COUPLED) as driver:
        (layout,) = [one for one in driver.streams() if one.name == "joints"]
        driver.start()
        batches = read_for(driver, clock, 0.5)
        cycles = np.rint(np.concatenate([batch.time for batch in batches]) * RATE).astype(int)
        said = tuple(one.description for one in layout.channels if one.quantity == "torque")
        return batches, noted_by(server, "torque", cycles), said


def test_the_recorded_torque_is_the_joints(batches_and_truth: tuple[list[Batch], np.ndarray, tuple[str, ...]]) -> None:
    batches, truth, said = batches_and_truth
    torque = np.concatenate([batch.values["torque"] for batch in batches])
    current = np.concatenate([batch.values["current"] for batch in batches])
    # Half a count of 1 mA of every motor that moves the joint.
    settings = driver_settings(COUPLED, {})
    gain = np.array([one.gain for one in settings.gains])
    assert settings.coupling is not None
    assert np.all(np.abs(torque - truth) <= (0.5e-3 + 1e-9) * np.abs(gain) @ np.abs(settings.coupling))
    assert np.min(np.abs(torque - current * gain)[:, UPPER]) > 1.0  # the motor's own is another
    assert "coupled motors" in said[0]


def test_the_supervisor_judges_joint_torques(
    batches_and_truth: tuple[list[Batch], np.ndarray, tuple[str, ...]],
) -> None:
    batches, truth, _ = batches_and_truth
    limits = Limits.of_robot(COUPLED)
    without_torque = replace(batches[0], values={"current": batches[0].values["current"]})
    at_joint = float(np.max(np.abs(truth[:, UPPER])))
    at_motor = float(np.max(np.abs(batches[0].values["current"][:, UPPER]))) * limits.torque_per_current[UPPER]
    bound = limits.torque.copy()
    bound[UPPER] = (at_joint + at_motor) / 2.0  # which one passes tells which is judged
    supervisor = Supervisor(replace(limits, torque=bound), ())
    for batch in (batches[0], without_torque):
        breach = supervisor.check(batch, 0.0)
        assert (breach is not None) == (at_joint > at_motor)
        assert breach is None or (breach.what, breach.joint) == ("torque", JOINTS[UPPER])


def test_a_joint_is_not_judged_by_half_of_its_motors() -> None:
    limits = Limits.of_robot(COUPLED)
    current = np.ones((3, 2))
    torque, joints = limits.torque_of_current(current, np.array([UPPER, 0]))
    assert joints.tolist() == [0]
    assert np.array_equal(torque, np.full((3, 1), limits.torque_per_current[0]))
