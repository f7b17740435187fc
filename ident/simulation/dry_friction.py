"""Dry friction over one time step: which directions stick, which slide, and with what torque.

With u = D·q̇ after the step and W = h·D·A⁻¹·Dᵀ (symmetric, positive semidefinite), find λ so that

    u = u_free − W·λ        λᵢ = fᵢ·sign(uᵢ), or |λᵢ| ≤ fᵢ where uᵢ = 0

the minimum of ½·λᵀWλ − u_freeᵀλ over the box |λ| ≤ f (Moreau 1988; Acary and Brogliato 2008, ch. 10). A primal active
set finds it (Nocedal and Wright, Numerical Optimization, 2006, ch. 16.5): directions whose part of W is nonsingular
are held at velocity 0, the others keep their λ. Every step lowers the objective and stays in the box, so that no set
comes twice and the result is exact to rounding. Where W is singular, a released direction moves together with those
that it depends on, without curvature, until one of them reaches its limit (Gill, Murray, Saunders and Wright 1991).
"""

from __future__ import annotations

import ctypes
import math
from operator import mul

import numpy as np

from drivers.core.arrays import FloatArray
from ident.compiled.library import address, kernels

PRECISION = 5e-13
"""Velocity that counts as 0, as a share of |u_free| + |W|·f of the same direction: no unit matters."""

SINGULAR = 1e-13
"""A direction depends on others if they leave less than this share of its diagonal element of W."""

CHANGES = 50
"""Changes of the sticking set per direction, many more than any case has needed."""


def dry_friction(matrix: FloatArray, free: FloatArray, limit: FloatArray, guess: FloatArray) -> FloatArray:
    """λ (m,) [N·m or N], exact to rounding.

    Args:
        matrix: W (m, m); may be singular.
        free: u_free (m,) velocity without dry friction [rad/s or m/s].
        limit: f (m,) above 0 [N·m or N].
        guess: λ of the step before, or anything else; the nearer, the fewer changes.

    Raises:
        ArithmeticError: W is not positive semidefinite.
    """
    still = PRECISION * (np.abs(free) + np.abs(matrix) @ limit)
    torque = np.minimum(np.maximum(guess, -limit), limit)
    sticking: _Sticking | None = None
    for _ in range(CHANGES * len(free)):
        velocity = free - matrix @ torque
        # Within its limit λ holds the velocity 0; at a limit it does not oppose the velocity.
        within = np.abs(torque) < limit
        violated = (np.abs(velocity) > still) & (within | (velocity * torque < 0.0))
        if True not in violated.tolist():  # quicker than any() for so few
            return torque
        if sticking is None:
            sticking = _Sticking(matrix, within.nonzero()[0].tolist())
        step = np.zeros(len(free))
        if violated[sticking.directions].any():
            step[sticking.directions] = sticking.stopping(velocity)
            reached = _advance(torque, step, limit, 1.0)
            if reached is not None:
                sticking.remove(reached)
            continue
        candidates = violated.nonzero()[0]
        released = int(candidates[np.argmax(np.abs(velocity[candidates]) / still[candidates])])
        follow = sticking.append(released)
        if follow is None:
            continue
        step[sticking.directions], step[released] = follow, 1.0
        reached = _advance(torque, np.copysign(step, velocity[released] * step), limit, np.inf)
        if reached is not None and reached != released:
            sticking.remove(reached)
            sticking.append(released)
    raise ArithmeticError("dry friction: the matrix is not positive semidefinite")


def quick_dry_friction(matrix: FloatArray, free: FloatArray, limit: FloatArray, guess: FloatArray) -> FloatArray:
    """The same as `dry_friction`, in a tenth of the time where there is a compiled library.

    Raises:
        ArithmeticError: W is not positive semidefinite.
    """
    library = kernels().quick
    if library is None:
        return dry_friction(matrix, free, limit, guess)
    torque = guess.copy()
    rows = [np.ascontiguousarray(array) for array in (matrix, free, limit, torque)]
    if library.dynid_dry_friction(len(free), *(ctypes.c_void_p(address(row)) for row in rows)):
        return dry_friction(matrix, free, limit, guess)  # which says why it cannot
    return rows[-1]


class _Sticking:
    """Directions whose part of W is nonsingular, with its Cholesky factor; in plain numbers, quicker for so few."""

    def __init__(self, matrix: FloatArray, directions: list[int]) -> None:
        self._matrix = matrix
        self.directions: list[int] = []
        self._factor: list[list[float]] = []
        for direction in directions:
            self.append(direction)

    def append(self, direction: int) -> list[float] | None:
        """Add a direction that does not depend on the others; else how they move with it while they stick."""
        row = self._forward(self._matrix[direction, self.directions].tolist())
        own = float(self._matrix[direction, direction])
        left = own - sum(map(mul, row, row))
        if left <= SINGULAR * own:
            return [-value for value in self._backward(row)]
        self.directions.append(direction)
        self._factor.append([*row, math.sqrt(left)])
        return None

    def remove(self, direction: int) -> None:
        """Take a direction out."""
        place = self.directions.index(direction)
        behind = self.directions[place + 1 :]
        del self.directions[place:], self._factor[place:]
        for other in behind:
            self.append(other)

    def stopping(self, velocity: FloatArray) -> list[float]:
        """Change of λ that takes the velocity (m,) from the sticking directions."""
        return self._backward(self._forward(velocity[self.directions].tolist()))

    def _forward(self, values: list[float]) -> list[float]:
        solution: list[float] = []
        for value, row in zip(values, self._factor, strict=True):
            solution.append((value - sum(map(mul, row, solution))) / row[-1])
        return solution

    def _backward(self, values: list[float]) -> list[float]:
        solution = values.copy()
        for place in range(len(solution) - 1, -1, -1):
            row = self._factor[place]
            solution[place] /= row[place]
            for above in range(place):
                solution[above] -= row[above] * solution[place]
        return solution


def _advance(torque: FloatArray, step: FloatArray, limit: FloatArray, longest: float) -> int | None:
    """Move λ along a step, `longest` times at most, to the first limit; the direction that reaches it, if one does."""
    moving = step.nonzero()[0]
    target = np.copysign(limit[moving], step[moving])
    room = (target - torque[moving]) / step[moving]
    first = int(room.argmin())
    if room[first] >= longest:
        torque += longest * step
        return None
    torque += room[first] * step
    np.minimum(np.maximum(torque, -limit), limit, out=torque)  # rounding
    torque[moving[first]] = target[first]
    return int(moving[first])
