"""A section of the report: a template and the context it is rendered with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.core.arrays import FloatArray
from ident.regression.comparison import TorqueSeries
from ident.report.recorded_runs import RecordedRuns
from ident.result.schema import Result


@dataclass(frozen=True)
class TruthTable:
    """True base parameters, where the arm is a simulated one."""

    names: tuple[str, ...]  # of base parameters, as in the Result
    values: FloatArray  # (len(names),) in the units of the Result

    def __post_init__(self) -> None:
        if len(self.names) != len(self.values) or len(set(self.names)) != len(self.names):
            raise ValueError(f"{len(self.names)} names, {len(self.values)} values: one value per name, each name once")


@dataclass(frozen=True)
class ReportData:
    """All that the sections may show."""

    result: Result  # what was identified
    fit: tuple[TorqueSeries, ...]  # torques of the identification data, one series per gap-free segment
    validation: tuple[TorqueSeries, ...]  # torques of the held-out data; empty where nothing was held out
    truth: TruthTable | None = None  # true parameters, for simulated arms only
    recorded: RecordedRuns = field(default_factory=RecordedRuns)  # motion and temperatures of the recordings

    def __post_init__(self) -> None:
        dof = len(self.result.joints)
        for series in (*self.fit, *self.validation):
            shape = (dof, len(series.time))
            if not series.measured.shape == series.predicted.shape == series.velocity.shape == shape:
                raise ValueError(f"torques and velocities of a series must have the shape {shape}")
            if series.used.shape != series.time.shape:
                raise ValueError("`used` needs one entry per sample")

    @property
    def worst_first(self) -> list[int]:
        """Joint numbers in the verdict's order; by falling relative error where it judges no joints."""
        result = self.result
        judged = {joint.joint: place for place, joint in enumerate(result.verdict.joints)}
        errors = result.validation or result.fit
        per_joint = errors.joint_relative_error if errors is not None else []
        falling = [math.inf if error is None else -error for error in per_joint]
        falling += [math.inf] * (len(result.joints) - len(falling))
        return sorted(range(len(result.joints)), key=lambda j: (judged.get(result.joints[j], len(judged)), falling[j]))


@dataclass(frozen=True)
class ReportSection:
    """One section of the page."""

    title: str  # its heading and its entry in the table of contents
    anchor: str  # its id within the page
    template: str  # name of its template
    context: Mapping[str, Any]  # what the template is rendered with
    folded: bool = True  # whether it is folded under its heading when the page is opened


@dataclass(frozen=True)
class Tile:
    """A key figure: a number in large type with two lines about it."""

    label: str
    value: str
    note: str = ""
