"""figaroh's regressor, base parameters by its double QR, and its least squares (figaroh 1.0, Nguyen 2023)."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.benchmark.entries.plain_regression import EVERY
from ident.benchmark.entry import TorquePredictor, Training
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model

EFFECT = 0.001
"""Sum of squares from which a column counts, figaroh's own default."""


def figaroh_base(training: Training) -> TorquePredictor:
    """Base parameters with viscous and Coulomb friction, offsets and motor inertia.

    Raises:
        UsageError: figaroh is not installed.
    """
    try:
        from figaroh.tools.qrdecomposition import QRDecomposer
        from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate
    except ImportError as error:
        raise UsageError("figaroh is not installed", hint="pip install 'dynid[bench]'") from error
    arm = pinocchio_model(build_model(training.robot))
    robot, joints = SimpleNamespace(model=arm, data=arm.createData()), arm.nv
    choices = {
        "has_friction": True,
        "has_joint_offset": True,
        "has_actuator_inertia": True,
        "act_idxv": list(range(joints)),
    }

    def regressor(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """All rows of the first joint first, as (n, N, p)."""
        return np.asarray(build_regressor_basic(robot, q, dq, ddq, choices)).reshape(joints, len(q), -1)

    matrices, torques = [], []
    for motion in training.motions:
        every = slice(motion.inner.start, motion.inner.stop, max(1, int(motion.rate / (EVERY * motion.band))))
        matrix = motion.in_band(regressor(motion.q, motion.dq, motion.ddq).transpose(1, 0, 2))
        matrices.append(matrix[every].transpose(1, 0, 2))
        torques.append(motion.in_band(motion.torque)[every])
    stacked = np.concatenate(matrices, axis=1)
    columns = stacked.shape[2]
    full = stacked.reshape(-1, columns)
    names = {f"p{number:03d}": 0.0 for number in range(columns)}
    eliminated, kept = get_index_eliminate(full, names, tol_e=EFFECT)
    remaining = [number for number in range(columns) if number not in set(eliminated)]
    decomposer = QRDecomposer()
    reduced = build_regressor_reduced(full, eliminated)
    values = decomposer.double_decomposition(np.concatenate(torques).T.ravel(), reduced, kept)[3]
    chosen = [remaining[index] for index in decomposer.get_base_indices() or ()]

    def torque(q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        return np.asarray(regressor(q, dq, ddq)[:, :, chosen] @ values, dtype=np.float64).T

    return TorquePredictor(torque)
