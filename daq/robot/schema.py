"""The robot file: the description of an arm (YAML; DESIGN.md "The robot file").

Units: m, rad, s, kg, N·m, A, °C. Angles of the geometry may be written as multiples of pi (`-pi/2`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr, model_validator

from daq.robot.lengths import with_lengths
from daq.robot.loops import BASE as BASE
from daq.robot.loops import Loop, check_coupling, check_pairs, passive_joints
from daq.robot.prior import Known, Prior, known_problems
from daq.robot.references import OF_JOINTS, JointNames, name_problems, row_problems
from daq.robot.section import (
    Angle,
    Finite,
    Length,
    NonNegative,
    NotTruthValue,
    Place,
    PositionLimit,
    Positive,
    Section,
    TableAngle,
    Vector3,
    VelocityLimit,
    within,
)
from daq.robot.workspace import Mounting, Workspace
from drivers.core.ranges import EXPONENT, JOINTS, PAYLOAD, STRIBECK_VELOCITY
from drivers.core.terminal import LONGEST_NAME, unfit_name
from drivers.core.units import common_unit, joint_unit
from drivers.core.validation import SeveralProblems

ASSUMED_ACCELERATION = 10.0
"""Acceleration limit of a joint whose limit the file does not state [rad/s² or m/s²]."""


class MdhRow(Section):
    """One frame of the modified Denavit-Hartenberg description of Khalil and Kleinfinger (1986).

    Frame j follows from its antecedent's by Rot(z, gamma) Trans(z, b) Rot(x, alpha) Trans(x, d) Rot(z, theta)
    Trans(z, r); theta = theta0 + q for a revolute joint, r = r + q for a prismatic one.
    """

    joint: str
    antecedent: str = Field(default=BASE, description="name of the antecedent joint, or 'base'")
    type: Literal["revolute", "prismatic"] = "revolute"
    gamma: TableAngle = Field(default=0.0, description="[rad], non-zero only where a tree branches")
    b: Length = Field(default=0.0, description="[m], non-zero only where a tree branches")
    alpha: TableAngle = Field(description="[rad]")
    d: Length = Field(description="[m]")
    theta0: TableAngle = Field(default=0.0, description="[rad], added to the joint position")
    r: Length = Field(description="[m]")


_INCLINED = 0.5
"""A table or a ceiling is inclined by at most 60°, a wall by at most 30° from the vertical."""
_UPWARD = {"table": (_INCLINED, 1.0), "wall": (-0.87, 0.87), "ceiling": (-1.0, -_INCLINED)}
"""Range of the cosine between the base frame's z axis and the vertical."""


class ModelSection(Section):
    """Kinematics: exactly one of `urdf` and `mdh`."""

    urdf: str | None = Field(
        default=None, description="path of the URDF, relative to the robot file; builtin:NAME for one that ships"
    )
    mdh: tuple[MdhRow, ...] | None = Field(default=None, max_length=int(JOINTS.most))
    lengths: dict[str, Length] = Field(
        default_factory=dict, description="name → length [m]; `b`, `d` and `r` may then be written `d3` or `-d3`"
    )
    gravity: Vector3 = Field(default=(0.0, 0.0, -9.81), description="[m/s²] in the base frame")
    mounting: Mounting | None = Field(
        default=None, description="how the base is mounted; where absent it follows from gravity, see `mounted`"
    )
    locked: dict[str, Finite] = Field(default_factory=dict, description="joint → fixed position [rad or m]; URDF only")
    loops: tuple[Loop, ...] = Field(default=(), description="how joints without a motor follow the others")
    coupling: dict[str, dict[str, Finite]] = Field(
        default_factory=dict,
        description="motor → joint → factor: rows of q_motor = R·q_joint of motors that several joints move",
    )

    @model_validator(mode="before")
    @classmethod
    def _lengths(cls, content: Any) -> Any:
        return with_lengths(content)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.urdf is None) == (self.mdh is None):
            raise ValueError("give exactly one of 'urdf' and 'mdh'")
        if self.mdh is not None:
            if not self.mdh:
                raise ValueError("'mdh' has no rows")
            if problems := row_problems([(row.joint, row.antecedent) for row in self.mdh]):
                raise SeveralProblems(problems)
            if self.locked:
                raise ValueError("'locked' works with 'urdf' only; leave the joint out of 'mdh' instead")
        if max(abs(component) for component in self.gravity) > 30:
            raise ValueError(f"gravity {list(self.gravity)} m/s² is larger than on any planet; check the unit")
        upward = self._upward
        if self.mounting in _UPWARD and upward is not None:
            low, high = _UPWARD[self.mounting]
            if not low <= upward <= high:
                raise ValueError(
                    f"mounting '{self.mounting}' does not fit gravity {list(self.gravity)}: the base frame's z axis "
                    "points from the mounting surface to the arm; correct one of them, or use 'free' and "
                    "workspace.keep_out"
                )
        return self

    @property
    def _upward(self) -> float | None:
        """Cosine of the angle between the base frame's z axis and the vertical; None without gravity."""
        size = math.hypot(*self.gravity)
        return None if size == 0.0 else -self.gravity[2] / size

    @property
    def mounted(self) -> Mounting:
        """The mounting; where the file does not say it, `table` or `ceiling` if gravity shows it, else `free`."""
        if self.mounting is not None:
            return self.mounting
        upward = self._upward or 0.0
        return "table" if upward >= _INCLINED else "ceiling" if upward <= -_INCLINED else "free"


