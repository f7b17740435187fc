"""What a user writes who has Pinocchio and NumPy: the regressor sample by sample, then least squares."""

from __future__ import annotations

import numpy as np

from drivers.core.arrays import FloatArray
from ident.benchmark.entry import TorquePredictor, Training
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model

EVERY = 4.0
"""Rows that are kept per period of the band: more are filtered copies."""


def standard_regressor(arm: object, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Pinocchio's columns, then motor inertia, viscous and Coulomb friction and offset of each joint (N, n, p)."""
    import pinocchio as pin

    working, (count, joints) = arm.createData(), q.shape  # type: ignore[attr-defined]
    matrix = np.zeros((count, joints, 14 * joints))
    for row in range(count):
        matrix[row, :, : 10 * joints] = pin.computeJointTorqueRegressor(arm, working, q[row], dq[row], ddq[row])
    for joint in range(joints):
        own = (ddq[:, joint], dq[:, joint], np.sign(dq[:, joint]), np.ones(count))
        for place, column in enumerate(own):
            matrix[:, joint, 10 * joints + 4 * joint + place] = column
    return matrix


def pinocchio_lstsq(training: Training) -> TorquePredictor:
    """Ordinary least squares of minimal norm over all standard parameters."""
    arm = pinocchio_model(build_model(training.robot))
    matrices, torques = [], []
    for motion in training.motions:
        matrix = standard_regressor(arm, motion.q, motion.dq, motion.ddq)
        every = slice(motion.inner.start, motion.inner.stop, max(1, int(motion.rate / (EVERY * motion.band))))
        matrices.append(motion.in_band(matrix)[every].reshape(-1, matrix.shape[2]))
        torques.append(motion.in_band(motion.torque)[every].ravel())
    values = np.linalg.lstsq(np.concatenate(matrices), np.concatenate(torques), rcond=1e-9)[0]

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        return np.asarray(standard_regressor(arm, q, dq, ddq) @ values, dtype=np.float64)

    return TorquePredictor(torque)
