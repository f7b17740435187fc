"""What a model did on held-out data: errors of its torque, and of the motion that it simulates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.core.text import percent_text


@dataclass(frozen=True)
class TorqueError:
    """A held-out error as a ratio of the torque, ‖measured − predicted‖ / ‖measured‖; None where it is not known."""

    all_samples: float | None  # rest included
    in_motion: float | None = None  # motors at rest left out; what a fit sees
    # that of all samples, for a joint over at least a share of its rated torque: of a joint with hardly any torque, the
    # ratio says nothing. None takes `all_samples`.
    graded: float | None = None

    @property
    def judged(self) -> float | None:
        """The figure that the grade follows from."""
        return known(self.all_samples if self.graded is None else self.graded)

    @property
    def text(self) -> str:
        """Both errors in words, the second where it differs."""
        whole = known(self.all_samples)
        if whole is None:
            return "not known"
        text, moving, judged = percent_text(whole, 2), known(self.in_motion), self.judged
        if moving is not None and percent_text(moving, 2) != text:
            text += f" over all samples ({percent_text(moving, 2)} in motion)"
        if judged is not None and percent_text(judged, 2) != percent_text(whole, 2):
            text += f", {percent_text(judged, 2)} of the smallest torque that counts for this joint"
        return text


@dataclass(frozen=True)
class MotionError:
    """A simulated motion's error over that of constant velocity; below 1 the simulation is worth something."""

    whole: float  # of all joints together
    joints: Mapping[str, float]  # by the joint's name
    errors: Mapping[str, str]  # root mean square error by the joint's name, with its unit
    text: str  # how it was simulated, as a noun: "motion simulated over 1 s without a controller"

    @property
    def worst(self) -> str:
        """Name of the joint with the largest ratio."""
        return max(self.joints, key=lambda joint: self.joints[joint])


@dataclass(frozen=True)
class Evidence:
    """A model on held-out data."""

    whole: TorqueError  # its torque error over all joints together
    joints: dict[str, TorqueError]  # that of each, by name
    motions: tuple[MotionError, ...] = field(default=())  # simulated; empty where nothing was


def known(error: float | None) -> float | None:
    """The figure; None where it is no finite number."""
    return None if error is None or not math.isfinite(error) else error