class JointLimits(Section):
    """A joint's limits; the torque and temperature limits may be unknown."""

    name: str
    position: tuple[PositionLimit, PositionLimit] = Field(description="[rad or m]")
    velocity: VelocityLimit = Field(description="[rad/s or m/s]")
    acceleration: Positive = Field(default=ASSUMED_ACCELERATION, description="[rad/s² or m/s²]")
    torque: Positive | None = Field(default=None, description="[N·m or N]")
    temperature: Finite | None = Field(default=None, description="[°C]")
    aliases: tuple[str, ...] = Field(default=(), description="other names that files give the joint")
    _sliding: bool = PrivateAttr(default=False)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.position[0] < self.position[1]:
            raise ValueError(f"position limits {list(self.position)} are not in ascending order")
        return self

    @property
    def sliding(self) -> bool:
        """Return whether the joint slides, as the kinematics say: its units are then m and N."""
        return self._sliding

    def of_kind(self, *, sliding: bool) -> Self:
        """The same limits, of a joint that slides or turns."""
        limits = self.model_copy()
        limits._sliding = sliding
        return limits

    def unit(self, unit: str) -> str:
        """The unit of one of its quantities, given that of a turning joint."""
        return joint_unit(unit, sliding=self._sliding)


class Drive(Section):
    """How a motor's signal becomes joint torque: Γ = gain · signal (SR400 .4.3 point 1, AUBO eq. 2)."""

    joint: str
    gain: Finite | None = Field(
        default=None, description="[N·m/A] or [N·m/V], joint side, sign included; unknown if absent"
    )
    gain_std: NonNegative | None = Field(default=None, description="standard deviation of the gain, in its unit")
    signal: Literal["current", "voltage", "torque", "magnitude"] = Field(
        default="current", description="'magnitude': current or torque without its sign, which is no torque"
    )
    count: Positive | None = Field(default=None, description="current of one count, in recordings of whole counts [A]")
    inertia: bool = Field(default=True, description="whether the measured torque carries the motor's inertia")
    pair_inertia: bool = Field(default=False, description="of coupled motors: Iac, which turns with the joint")
    armature: NonNegative | None = Field(
        default=None,
        description="with `inertia: false`: the motor's inertia, joint side, for simulation and export [kg·m² or kg]",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.gain == 0:
            raise ValueError("a gain of 0 would erase the signal")
        if self.armature is not None and self.inertia:
            raise ValueError(
                "'armature' is for torques that do not carry the motor's inertia: add 'inertia: false', or state a "
                "known inertia under 'known' (Ia1, Ia2, …)"
            )
        return self


Exponent = Annotated[Positive, AfterValidator(within(EXPONENT))] | Literal["estimated"]
StribeckVelocity = Annotated[Positive, AfterValidator(within(STRIBECK_VELOCITY))] | Literal["estimated"]
LoadFriction = Literal["none", "linear", "quadratic"]
FRICTION_TERMS = ("exponent", "stribeck", "stribeck_velocity", "load", "temperature", "terms")
"""Keys of terms beside Coulomb and viscous friction, of the arm or of a joint."""
TemperatureFriction = Literal["none", "linear", "full"]


class JointFriction(Section):
    """Exceptions of one joint from the arm's friction model; absent keys follow the arm's."""

    viscous: bool | None = None
    coulomb: bool | None = None
    offset: bool | None = None
    exponent: Exponent | None = None
    stribeck: bool | None = None
    stribeck_velocity: StribeckVelocity | None = None
    load: LoadFriction | None = None
    temperature: TemperatureFriction | None = None
    terms: tuple[str, ...] | None = None
    pair: bool | None = Field(default=None, description="of coupled motors: friction of the joint, too (SR400 eq. 8)")


class Friction(Section):
    """The friction columns of every joint (SR400 eq. 7; ROCR6 eq. 3-4; AUBO eq. 3-6)."""

    model: Literal["auto", "none", "viscous", "coulomb", "coulomb-viscous"] = Field(
        default="auto",
        description="'auto' is coulomb-viscous, and what else `identify` finds in the data; the default, but where a "
        "further term is stated",
    )
    offset: bool = Field(default=True, description="a constant torque per joint, Fo")
    smoothing: NonNegative = Field(default=0.0, description="ε [rad/s] of tanh(q̇/ε) in place of sign(q̇); 0 means sign")
    exponent: Exponent = Field(default=1.0, description="α of |q̇|^α in the viscous column, or 'estimated'")
    stribeck: bool = Field(default=False, description="a column sign(q̇)·exp(−(q̇/stribeck_velocity)²)")
    stribeck_velocity: StribeckVelocity = Field(default="estimated", description="[rad/s or m/s], or 'estimated'")
    load: LoadFriction = Field(default="none", description="growth with the load torque")
    temperature: TemperatureFriction = Field(
        default="none", description="√|q̇| times a function of the temperature: 'linear', or 'full' as AUBO eq. 5"
    )
    terms: tuple[str, ...] = Field(default=(), description="further terms, as --friction calls them")
    joints: dict[str, JointFriction] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _auto_chooses_terms(self) -> Self:
        stated = self.model_fields_set & set(FRICTION_TERMS)
        stated |= {key for joint in self.joints.values() for key in joint.model_fields_set & set(FRICTION_TERMS)}
        if stated and self.model == "auto":
            if "model" in self.model_fields_set:
                raise ValueError(
                    f"auto chooses the terms itself, and '{min(stated)}' is stated: model: coulomb-viscous"
                )
            object.__setattr__(self, "model", "coulomb-viscous")
        return self

    @property
    def base(self) -> str:
        """The model without the terms that `identify` may add."""
        return "coulomb-viscous" if self.model == "auto" else self.model


class TruthLink(Section):
    """Inertial parameters of a simulated link, in the frame of its joint."""

    mass: Positive = Field(description="[kg]")
    com: Place = Field(description="centre of mass [m]")
    inertia: tuple[Finite, Finite, Finite, Finite, Finite, Finite] = Field(
        description="xx, xy, xz, yy, yz, zz about the centre of mass [kg·m²]"
    )


class TruthServo(Section):
    """A simulated position-controlled servo, joint side; torques at the nominal voltage and the ambient temperature."""

    stiffness: Positive = Field(description="gain of the position loop [N·m/rad]")
    gain_d: NonNegative = Field(default=0.0, description="gain against velocity [N·m·s/rad]")
    delay: NonNegative = Field(default=0.0, description="from a command to its effect [s]")
    jitter: NonNegative = Field(default=0.0, description="commands come up to so much later, each anew [s]")
    acceleration: Positive = Field(default=1e7, description="limit of the servo's own profile [rad/s²]")
    torque_limit: Positive = Field(default=1e7, description="of the full duty cycle, or of the current [N·m]")
    no_load_speed: Positive | None = Field(
        default=None,
        description="of the full duty cycle: back-EMF grows with speed, and torque with the supply; none: the current "
        "is controlled [rad/s]",
    )
    stall_current: NonNegative = Field(default=0.0, description="drawn from the supply at the torque limit [A]")
    dead_band: NonNegative = Field(default=0.0, description="position error that has no effect [rad]")
    encoder_step: NonNegative = Field(default=0.0, description="of the position that the loop sees [rad]")
    load_friction: NonNegative = Field(default=0.0, description="share of the torque lost in the gear")
    bias: Finite = Field(default=0.0, description="of the held position against the command [rad]")
    backlash: NonNegative = Field(
        default=0.0, description="play between motor and joint; the encoder is behind it [rad]"
    )
    gear_stiffness: Positive = Field(default=500.0, description="where the play is used up [N·m/rad]")
    joint_friction: Annotated[NonNegative, Field(le=1)] = Field(
        default=0.2, description="share of the Coulomb friction behind the play, on the joint's side"
    )
    resistance_slope: Finite = Field(default=0.0, description="of the winding, relative; copper has 0.00393 [1/K]")
    torque_slope: Finite = Field(default=0.0, description="of torque over current, relative, with the winding [1/K]")
    viscous_slope: Finite = Field(default=0.0, description="of viscous friction, relative, with the housing [1/K]")


class TruthJoint(Section):
    """Friction and motor inertia of a simulated joint, joint side."""

    viscous: NonNegative = Field(default=0.0, description="[N·m·s/rad]")
    coulomb: NonNegative = Field(default=0.0, description="[N·m]")
    offset: Finite = Field(default=0.0, description="[N·m]")
    motor_inertia: NonNegative = Field(default=0.0, description="[kg·m²]")
    alpha: Positive = Field(default=1.0, description="exponent of |q̇| in the viscous term (AUBO eq. 4)")
    temperature: Vector3 = Field(default=(0.0, 0.0, 0.0), description="β1, β2, β3 of AUBO eq. 5, T in kelvin")
    load: NonNegative = Field(default=0.0, description="f_L of AUBO eq. 6 [1/(N·m)]")
    stribeck: NonNegative = Field(default=0.0, description="static friction above Coulomb's [N·m]")
    stribeck_velocity: Positive = Field(default=0.05, description="[rad/s] where the Stribeck term is down to 1/e")
    terms: dict[str, Finite] = Field(default_factory=dict, description="coefficients of further friction terms")
    pre_sliding: Positive = Field(default=5e-5, description="travel [rad] until a joint at rest breaks away")
    servo: TruthServo | None = Field(default=None, description="of a joint that follows commanded positions")
    pair_inertia: NonNegative = Field(default=0.0, description="Iac of a coupled joint [kg·m²]")
    pair_viscous: Finite = Field(default=0.0, description="Fv of a coupled joint, signs as SR400 eq. 8 [N·m·s/rad]")
    pair_coulomb: Finite = Field(default=0.0, description="Fs of a coupled joint, signs as SR400 eq. 8 [N·m]")


class TruthThermal(Section):
    """Heat of every simulated joint: winding, then housing, then the air around it."""

    ambient: Finite = Field(default=23.0, ge=-100.0, description="[°C]")
    copper_loss: dict[str, NonNegative] = Field(
        default_factory=dict, description="joint → copper loss over drive torque squared [W/(N·m)²]"
    )
    winding_capacity: Positive = Field(default=150.0, description="[J/K]")
    housing_capacity: Positive = Field(default=1500.0, description="[J/K]")
    winding_to_housing: Positive = Field(default=2.5, description="[W/K]")
    housing_to_ambient: Positive = Field(default=1.5, description="[W/K]")


class TruthSupply(Section):
    """The supply that all servos of a simulated arm share."""

    nominal: Positive = Field(description="at which torque limits and no-load speeds hold [V]")
    voltage: Positive = Field(description="without load [V]")
    resistance: NonNegative = Field(default=0.0, description="of source and cable [Ω]")


class TruthNoise(Section):
    """Errors of the simulated sensors."""

    rate: Positive = Field(default=500.0, description="[Hz]")
    encoder_resolution: NonNegative = Field(default=0.0, description="[rad] per step, joint side")
    torque_std: dict[str, NonNegative] = Field(default_factory=dict, description="joint → white noise [N·m]")
    ripple_amplitude: dict[str, NonNegative] = Field(default_factory=dict, description="joint → torque ripple [N·m]")
    ripple_per_revolution: Positive = Field(default=100.0, description="ripple periods per joint revolution")
    torque_delay: Annotated[float, Field(ge=0, le=0.1), NotTruthValue] = Field(
        default=0.0, description="delay of current and torque behind the encoder [s]"
    )
    temperature_resolution: NonNegative = Field(default=0.0, description="step of the temperature sensors [K]")


class Truth(Section):
    """True parameters of a simulated arm; absent from a real arm's file."""

    links: dict[str, TruthLink] = Field(default_factory=dict, description="joint → the link that it moves")
    joints: dict[str, TruthJoint] = Field(default_factory=dict)
    thermal: TruthThermal = Field(default_factory=TruthThermal)
    supply: TruthSupply | None = Field(default=None, description="of servos; their nominal voltage without")
    noise: TruthNoise = Field(default_factory=TruthNoise)


class Connection(BaseModel):
    """How to reach the arm on one bus; the keys beside `driver` belong to that driver."""

    model_config = ConfigDict(defer_build=True, extra="allow", frozen=True)

    driver: str


class Robot(Section):
    """A robot file, validated."""

    name: str = Field(min_length=1)
    description: str = ""
    sources: dict[str, str] = Field(default_factory=dict, description="where the numbers come from, by section")
    payload: Annotated[Finite, AfterValidator(within(PAYLOAD))] | None = Field(
        default=None, description="that the data sheet allows at the flange [kg]"
    )
    model: ModelSection
    joints: tuple[JointLimits, ...] = Field(min_length=1, max_length=int(JOINTS.most))
    drives: tuple[Drive, ...] = ()
    friction: Friction = Field(default_factory=Friction)
    known: dict[str, Known] = Field(
        default_factory=dict, description="standard parameter, or total_mass → its value or its range"
    )
    prior: Prior = Field(default_factory=Prior)
    servo: dict[str, dict[str, Finite]] = Field(
        default_factory=dict, description="joint → known parameters of a servo model (docs/servo.md)"
    )
    workspace: Workspace = Field(default_factory=Workspace)
    poses: dict[str, tuple[Angle, ...]] = Field(
        default_factory=dict, description="name → positions of all joints [rad or m], to compare with the pendant"
    )
    truth: Truth = Field(default_factory=Truth)
    connections: dict[str, Connection] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> Self:
        passive = self.passive_names
        driven = tuple(drive.joint for drive in self.drives)
        rows = tuple(row.joint for row in self.model.mdh or ())
        for name in (self.name, *self.joint_names, *passive, *rows, *self.connections):
            if unfit := unfit_name(name):
                raise ValueError(f"the name {name[:LONGEST_NAME]!r} {unfit}; a name is one line of visible text")
        if problems := name_problems(self._names(passive, driven)):
            raise SeveralProblems(problems)
        if contradictions := known_problems(self.known):
            raise SeveralProblems(contradictions)
        for name in driven:
            if name in passive:
                raise ValueError(f"'drives' names joint '{name}', but by 'model.loops' it is passive: it has no motor")
        check_coupling(self.model.coupling, self.joint_names, passive)
        paired = [drive.joint for drive in self.drives if drive.pair_inertia]
        paired += [name for name, friction in self.friction.joints.items() if friction.pair is not None]
        check_pairs(paired, self.model.coupling)
        return self

    def _names(self, passive: tuple[str, ...], driven: tuple[str, ...]) -> JointNames:
        whole: Any = self
        return JointNames(
            joints=self.joint_names,
            rows=None if self.model.mdh is None else tuple(row.joint for row in self.model.mdh),
            passive=passive,
            driven=driven,
            keys=tuple((".".join(path), tuple(reduce(getattr, path, whole))) for path in OF_JOINTS),
            link_keys=(
                ("truth.links", tuple(self.truth.links)),
                ("prior.links", tuple(self.prior.links)),
                *((section, (key,)) for section, key in self.workspace.named_links()),
            ),
            poses=tuple((name, len(pose)) for name, pose in self.poses.items()),
        )

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that motors move, in the order of every array."""
        return tuple(joint.name for joint in self.joints)

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Return whether each of these joints slides."""
        return tuple(joint.sliding for joint in self.joints)

    def column_unit(self, unit: str, columns: Sequence[str]) -> str:
        """The unit of values with a column per joint, by its name, given that of turning joints: "rad or m"."""
        kinds = dict(zip(self.joint_names, self.sliding, strict=True))
        return common_unit(unit, [kinds.get(name, False) for name in columns])

    @property
    def dof(self) -> int:
        """Number of joints that motors move."""
        return len(self.joints)

    @property
    def passive_names(self) -> tuple[str, ...]:
        """Names of the joints without a motor, which `model.loops` makes follow the others."""
        return passive_joints(self.model.loops, self.joint_names)

    def drive(self, joint: str) -> Drive:
        """The drive of a joint; one with unknown gain where the file names none."""
        return next((drive for drive in self.drives if drive.joint == joint), Drive(joint=joint))
