"""An arm with general closed loops: positions by Newton's method, G and its derivatives from the closing equations.

Known positions, spread over the joint limits, are where Newton's method starts: the nearest one's G predicts, a few
steps correct. What that does not reach is followed from there in short steps (module `loop_equations`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.model.kinematics.linkages.loop_equations import Closing, LoopEquations
from ident.model.kinematics.transmission import Transmission, TreeMotion


@dataclass(frozen=True)
class ClosedPose:
    """N closed tree positions."""

    tree: FloatArray  # (n, N) [rad or m]
    closing: Closing  # the equations there
    follow: FloatArray  # (n, a, N) G


@dataclass(frozen=True)
class ClosedLoops(Transmission):
    """Joints that follow by closing equations."""

    solved_numerically = True
    names: tuple[str, ...]  # of the tree's joints, for messages
    equations: LoopEquations  # their closing equations
    start: FloatArray  # (n,) tree position that closes, on the branch that is meant [rad or m]
    known: FloatArray  # (n, K) further ones, spread over the joint limits
    constant: FloatArray  # (n, a) the entries of G that are the same at all known positions, zeros elsewhere
    varies: np.ndarray  # (n, a) where they are not

    @property
    def joint_count(self) -> int:
        """Implement `Transmission`."""
        return len(self.start)

    def tree_position(self, position: FloatArray) -> FloatArray:
        """Positions of the tree's joints, as in `Transmission`.

        Raises:
            DataError: a loop does not close there.
        """
        return self._solved(position.reshape(len(self.active), -1)).reshape(-1, *position.shape[1:])

    def tree_velocity(self, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Implement `Transmission`."""
        tree = self._solved(position)
        return tree, _applied(self._follow(self.equations.at(tree)), velocity)

    def tree_motion(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> TreeMotion:
        """Implement `Transmission`."""
        return self.motion_at(self.pose(position), velocity, acceleration)

    def pose(self, position: FloatArray, last: ClosedPose | None = None) -> ClosedPose:
        """The closed tree for active positions (a, N) [rad or m]; a pose shortly before saves looking for a start.

        Raises:
            DataError: a loop does not close there.
        """
        if last is None:
            return self._posed(self._solved(position))
        passive = list(self.equations.passive)
        moved = _applied(last.follow, position - last.tree[list(self.active)])[passive]
        tree, closes = self.equations.newton(position, last.tree[passive] + moved)
        return self._posed(tree if np.all(closes) else self._solved(position))

    def motion_at(self, pose: ClosedPose, velocity: FloatArray, acceleration: FloatArray) -> TreeMotion:
        """The tree's motion in a pose for velocities and accelerations (a, N) of the active joints."""
        rate = _applied(pose.follow, velocity)
        change = np.einsum("pnN,nN->pN", pose.closing.second(rate), rate)
        accelerated = _applied(pose.follow, acceleration)
        accelerated[list(self.equations.passive)] -= pose.closing.solved(change[:, None])[:, 0]
        return TreeMotion(pose.tree, rate, accelerated, pose.follow)

    def active_gradient(self, position: FloatArray, gradient: FloatArray) -> FloatArray:
        """Implement `Transmission`."""
        follow = self._follow(self.equations.at(self._solved(position)))
        return np.asarray(np.einsum("nat,...nt->...at", follow, gradient))

    def pull_back(
        self,
        velocity: FloatArray,
        acceleration: FloatArray,
        motion: TreeMotion,
        gradient: FloatArray,
        share: FloatArray,
    ) -> FloatArray:
        """Implement `Transmission`."""
        # q_tree = f(q): f′ = G, f″ = Γ, f‴ along q̇ twice = T, each by differentiating Φ(f(q)) = 0 once more.
        closing, follow, rate = self.equations.at(motion.position), motion.follow, motion.velocity
        columns = range(len(self.active))
        curved = np.stack([self._bent(closing, closing.second(follow[:, i]), follow) for i in columns], axis=2)
        along = np.einsum("nabN,bN->naN", curved, velocity)  # Γ (n, a, a, N) and Γ·q̇, which is Ġ
        changes = closing.third(rate) + closing.second(_applied(along, velocity))
        right = np.einsum("pnN,naN->paN", changes, follow)
        right += 2.0 * np.einsum("pnN,naN->paN", closing.second(rate), along)
        third = self._spread(-closing.solved(right))
        by_position, by_velocity, by_acceleration = gradient
        pulled = np.empty((3, *velocity.shape))
        pulled[0] = np.einsum("naN,nN->aN", follow, by_position)
        pulled[0] += np.einsum("naN,nN->aN", along, by_velocity)
        bent = np.einsum("nabN,bN->naN", curved, acceleration) + third
        pulled[0] += np.einsum("naN,nN->aN", bent, by_acceleration)
        by_follow = np.einsum("ma,mnN->naN", self.joint_to_motor, share)
        pulled[0] += np.einsum("nabN,naN->bN", curved, by_follow)
        pulled[1] = np.einsum("naN,nN->aN", follow, by_velocity)
        pulled[1] += 2.0 * np.einsum("naN,nN->aN", along, by_acceleration)
        pulled[2] = np.einsum("naN,nN->aN", follow, by_acceleration)
        return pulled

    def share_pattern(self) -> tuple[FloatArray, np.ndarray]:
        """Implement `Transmission`."""
        mixing = self.joint_to_motor
        varies = (np.abs(mixing) > 0.0).astype(float) @ self.varies.T.astype(float) > 0.0
        return np.where(varies, 0.0, mixing @ self.constant.T), varies

    def content(self) -> tuple[object, ...]:
        """Implement `Transmission`."""
        equations = self.equations
        loops = [
            (chain.spherical, chain.before[0].tolist(), chain.before[1].tolist())
            + tuple(
                (link.joint, link.sign, link.prismatic, link.axis.tolist(), [array.tolist() for array in link.after])
                for link in chain.links
            )
            for chain in equations.chains
        ]
        linear = equations.linear.tolist(), equations.right.tolist()
        return (self.active, self.start.tolist(), loops, *linear, *self._motor_content())

    def _posed(self, tree: FloatArray) -> ClosedPose:
        closing = self.equations.at(tree)
        return ClosedPose(tree, closing, self._follow(closing))

    def _solved(self, position: FloatArray) -> FloatArray:
        """Tree positions (n, N) for active ones (a, N)."""
        if not np.all(np.isfinite(position)):
            raise ValueError("positions must be finite")
        passive = list(self.equations.passive)
        index = self._nearest(position)
        away = position - self.known[list(self.active)][:, index]
        guess = self.known[passive][:, index] + np.einsum("paN,aN->pN", self._known_follow[:, :, index], away)
        tree, closes = self.equations.newton(position, guess)
        missed = np.flatnonzero(~closes)
        if missed.size:
            followed = self.equations.followed(self.known[:, index[missed]], position[:, missed])
            short = np.flatnonzero(followed.reached < 1.0)
            if short.size:
                raise self._open(position[:, missed[short[0]]])
            tree[:, missed] = followed.tree
        return tree

    def _nearest(self, position: FloatArray) -> np.ndarray:
        """Number (N,) of the nearest known position, by the active joints that move a loop."""
        if not self._moving:
            return np.zeros(position.shape[1], dtype=np.intp)
        return np.asarray(self._tree_of_known.query(position[list(self._moving)].T)[1])

    def _open(self, position: FloatArray) -> DataError:
        moving = [(self.names[self.active[index]], position[index]) for index in self._moving]
        return DataError(
            f"the loop of {', '.join(self.names[index] for index in self.equations.passive)} does not close at "
            + ", ".join(f"{name} = {value:.6g}" for name, value in moving),
            hint="check that the position is within the arm's limits and that the robot file has the arm's lengths",
        )

    @cached_property
    def _moving(self) -> tuple[int, ...]:
        """The active joints that a loop or an equation depends on, by their place among the active ones."""
        within = {joint for chain in self.equations.chains for joint in chain.joints}
        within |= {int(joint) for joint in np.flatnonzero(self.equations.linear.any(axis=0))}
        return tuple(index for index, joint in enumerate(self.active) if joint in within)

    @cached_property
    def _tree_of_known(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.known[list(self.active)][list(self._moving)].T)

    @cached_property
    def _known_follow(self) -> FloatArray:
        return self.equations.at(self.known).follow()

    def _follow(self, closing: Closing) -> FloatArray:
        """G (n, a, N)."""
        follow = self._spread(closing.follow())
        follow[list(self.active), range(len(self.active))] = 1.0
        return follow

    def _bent(self, closing: Closing, rows: FloatArray, follow: FloatArray) -> FloatArray:
        """−J_p⁻¹·rows·G (n, a, N), zero for the active joints; rows (p, n, N)."""
        return self._spread(-closing.solved(np.einsum("pnN,naN->paN", rows, follow)))

    def _spread(self, of_passive: FloatArray) -> FloatArray:
        """(n, a, N) from the passive joints' rows (p, a, N), zeros elsewhere."""
        total = np.zeros((len(self.start), *of_passive.shape[1:]))
        total[list(self.equations.passive)] = of_passive
        return total


def _applied(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """(n, N) of matrices (n, a, N) and vectors (a, N)."""
    return np.asarray(np.einsum("naN,aN->nN", matrices, vectors))
