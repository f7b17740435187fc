"""Friction experiments in one call."""

from __future__ import annotations

from dataclasses import dataclass

from daq.robot.loader import load_robot
from drivers.core.options import keywords_of
from drivers.core.text import json_text
from ident.experiments.friction.experiment import FrictionExperiment, analyse_friction
from ident.report.friction_page import friction_page
from ident.result.friction_experiment import FRICTION_FILE, FrictionExperimentResult
from ident.result.tables import Table
from ident.tasks.arguments import SavedResult, recordings_of
from ident.tasks.options import FrictionOptions
from ident.views.friction_tables import friction_table


@dataclass(frozen=True)
class IdentifiedFriction(SavedResult):
    """Friction of an arm's joints by experiment.

    Attributes:
        experiment: all of its figures and data.

    Example:
        >>> import dynid
        >>> dynid.IdentifiedFriction.table.__doc__.split(":")[0]
        'One row per joint'
    """

    FILE = FRICTION_FILE

    experiment: FrictionExperiment

    @property
    def result(self) -> FrictionExperimentResult:
        """What `friction.json` holds."""
        return self.experiment.result

    @property
    def table(self) -> Table:
        """One row per joint: coefficients and shapes with their σ, the ranges that they hold for, residual RMS."""
        return friction_table(self.result)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the recordings do not tell."""
        return tuple(self.result.warnings)

    def to_json(self) -> str:
        """Output of `dynid friction --json`."""
        return json_text(self.result.model_dump())

    def _page(self) -> str:
        return friction_page(self.experiment)

    def __repr__(self) -> str:
        return f"<dynid.IdentifiedFriction of {', '.join(joint.joint for joint in self.result.joints)}>"

    def __str__(self) -> str:
        return "\n".join([str(self.table), *(f"warning: {warning}" for warning in self.warnings)])

    def _repr_html_(self) -> str:
        return self.table._repr_html_()


@keywords_of(FrictionOptions)
def friction(options: FrictionOptions) -> IdentifiedFriction:
    """Identify the friction of single joints from recordings in which one joint moves at a time (AUBO §2.2).

    Each movement has its own gravity and inertia, so that poses and weights on the tool may differ.

    Raises:
        InputError: invalid recordings or options; loops or coupled motors; no joint that moves alone.
        IdentificationError: the movements do not tell the terms apart.

    Example:
        >>> import dynid
        >>> dynid.friction("sweep.h5")
        Traceback (most recent call last):
        drivers.core.errors.RecordingError: sweep.h5: no such file
    """
    robot_file = None if options.robot is None else load_robot(options.robot)
    recordings = recordings_of(options.runs)
    return IdentifiedFriction(
        analyse_friction(recordings, options.friction, robot_file, options.delay, options.progress)
    )
