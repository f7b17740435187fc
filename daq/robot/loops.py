"""Sections `model.loops` and `model.coupling` of a robot file: joints without a motor, motors of several joints.

SR400 .2-3: a closed loop is opened at one joint, which leaves a tree; the joints without a motor follow the others by
q_passive = A·q_active + b, or, where they do not follow linearly, so that the opened joint's two frames meet. Where
motors move several joints, q_motor = R·q_joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from daq.robot.section import Angle, Finite, Section, TableAngle

BASE = "base"
"""Name of the fixed link in an `antecedent`."""

SINGULAR_CONDITION = 1e10
"""Condition number of R from which on the motors do not determine the joints."""


class ClosingFrame(Section):
    """A frame that is fixed on a link, in the notation of an `mdh` row (SR400 .2: two frames on each opened joint)."""

    antecedent: str = Field(description="joint that moves the link; for loops with `passive` also 'base'")
    gamma: TableAngle = Field(default=0.0, description="[rad]")
    b: Finite = Field(default=0.0, description="[m]")
    alpha: TableAngle = Field(default=0.0, description="[rad]")
    d: Finite = Field(default=0.0, description="[m]")
    theta0: TableAngle = Field(default=0.0, description="[rad]")
    r: Finite = Field(default=0.0, description="[m]")


class Loop(Section):
    """How joints without a motor follow the others: an equation of one joint, a parallelogram of four, or by closing.

    `joint` = Σ factor · joint + `offset`; or `parallelogram` [a, b, c, d]: links behind a and d stay parallel, and so
    do those behind c and b, where b hangs on a and d on c; or `passive`, the joints that follow as the loop closes. The
    `closing` frames, on the two links that the opened joint connected, lie on each other at every position.
    """

    joint: str | None = Field(default=None, description="the joint that follows")
    equation: dict[str, Finite] | None = Field(default=None, description="joint → factor")
    offset: Angle = Field(default=0.0, description="[rad or m]")
    parallelogram: tuple[str, str, str, str] | None = None
    passive: dict[str, Angle] | None = Field(
        default=None,
        description="joint that follows → its position [rad or m] near the start, which selects the branch",
    )
    at: dict[str, Angle] = Field(
        default_factory=dict,
        description="joint with a motor → its position at the start; else the middle of its limits",
    )
    opened: Literal["revolute", "spherical"] | None = Field(default=None, description="the opened joint; revolute")
    closing: tuple[ClosingFrame, ClosingFrame] | None = Field(default=None, description="of the opened joint")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        kinds = [kind for kind in (self.joint, self.parallelogram, self.passive) if kind is not None]
        if len(kinds) != 1:
            raise ValueError("a loop has either 'joint' with 'equation', or 'parallelogram', or 'passive'")
        if self.joint is not None:
            if self.equation is None:
                raise ValueError(f"joint '{self.joint}' needs its 'equation'; {{}} keeps it at 'offset'")
            if self.joint in self.equation:
                raise ValueError(f"the equation of joint '{self.joint}' names that joint itself")
        elif self.equation is not None or self.offset != 0.0:
            what = "a parallelogram's" if self.parallelogram is not None else "the closing"
            raise ValueError(f"{what} equations are derived: leave 'equation' and 'offset' out")
        if self.parallelogram is not None and len(set(self.parallelogram)) < 4:
            raise ValueError("a parallelogram has four different joints")
        if self.joint is None and self.closing is None:
            what = "a parallelogram" if self.parallelogram is not None else "a loop with 'passive' joints"
            raise ValueError(f"{what} needs 'closing', the two frames that meet where it was opened")
        self._check_passive()
        return self

    def _check_passive(self) -> None:
        if self.passive is None:
            if self.at or self.opened is not None:
                raise ValueError("'at' and 'opened' are for loops with 'passive' joints")
            return
        if not self.passive:
            raise ValueError("'passive' names no joint; name those that follow, each with its position at the start")
        if self.closing is not None and self.closing[0].antecedent == self.closing[1].antecedent:
            raise ValueError("the closing frames lie on one link: there is no joint between them to close")

    @property
    def following(self) -> tuple[str, ...]:
        """The joints that the loop names as following, none of a parallelogram."""
        return (self.joint,) if self.joint is not None else tuple(self.passive or ())

    @property
    def named(self) -> tuple[str, ...]:
        """Every joint that the loop names."""
        frames = [frame.antecedent for frame in self.closing or ()]
        if self.passive is not None:
            frames = [name for name in frames if name != BASE]
        return (*(self.parallelogram or ()), *self.following, *(self.equation or ()), *self.at, *frames)


def passive_joints(loops: Iterable[Loop], active: tuple[str, ...]) -> tuple[str, ...]:  # noqa: C901 — a branch per mistake
    """Names of the joints that the loops make follow `active`, in the loops' order.

    Raises:
        ValueError: a joint that is to follow is listed as active or follows twice, or a parallelogram has not just two
            joints without a motor.
    """
    passive: list[str] = []
    loops = tuple(loops)
    for loop in loops:
        following = list(loop.following)
        for name in following:
            if name in active:
                raise ValueError(
                    f"'joints' names '{name}', but by 'model.loops' it is passive: it has no motor, leave it out"
                )
        if loop.parallelogram is not None:
            four = loop.parallelogram
            following = [name for name in four if name not in active]
            if len(following) != 2:
                moved = ", ".join(name for name in four if name in active) or "none"
                raise ValueError(
                    f"two joints of the parallelogram {', '.join(four)} must be passive, so two of them are in "
                    f"'joints'; it has: {moved}"
                )
        for name in following:
            if name in passive:
                raise ValueError(f"'model.loops' defines joint '{name}' twice")
            passive.append(name)
    joints = (*active, *passive)
    for loop in loops:
        for name in loop.named:
            if name not in joints:
                raise ValueError(f"'model.loops' names joint '{name}', but there are only: {', '.join(joints)}")
        for name in loop.at:
            if name not in active:
                raise ValueError(f"'at' of a loop names joint '{name}', but that one has no motor")
    return tuple(passive)


def check_coupling(
    coupling: Mapping[str, Mapping[str, float]], active: tuple[str, ...], passive: tuple[str, ...]
) -> None:
    """Refuse a coupling matrix that names unknown or passive joints, or that is singular.

    Raises:
        ValueError: saying which, and why.
    """
    for motor, row in coupling.items():
        for name in (motor, *row):
            if name in passive:
                raise ValueError(f"'model.coupling' names joint '{name}', but it is passive: it has no motor")
            if name not in active:
                raise ValueError(f"'model.coupling' names joint '{name}', but 'joints' has only: {', '.join(active)}")
    matrix = coupling_matrix(coupling, active)
    condition = float(np.linalg.cond(matrix))
    if not condition < SINGULAR_CONDITION:
        raise ValueError(
            "'model.coupling' is singular: some motion of the joints moves no motor "
            f"(rank {np.linalg.matrix_rank(matrix)} of {len(active)})"
        )


def check_pairs(named: Iterable[str], coupling: Mapping[str, Mapping[str, float]]) -> None:
    """Refuse `pair` and `pair_inertia` where no other joint moves the motor.

    Raises:
        ValueError: naming the joint.
    """
    for name in named:
        if sum(factor != 0.0 for factor in coupling.get(name, {}).values()) < 2:
            raise ValueError(
                f"'pair' and 'pair_inertia' are for coupled motors, and '{name}' is not in 'model.coupling'"
            )


def coupling_matrix(coupling: Mapping[str, Mapping[str, float]], active: tuple[str, ...]) -> np.ndarray:
    """R (n, n) with q_motor = R·q_joint; motors that `coupling` does not name move one joint each."""
    matrix = np.eye(len(active))
    for motor, row in coupling.items():
        row_index = active.index(motor)
        matrix[row_index] = [row.get(name, 0.0) for name in active]
    return matrix
