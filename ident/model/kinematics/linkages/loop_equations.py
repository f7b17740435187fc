"""The equations that close an arm's loops, solved by Newton's method for the joints without a motor.

Φ(q) = 0 stacks the closing equations of every general loop and the linear equations of all others. An opened revolute
joint has five, of which a planar loop needs two, so `rows` W picks as many independent combinations as joints follow.
With J = W ∂Φ/∂q, split into the columns of the joints without a motor (p) and with one (a),

    G = −J_p⁻¹·J_a        q̈_p = G·q̈_a − J_p⁻¹·(J̇·q̇)

Loops close in several ways (assembly modes). Which one is meant is kept by following it from a known position in short
steps, each predicted by G; between two modes J_p is singular, and its determinant changes its sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.arrays import FloatArray
from ident.model.kinematics.linkages.closing_chain import ChainState, ClosingChain

BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

NEWTON_STEPS = 12
STEP_TOLERANCE = 1e-7
"""Length [rad or m] of a Newton step after which the next would be rounding: convergence is quadratic."""

MISSED = 1e-6
"""Tolerance of closing equations [m, rad]; files print lengths to this."""

LONGEST_MOVE = 0.1
"""Longest move [rad or m] of a joint with a motor from one known position to the next."""

BRANCH_DISTANCE = 0.2
"""How far [rad or m] a solution may lie from its prediction over such a move and count as the same branch."""

LONGEST_WAY = 200.0
"""Longest path [rad or m] along which a branch is followed, in steps of `LONGEST_MOVE`."""

SHORTEST_MOVE = 1e-4
"""Move [rad or m] at which following a branch is given up."""


@dataclass(frozen=True)
class Followed:
    """How far a branch could be followed."""

    tree: FloatArray  # (n, N) the last positions [rad or m] that close
    reached: FloatArray  # (N,) the fraction of the path that was reached


@dataclass(frozen=True)
class LoopEquations:
    """Φ and its derivatives."""

    # active, passive: (a,), (p,) indices of the tree's joints with and without a motor
    active: tuple[int, ...]
    passive: tuple[int, ...]
    chains: tuple[ClosingChain, ...]  # the general loops
    linear: FloatArray  # (l, n) E and `right` (l,) e of the linear equations E·q = e
    right: FloatArray
    rows: FloatArray  # (p, r) W, combinations of the r equations that are independent
    sign: float  # of det J_p on the branch that is meant

    def at(self, tree: FloatArray) -> Closing:
        """The equations at tree positions (n, N)."""
        states = [chain.at(tree) for chain in self.chains]
        derivatives = [state.residual() for state in states]
        residual = np.concatenate([*derivatives, self.linear @ tree - self.right[:, None]])
        jacobian = self.assembled([state.jacobian() for state in states], self.linear)
        return Closing(self, states, residual, jacobian, self.reduced(jacobian))

    def reduced(self, rows: FloatArray) -> FloatArray:
        """W times rows (r, …)."""
        return (self.rows @ rows.reshape(len(rows), -1)).reshape(-1, *rows.shape[1:])

    def newton(self, position: FloatArray, guess: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Tree positions (n, N) for active positions (a, N) near passive ones (p, N), and whether each closes there.

        Closing means on the branch that is meant, by the sign of det J_p, and no farther than `BRANCH_DISTANCE` from
        the guess.
        """
        passive = list(self.passive)
        tree = np.empty((len(self.active) + len(passive), position.shape[1]))
        tree[list(self.active)], tree[passive] = position, guess
        with np.errstate(all="ignore"):  # what diverges becomes infinite or no number, and does not close
            for _ in range(NEWTON_STEPS):
                here = self.at(tree)
                step = here.solved(self.reduced(here.residual)[:, None])[:, 0]
                tree[passive] -= step
                size = np.abs(step).max(axis=0)
                if not np.any(size > STEP_TOLERANCE):
                    break
            closes = (size <= STEP_TOLERANCE) & (np.abs(here.residual).max(axis=0) < MISSED)
            closes &= here.signs() == self.sign
            closes &= np.abs(tree[passive] - guess).max(axis=0) < BRANCH_DISTANCE
        return tree, closes

    def followed(self, start: FloatArray, target: FloatArray) -> Followed:
        """Follow the branch on a straight line of the active joints, `LONGEST_WAY` at most.

        Args:
            start: (n,) or (n, N) tree positions that close [rad or m].
            target: (a, N) positions of the active joints.
        """
        active, passive = list(self.active), list(self.passive)
        tree = np.array(np.broadcast_to(start.reshape(len(start), -1), (len(start), target.shape[1])))
        travel = target - tree[active]
        length = np.abs(travel).max(axis=0)
        longest = np.divide(LONGEST_MOVE, length, out=np.ones_like(length), where=length > LONGEST_MOVE)
        begun, done, step = tree[active].copy(), np.zeros(target.shape[1]), longest.copy()
        running = np.flatnonzero((length > 0.0) & (length <= LONGEST_WAY))
        done[length == 0.0] = 1.0
        while running.size:
            here = tree[:, running]
            share = np.minimum(done[running] + step[running], 1.0)
            position = np.where(share == 1.0, target[:, running], begun[:, running] + share * travel[:, running])
            moved = np.einsum("paN,aN->pN", self.at(here).follow(), position - here[active])
            solution, closes = self.newton(position, here[passive] + moved)
            good = running[closes]
            tree[:, good], done[good] = solution[:, closes], share[closes]
            step[good] = np.minimum(2.0 * step[good], longest[good])
            step[running[~closes]] *= 0.5
            running = running[(done[running] < 1.0) & (step[running] * length[running] > SHORTEST_MOVE)]
        return Followed(tree, done)

    def assembled(self, derivatives: Sequence[FloatArray], linear: FloatArray) -> FloatArray:
        """(r, n, N) from every chain's rows (rows, K, N) and the linear equations' (l, n)."""
        count = derivatives[0].shape[-1]
        total = np.zeros((sum(derivative.shape[0] for derivative in derivatives) + len(linear), linear.shape[1], count))
        start = 0
        for chain, derivative in zip(self.chains, derivatives, strict=True):
            total[start : start + len(derivative), list(chain.joints)] = derivative
            start += len(derivative)
        total[start:] = linear[:, :, None]
        return total


