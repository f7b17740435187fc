"""Jacobians of points fixed to links: what a force on the arm's surface does at its joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.pinocchio_model import pinocchio_model


class LinkJacobians:
    """Jacobians at one position at a time; scratch inside, so one thread at a time.

    Args:
        model: the arm; loops and coupled motors too.
    """

    def __init__(self, model: DynamicModel) -> None:
        self._model = model
        self._arm: Any = pinocchio_model(model)
        self._data = self._arm.createData()
        self._follow: FloatArray = np.empty(0)

    def move(self, position: FloatArray) -> None:
        """Place the arm at a position (n,) of the joints with a motor [rad or m]."""
        import pinocchio as pin

        still = np.zeros((len(position), 1))
        motion = self._model.tree_motion(position[:, None], still, still)
        self._follow = motion.follow if motion.follow.ndim == 2 else motion.follow[..., 0]
        pin.computeJointJacobians(self._arm, self._data, np.ascontiguousarray(motion.position[:, 0]))

    def point(self, link: int, local: FloatArray) -> FloatArray:
        """Return where a point (3,) [m] of a link's frame is (3,) [m], in the base frame."""
        placement = self._data.oMi[link + 1]
        return np.asarray(placement.rotation @ local + placement.translation)

    def jacobian(self, link: int, local: FloatArray) -> FloatArray:
        """(6, n) velocity of a point (3,) [m] of a link by the joints': linear, then angular, in the base frame.

        Its transpose turns a force [N] and a moment [N·m] there into joint torques (n,) [N·m or N].
        """
        import pinocchio as pin

        tree = pin.getJointJacobian(self._arm, self._data, link + 1, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        x, y, z = self._data.oMi[link + 1].rotation @ local
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        tree = np.vstack([tree[:3] - across @ tree[3:], tree[3:]])
        return np.asarray(tree @ self._follow)


def link_index(model: DynamicModel, text: str) -> int:
    """The index of a link, by the name of the joint that moves it, or its number from 1.

    Raises:
        UsageError: there is no such link.
    """
    names = model.link_names
    if text in names:
        return names.index(text)
    if text.isdigit() and 1 <= int(text) <= len(names):
        return int(text) - 1
    raise UsageError(f"there is no link '{text}'", hint=f"links, by the joint that moves them: {', '.join(names)}")


def link_end(model: DynamicModel, link: int, tool: FloatArray) -> FloatArray:
    """The far end (3,) [m] of a link in its frame: the origin of the next joint, or the tool point of the last link."""
    after = [joint for joint in model.joints if joint.parent == link]
    return np.asarray(tool if link == model.tool_link or not after else after[0].translation)
