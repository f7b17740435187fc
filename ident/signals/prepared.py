"""A recording after preprocessing: uniform segments, the parallel filter, and the steps that led there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.streams import FloatArray
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.options import PreprocessChoices
from ident.signals.resampling import Irregularity


@dataclass(frozen=True)
class Step:
    """One step of the pipeline as it was done.

    Attributes:
        name: of the step.
        settings: the numbers that it ran with.
        text: one printable sentence.
    """

    name: str
    settings: Mapping[str, float | int | str]
    text: str


@dataclass(frozen=True, eq=False)
class Segment:
    """A stretch without gaps on a uniform grid.

    Attributes:
        time: (N,) [s], in the recording's clock.
        position: (n, N) low-passed [rad or m].
        velocity: (n, N) [rad/s or m/s].
        acceleration: (n, N) [rad/s² or m/s²].
        torque: (n, N) joint side, shifted by the delay, not filtered but for a decimation [N·m or N].
        rate: [Hz].
        used: (N,) whether the sample counts: in a window with motion, away from the ends.
        turning: (n, N) motors whose equation does not count there (see `velocity_reversals`); None where all do.
    """

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    rate: float
    used: npt.NDArray[np.bool_]
    turning: npt.NDArray[np.bool_] | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording, ready for the model.

    Attributes:
        segments: one or more stretches at the same rate.
        steps: the pipeline, in order.
        parallel_filter: to be applied to τ and to every column of W of each segment.
        irregularity: of the recorded stamps.
        choices: the user's, with every number filled in that was taken from the data.
        velocity_difference_rms: (n,) recorded velocity, filtered alike, minus the derived one; None if none was.
    """

    segments: tuple[Segment, ...]
    steps: tuple[Step, ...]
    parallel_filter: ZeroPhaseFilter
    irregularity: Irregularity
    choices: PreprocessChoices
    velocity_difference_rms: FloatArray | None

    def __str__(self) -> str:
        return describe(self)


def describe(prepared: Prepared) -> str:
    """The pipeline as it was done, a line a step."""
    width = max(len(step.name) for step in prepared.steps)
    return "\n".join(f"{number}. {step.name:<{width}}  {step.text}" for number, step in enumerate(prepared.steps, 1))
