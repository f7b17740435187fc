"""The model that is handed out by default: the one place that decides which parameters that are.

`load_model`, `predict`, `monitor` and the exports hand it out; verdict, acceptance and the report's headline grade it.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ident.assessment.validation import Fit
from ident.simulation.open_loop import OpenLoop
from ident.simulation.tracking import TrackingError
from ident.stored import Number, Stored
from ident.verdict.check import Check

Parameters = Literal["consistent", "full", "essential"]
"""Parameters of bodies that can exist; all base parameters as estimated; the significant ones, the others 0."""

DeliveredParameters = Literal["consistent", "full"]

DELIVERED_WORDS: dict[DeliveredParameters, str] = {"consistent": "physically consistent", "full": "unconstrained"}


def delivered_parameters(consistent: object | None) -> DeliveredParameters:
    """The physically consistent parameters where there are any (None: none were found), else the full ones."""
    return "full" if consistent is None else "consistent"


class HeldOutErrors(Stored):
    """The delivered model on one held-out recording."""

    recording: str
    overlap: float = Field(description="share of its samples that are the identification's own; 0: it is held out")
    at_rest: Number = Field(description="share of its torques that are of motors at rest")
    in_motion: Fit = Field(description="motors at rest left out, as in the fit")
    all_samples: Fit = Field(description="rest included: what a user of the model meets")
    graded_joint_error: list[Number] = Field(
        description="joint_relative_error of all samples, over at least a share of the joint's rated torque"
    )
    full_in_motion: Fit | None = Field(description="of the full model; null where that is the delivered one")
    full_all_samples: Fit | None = None
    simulation: TrackingError | None = Field(default=None, description="with a soft controller")
    open_loop: OpenLoop | None = Field(default=None, description="without one")
    not_simulated: str = Field(default="", description="why there is no simulation")
    checks: list[Check] = Field(default=[], description="that this recording raises, among the verdict's")

    @property
    def held_out(self) -> bool:
        """Return whether none of its samples was used in the identification."""
        return self.overlap == 0.0


class Delivered(Stored):
    """The model that `load_model`, `predict` and the exports hand out by default, which the verdict grades."""

    parameters: DeliveredParameters
    fit: Fit | None = Field(default=None, description="on the identification data; null for merged models")
    validation: Fit | None = Field(default=None, description="in motion, over all held-out recordings")
    validation_all_samples: Fit | None = Field(default=None, description="the same with samples at rest")
    runs: list[HeldOutErrors] = Field(default=[], description="each held-out recording apart")
