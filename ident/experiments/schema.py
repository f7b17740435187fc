"""Results of `dynid payload` and `dynid gains`, beside the Result of an identification."""

from __future__ import annotations

from typing import Literal

from pydantic import AliasPath, BaseModel, ConfigDict, Field

from ident.result.schema import Number


class _Entry(BaseModel):
    """Filled by name, or from the attributes of the dataclass that holds the same."""

    model_config = ConfigDict(frozen=True, extra="forbid", from_attributes=True, validate_by_name=True)


class LoadParameter(_Entry):
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


class EstimatedValue(_Entry):
    """One estimated parameter."""

    name: str
    unit: str
    value: Number
    std: Number


class BaseParameterChange(_Entry):
    """A base parameter that a load changes, as in SR400 Table 4."""

    name: str
    unit: str
    free: float
    free_std: Number
    predicted: Number = Field(description="free plus the effect of the load")
    loaded: float
    loaded_std: Number


class CentreOfMass(_Entry):
    """Of the load in the tool frame [m]."""

    value: list[Number]
    std: list[Number]


class KnownLoadValues(_Entry):
    """Known parameters of the load, in the tool frame."""

    mass: float = Field(description="[kg]")
    com: list[float] | None = Field(description="centre of mass [m]")
    inertia: list[float] | None = Field(description="xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]")


class SignificanceResult(_Entry):
    """A test of whether a difference is statistically significant."""

    statistic: float
    degrees_of_freedom: int = Field(validation_alias="freedom")
    p_value: float
    passed: bool = Field(description="the difference is not significant")


class UnchangedResult(SignificanceResult):
    """Of the base parameters that a load does not change, the one that changed most."""

    worst: str


class PayloadTests(_Entry):
    """All tests of a payload; null where there is nothing to test or too little data for it."""

    mass: SignificanceResult | None
    values: SignificanceResult | None
    load: SignificanceResult | None
    known_load: SignificanceResult | None
    unchanged: UnchangedResult | None


class DelayUsed(_Entry):
    """Torque against position [s]."""

    used: float
    note: str


class RunError(_Entry):
    """Relative error ‖τ − Wx‖/‖τ‖ of the torque in a run."""

    run: str
    unconstrained: Number
    consistent: Number


class BodyResult(_Entry):
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
    cost: SignificanceResult | None = Field(description="rise in the sum of squares over the unconstrained estimate")
    errors: list[RunError]
    links: list[LinkBody] = Field(description="the arm with the load: its last link carries it")


class PayloadResult(_Entry):
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
    known: KnownLoadValues | None
    base_parameters: list[BaseParameterChange]
    tests: PayloadTests
    sentences: list[str]
    delay: DelayUsed
    blocks: int
    block_length: int
    warnings: list[str]


class GainResult(_Entry):
    """The gain of one joint's drive."""

    joint: str
    gain: Number
    std: Number
    rsd_percent: Number = Field(validation_alias="relative_std")
    file_gain: Number
    angle_degrees: Number = Field(
        validation_alias="angle", description="between the motor signal and the columns that act on this joint alone"
    )
    confused_with: str = Field(validation_alias=AliasPath("confused_with", 0))
    correlation: Number = Field(validation_alias=AliasPath("confused_with", 1))
    noise: Number


class GainsResult(_Entry):
    """Gains of all drives from exciting motions."""

    kind: Literal["gains"] = "gains"
    robot: str
    runs: list[str] = Field(description="free, loaded")
    signal: str
    unit: str
    known: KnownLoadValues
    gains: list[GainResult]
    covariance: list[list[Number]]
    base_parameters: list[EstimatedValue]
    load: list[EstimatedValue]
    condition: Number
    gap: Number
    delay: DelayUsed
    blocks: int
    block_length: int
    robot_file_text: str
    warnings: list[str]


class SlowGainResult(_Entry):
    """The gain of one joint's drive from slow passes up and down."""

    joint: str
    sliding: bool = Field(default=False, description="whether the joint slides: N and m/s for N·m and rad/s")
    gain: Number
    std: Number
    rsd_percent: Number = Field(validation_alias="relative_std")
    file_gain: Number
    sweeps: int
    positions: int = Field(validation_alias="bins")
    speed: Number
    friction_free: Number = Field(validation_alias="free_friction")
    friction_loaded: Number = Field(validation_alias="loaded_friction")
    reason: str | None = Field(description="why there is no value; null where there is one")


class SlowGainsResult(_Entry):
    """Gains of the drives from slow up-and-down runs."""

    kind: Literal["gains-up-and-down"] = "gains-up-and-down"
    robot: str
    runs: list[str] = Field(description="free, loaded")
    signal: str
    unit: str
    known: KnownLoadValues
    gains: list[SlowGainResult]
    load: list[EstimatedValue]
    gap: Number
    robot_file_text: str
    warnings: list[str]