@dataclass(frozen=True)
class Closing:
    """The equations at N tree positions."""

    equations: LoopEquations  # which
    states: Sequence[ChainState]  # of every chain
    residual: FloatArray  # (r, N) Φ [m, rad]
    full: FloatArray  # (r, n, N) ∂Φ/∂q
    jacobian: FloatArray  # (p, n, N) J = W ∂Φ/∂q

    def follow(self) -> FloatArray:
        """G_p (p, a, N)."""
        return -self.solved(self.jacobian[:, list(self.equations.active)])

    def second(self, rate: FloatArray) -> FloatArray:
        """W·∂²Φ/∂q² along `rate` (n, N): (p, n, N), which is J̇ of that motion."""
        pairs = zip(self.equations.chains, self.states, strict=True)
        return self._reduced([state.second(rate[list(chain.joints)]) for chain, state in pairs])

    def third(self, rate: FloatArray) -> FloatArray:
        """W·∂³Φ/∂q³ twice along `rate` (n, N): (p, n, N)."""
        pairs = zip(self.equations.chains, self.states, strict=True)
        return self._reduced([state.third(rate[list(chain.joints)]) for chain, state in pairs])

    def solved(self, right: FloatArray) -> FloatArray:
        """J_p⁻¹·right for right (p, m, N); no numbers where J_p is singular."""
        stacked, sides = self._of_passive(), right.transpose(2, 0, 1)
        try:
            solution = np.linalg.solve(stacked, sides)
        except np.linalg.LinAlgError:
            regular = np.where((np.linalg.det(stacked) == 0.0)[:, None, None], np.nan, stacked)
            solution = np.linalg.solve(regular, sides)
        return np.asarray(solution.transpose(1, 2, 0), dtype=np.float64)

    def signs(self) -> FloatArray:
        """(N,) signs of det J_p."""
        return np.asarray(np.sign(np.linalg.det(self._of_passive())))

    def singular_values(self) -> FloatArray:
        """(N, p) of J_p, the largest first."""
        return np.asarray(np.linalg.svd(self._of_passive(), compute_uv=False))

    def _of_passive(self) -> FloatArray:
        return self.jacobian[:, list(self.equations.passive)].transpose(2, 0, 1)

    def _reduced(self, derivatives: Sequence[FloatArray]) -> FloatArray:
        equations = self.equations
        return equations.reduced(equations.assembled(derivatives, np.zeros_like(equations.linear)))
