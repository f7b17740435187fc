"""Pieces of motion of single joints, side by side, on which servo joints are rolled out; what a roll-out gives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drivers.core.arrays import FloatArray, IndexArray

THINNED = 4
"""Inertia between joints, and the links along a roll-out, are evaluated at every fourth step: they change slowly."""


@dataclass(frozen=True, eq=False)
class Touch:
    """Where a point of a link is along P pieces of motion, linear in the point; all n joints of each in turn."""

    reference: FloatArray  # (K, L) positions along which it holds [rad or m]
    height: FloatArray  # (4, K, P) of the link's origin and of its axes' unit vectors [m]
    lever: FloatArray  # (4, K, L) derivatives of the heights by each joint's position


@dataclass(frozen=True, eq=False)
class Lanes:
    """Pieces of motion of single joints, side by side on a grid of `step` seconds."""

    step: float  # [s]
    joint: IndexArray  # (L,) index of each lane's joint
    piece: IndexArray  # (L,) index of the piece of motion that it is of
    command: FloatArray  # (history + K, L) commanded positions, from `history` steps before the piece [rad or m]
    history: int  # number of steps
    start: FloatArray  # (L,) measured positions at the beginning
    inertia: FloatArray  # (K, L) of the links about the joint [kg·m²]
    load: FloatArray  # (K, L) gravity and coupling, as the torque that the joint must give [N·m]
    load_slope: FloatArray  # (K, L) derivative of gravity by the joint's own position [N·m/rad]
    sample: FloatArray  # (S, L) where the measured samples are on the grid, as fractions of steps
    measured: FloatArray  # (S, L) positions; nan where a sample does not count
    # of the point that may touch something; None where the lanes are not those of whole arms
    touch: Touch | None = None
    # (K / `THINNED`, P, n, n) inertia of each piece's joints [kg·m²], by which they move each other; None where its
    # torques are in `load`
    between: FloatArray | None = None

    def of_pieces(self, pieces: IndexArray) -> Lanes:
        """All lanes of some pieces, by number, with what they touch."""
        chosen = np.flatnonzero(np.isin(self.piece, pieces))
        kept, touch = np.flatnonzero(np.isin(np.unique(self.piece), pieces)), self.touch
        if touch is not None:
            touch = Touch(touch.reference[:, chosen], touch.height[:, :, kept], touch.lever[:, :, chosen])
        return replace(self.of(chosen), touch=touch, between=None if self.between is None else self.between[:, kept])

    def consecutive(self, pieces: slice, joints: int) -> Lanes:
        """Pieces that lie side by side, of so many lanes each, without what they touch."""
        between = None if self.between is None else self.between[:, pieces]
        return replace(self.of(slice(pieces.start * joints, pieces.stop * joints)), between=between)

    def of(self, chosen: IndexArray | slice) -> Lanes:
        """Some of the lanes, on their own, row after row in memory: a roll-out would copy columns at each call."""
        rows = np.arange(len(self.joint))[chosen]
        return Lanes(
            self.step,
            self.joint[rows],
            self.piece[rows],
            self.command.take(rows, axis=1),
            self.history,
            self.start[rows],
            self.inertia.take(rows, axis=1),
            self.load.take(rows, axis=1),
            self.load_slope.take(rows, axis=1),
            self.sample.take(rows, axis=1),
            self.measured.take(rows, axis=1),
        )


def repeated(lanes: Lanes, times: int, joints: int) -> Lanes:
    """The lanes several times side by side, as those of further joints: a few long steps cost less than many."""
    wide = lanes.of(np.tile(np.arange(len(lanes.joint)), times))
    offsets = np.repeat(np.arange(times) * joints, len(lanes.joint))
    touch = lanes.touch
    if touch is not None:
        touch = Touch(
            np.tile(touch.reference, (1, times)),
            np.tile(touch.height, (1, 1, times)),
            np.tile(touch.lever, (1, 1, times)),
        )
    between = None if lanes.between is None else np.tile(lanes.between, (1, times, 1, 1))
    return replace(wide, joint=wide.joint + offsets, touch=touch, between=between)


class RollOut(NamedTuple):
    """What a roll-out gives.

    Attributes:
        path: (K, L) positions on the grid [rad or m].
        slopes: (P, S, n, F) derivatives of the path without contact at the samples of each piece and joint, by F
            parameters in the search's coordinates (logarithms of positive terms).
        force: (K, P) of the contact [N], without columns where nothing is touched.
        pull: (K, L) torque that the other joints ask for [N·m], without columns where none moves another.
    """

    path: FloatArray
    slopes: FloatArray
    force: FloatArray
    pull: FloatArray


def at_samples(lanes: Lanes, path: FloatArray) -> FloatArray:
    """Values (…, S, L) at the measured samples, between those on the grid (…, K, L)."""
    before = np.clip(np.floor(lanes.sample).astype(np.intp), 0, path.shape[-2] - 2)
    part = lanes.sample - before
    lane = np.arange(path.shape[-1])
    sampled: FloatArray = path[..., before, lane] * (1.0 - part) + path[..., before + 1, lane] * part
    return sampled
