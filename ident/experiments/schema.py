"""Results of `dynid payload` and `dynid gains`, beside the Result of an identification."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ident.assessment.delay.delay import DelaySearch
from ident.experiments.gains.drive_gains import EstimatedValue, GainEstimate, GainsFigures
from ident.experiments.load.payload import BaseParameterChange, PayloadTests
from ident.model.load import KnownLoad
from ident.regression.hypothesis_tests import SignificanceTest
from ident.stored import Number, Stored


class LoadParameter(Stored):
    """One identifiable combination of load parameters, in the tool frame."""

    name: str
    expression: str
    unit: str
    value: Number = Field(description="null where the two motions do not excite it")
    std: Number = Field(description="both causes together")
    noise_std: Number = Field(description="from noise and errors that change along the motion")
    gain_std: Number = Field(
        description="from the drive gains' standard deviations, their errors independent or common"
    )


class CentreOfMass(Stored):
    """Centre of mass of the load in the tool frame [m]."""

    value: list[Number]
    std: list[Number]


class RunError(Stored):
    """Relative error ‖τ − Wx‖/‖τ‖ of the torque in a run."""

    run: str
    unconstrained: Number
    consistent: Number


class BodyResult(Stored):
    """A rigid body."""

    mass: float = Field(description="[kg]")
    com: list[float] = Field(description="centre of mass [m]")
    inertia: dict[str, float] = Field(description="about the centre of mass: xx, xy, xz, yy, yz, zz [kg·m²]")


class LinkBody(BodyResult):
    """A link of the arm with the load, in the frame of its joint."""

    link: str


class ConsistentLoadResult(BodyResult):
    """A load that can exist, on an arm whose links can exist, in the tool frame; σ includes noise and gains."""

    mass_std: Number = Field(description="[kg]; 0 where known, null where the data do not determine it")
    com_std: list[Number] = Field(description="[m]")
    inertia_std: dict[str, Number] = Field(description="[kg·m²]")
    determined: dict[str, float] = Field(
        description="share of each standard parameter that the data determine; the rest comes from the prior"
    )
    held: list[str] = Field(description="standard parameters held at known values")
    on_boundary: bool = Field(description="the condition that it can exist holds it")
    boundary_links: list[str] = Field(description="links that the condition holds")
    cost: SignificanceTest | None = Field(description="rise in the sum of squares over the unconstrained estimate")
    errors: list[RunError]
    links: list[LinkBody] = Field(description="the arm with the load: its last link carries it")


class PayloadResult(Stored):
    """Results of a free and a loaded run about a load."""

    kind: Literal["payload"] = "payload"
    robot: str
    runs: list[str] = Field(description="free, loaded")
    frame: str
    load: list[LoadParameter]
    load_with_known: list[LoadParameter] | None
    consistent_load: ConsistentLoadResult | None
    centre_of_mass: CentreOfMass | None
    not_identifiable: list[str]
    unexcited: list[str]
    known: KnownLoad | None
    base_parameters: list[BaseParameterChange]
    tests: PayloadTests
    sentences: list[str]
    delay: DelaySearch
    blocks: int
    block_length: int
    warnings: list[str]


class GainsResult(GainsFigures):
    """Gains of all drives from exciting motions."""

    kind: Literal["gains"] = "gains"
    gains: list[GainEstimate]
    covariance: list[list[Number]]
    base_parameters: list[EstimatedValue]
    condition: Number
    delay: DelaySearch
    blocks: int
    block_length: int
