"""Forward kinematics of a path, and how points move with the joints, against Pinocchio."""

from __future__ import annotations

import numpy as np
from each import each

from ident.excite.constraints.placements import moved_by, place, wrench
from ident.model.dynamics.pinocchio_model import pinocchio_model


@each("seed", range(8))
def test_frames_and_jacobians_are_pinocchios(random_tree, seed):
    import pinocchio as pin

    model = random_tree(seed, dof=1 + seed % 7)
    position = np.random.default_rng(seed).uniform(-3, 3, (model.dof, 4))
    placements = place(model.joints, position)
    arm = pinocchio_model(model)
    data = arm.createData()
    moves = moved_by(model.joints)
    local = np.random.default_rng(seed).uniform(-1, 1, (model.dof, 3))
    points = placements.points(np.arange(model.dof), local)
    force = np.random.default_rng(1).standard_normal((model.dof, 3, 1)) * np.ones(4)
    by_joint = np.einsum("jat,kat->kjt", placements.screw, wrench(points, force)) * moves[:-1, :, None]
    for sample in range(4):
        pin.computeJointJacobians(arm, data, position[:, sample])
        for link in range(model.dof):
            frame = data.oMi[link + 1]
            assert np.allclose(placements.rotation[link, :, :, sample], frame.rotation, atol=1e-12)
            assert np.allclose(placements.origin[link, :, sample], frame.translation, atol=1e-12)
            jacobian = pin.getJointJacobian(arm, data, link + 1, pin.LOCAL_WORLD_ALIGNED)
            arm_of_point = points[link, :, sample] - frame.translation
            of_point = jacobian[:3] + np.cross(jacobian[3:], arm_of_point, axis=0)
            assert np.allclose(by_joint[link, :, sample], force[link, :, sample] @ of_point, atol=1e-11)


def test_the_last_entry_is_the_base(random_tree):
    model = random_tree(0, dof=3)
    placements = place(model.joints, np.ones((3, 2)))
    point = placements.points(np.array([-1]), np.array([[1.0, 2.0, 3.0]]))
    assert np.array_equal(point, np.array([[[1.0] * 2, [2.0] * 2, [3.0] * 2]]))
    assert not moved_by(model.joints)[-1].any()
