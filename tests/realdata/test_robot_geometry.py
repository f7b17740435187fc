"""The built-in UR10 and Panda against the URDFs that come with their public recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daq.robot.loader import load_robot
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.true_parameters import truth_vector

pytestmark = pytest.mark.realdata

# Our base frame in the URDF's root: UR's "base" is ROS's base_link turned by π about z, the Panda's is the same.
BASE_TURN = {"ur10": np.pi, "panda": 0.0}


def poses(count: int, dof: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-np.pi, np.pi, (count, dof))


def urdf_arm(data_dir: Path, name: str) -> Any:
    pin = pytest.importorskip("pinocchio")
    return pin.buildModelFromUrdf(str(data_dir / f"{name}.urdf"))


def urdf_axis(arm: Any, number: int) -> np.ndarray:
    """Axis of a joint in its own frame."""
    return np.asarray(arm.joints[number].createData().S).reshape(6)[3:]


@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_joint_axes_and_links_are_in_the_same_place_at_every_pose(data_dir: Path, name: str) -> None:
    """Axes have the same direction, sign included, and are the same lines; a link's frames differ by one transform."""
    import pinocchio as pin

    theirs = urdf_arm(data_dir, name)
    ours = pinocchio_model(build_model(load_robot(name)))
    assert ours.nq == theirs.nq
    base = pin.SE3(pin.utils.rotate("z", BASE_TURN[name]), np.zeros(3))
    our_data, their_data = ours.createData(), theirs.createData()
    fixed: dict[int, Any] = {}
    for position in poses(20, ours.nq):
        pin.forwardKinematics(ours, our_data, position)
        pin.forwardKinematics(theirs, their_data, position)
        for number in range(1, ours.nq + 1):
            our_frame, their_frame = base * our_data.oMi[number], their_data.oMi[number]
            their_axis = their_frame.rotation @ urdf_axis(theirs, number)
            np.testing.assert_allclose(our_frame.rotation[:, 2], their_axis, atol=1e-9)
            between = our_frame.translation - their_frame.translation
            np.testing.assert_allclose(np.cross(their_axis, between), 0, atol=1e-9)
            apart = our_frame.actInv(their_frame)
            np.testing.assert_allclose(apart.homogeneous, fixed.setdefault(number, apart).homogeneous, atol=1e-9)


@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_gravity_pulls_the_same_way(data_dir: Path, name: str) -> None:
    """Our links' masses, hung into the URDF's joints, need the same torque to be held."""
    import pinocchio as pin

    robot_file = load_robot(name)
    model = build_model(robot_file)
    ours = pinocchio_model(model, truth_vector(robot_file)[: 10 * model.dof])
    theirs = urdf_arm(data_dir, name)
    base = pin.SE3(pin.utils.rotate("z", BASE_TURN[name]), np.zeros(3))
    our_data, their_data = ours.createData(), theirs.createData()
    zero = np.zeros(ours.nq)
    pin.forwardKinematics(ours, our_data, zero)
    pin.forwardKinematics(theirs, their_data, zero)
    for number in range(1, ours.nq + 1):
        between = their_data.oMi[number].actInv(base * our_data.oMi[number])
        theirs.inertias[number] = between.act(ours.inertias[number])
    their_data = theirs.createData()
    for position in poses(20, ours.nq):
        expected = pin.computeGeneralizedGravity(theirs, their_data, position)
        np.testing.assert_allclose(pin.computeGeneralizedGravity(ours, our_data, position), expected, atol=1e-7)
