"""A recording after preprocessing: uniform segments, the parallel filter, and the steps that led there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass as stored

from drivers.core.arrays import FloatArray
from ident.signals.cutoffs import Cutoffs
from ident.signals.filters import ZeroPhaseFilter
from ident.signals.options import PreprocessChoices
from ident.signals.resampling import Irregularity


@stored(frozen=True)
class Step:
    """One step of the pipeline as it was done; for people only, nothing is computed from it."""

    name: str  # of the step
    settings: Mapping[str, float | int | str | bool | None]  # the numbers that it ran with
    text: str  # one printable sentence


@dataclass(frozen=True, eq=False)
class SmoothMotion:
    """The smoothed positions of a segment (n, N) with their derivatives: [rad, rad/s, rad/s² or m…]."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True, eq=False)
class Segment:
    """Consecutive samples without gaps on a uniform grid."""

    time: FloatArray  # (N,) [s], in the recording's clock
    position: FloatArray  # (n, N) low-passed [rad or m]
    velocity: FloatArray  # (n, N) [rad/s or m/s]
    acceleration: FloatArray  # (n, N) [rad/s² or m/s²]
    torque: FloatArray  # (n, N) joint side, shifted by the delay, not filtered but for a decimation [N·m or N]
    rate: float  # [Hz]
    used: npt.NDArray[np.bool_]  # (N,) whether the sample counts: in a window with motion, away from the ends
    # (n, N) motors near a velocity reversal, whose equations are left out (see `velocity_reversals`); None where all
    # equations are used
    reversing: npt.NDArray[np.bool_] | None = None
    # (n, N) motors at rest, among those of `reversing`; their torque is not compared with a prediction either (see
    # `velocity_reversals`). None where not determined.
    resting: npt.NDArray[np.bool_] | None = None
    # (n, N) of the joints [K], nan for joints without a sensor; None where none was recorded
    temperature: FloatArray | None = None
    # (n, N) friction known beforehand, which was taken off `torque` [N·m or N]; None where none was
    known_torque: FloatArray | None = None
    # motion that the controller aimed at, smoothed like the positions; None where it was not recorded
    target: SmoothMotion | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A recording, ready for the model."""

    segments: tuple[Segment, ...]  # one or more at the same rate
    steps: tuple[Step, ...]  # the pipeline, in order
    parallel_filter: ZeroPhaseFilter  # to be applied to τ and to every column of W of each segment
    cutoffs: Cutoffs  # that were used, chosen or given
    irregularity: Irregularity  # of the recorded stamps
    choices: PreprocessChoices  # the user's, with the values chosen from the data filled in

    @property
    def rest_velocity(self) -> float:
        """Speed below which a joint counts as at rest [rad/s or m/s]."""
        return self.choices.rest_velocity or 0.0

    @property
    def filtered_rate(self) -> float:
        """Rate of the filtered torques [Hz]."""
        return self.segments[0].rate / self.parallel_filter.factor

    def __str__(self) -> str:
        return describe(self)


def describe(prepared: Prepared) -> str:
    """The pipeline as it was done, one line per step."""
    width = max(len(step.name) for step in prepared.steps)
    return "\n".join(f"{number}. {step.name:<{width}}  {step.text}" for number, step in enumerate(prepared.steps, 1))
