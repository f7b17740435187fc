"""Friction of simulated joints, the AUBO paper's model with a bristle where it is not defined, and their heat.

Sliding, per joint (AUBO eq. 3-6; T in kelvin, τ_L the gravity torque; the Stribeck term is not in the paper):

    F = sign(q̇)·(Fc + Fb·exp(−(q̇/v_b)²) + f_L·τ_L² + Fv·|q̇|^α + √|q̇|·(β1 + β2·T + β3·T⁻³)) + Fo

Equation 3 leaves out the neighbourhood of zero velocity. There a spring with a damper (a bristle, one Maxwell-slip
element) replaces sign(q̇) in the terms that do not vanish at rest: it yields up to the break-away torque and then
slides with it. A joint at rest therefore holds its load without creeping and without a sign that chatters.

Copper loss warms the winding, friction the housing, and the air cools the housing:

    Cw·Ṫw = P_copper − Gwh·(Tw − Th)
    Ch·Ṫh = P_friction + Gwh·(Tw − Th) − Gha·(Th − T_ambient)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.robot.schema import Robot, TruthJoint, TruthThermal
from drivers.core.arrays import FloatArray
from drivers.core.units import ZERO_CELSIUS
from ident.model.dynamic_model import DynamicModel

BRISTLE_DAMPING = 0.5
"""Damping ratio of a joint at rest on its bristle."""

STABLE_STEP = 0.5
"""Largest step × natural frequency of bristle and arm; the integration (leapfrog) is stable below 2."""

STRAIGHT_SPEED = 1e-3
"""Speed [rad/s] below which |q̇|^α and √|q̇| go straight to zero."""

WIDTH = 0.01
"""Width [rad/s] of the smoothed sign: the joint has no bristle, its motor's holds it at rest."""

LOSS_AT_TORQUE_LIMIT = 80.0
"""Copper loss [W] at the torque limit of a joint whose truth gives none: a size, not a measurement."""

UNKNOWN_TORQUE_LIMIT = 100.0
"""Torque limit [N·m] assumed for the copper loss of a joint without one."""


@dataclass(frozen=True)
class FrictionParameters:
    """Friction of n joints, joint side; every array is (n,) but `temperature`."""

    coulomb: FloatArray  # Fc [N·m]
    viscous: FloatArray  # Fv [N·m·(s/rad)^α]
    alpha: FloatArray  # α, without unit
    temperature: FloatArray  # (3, n) β1, β2, β3 of eq. 5, for T in kelvin
    load: FloatArray  # f_L [1/(N·m)]
    offset: FloatArray  # Fo [N·m]
    stribeck: FloatArray  # Fb [N·m]
    stribeck_velocity: FloatArray  # v_b [rad/s]
    pre_sliding: FloatArray  # travel [rad] until break-away


def friction_parameters(robot: Robot, share: float = 1.0) -> FrictionParameters:
    """The friction that the file's truth gives every joint, or a share of it; none for joints that it does not name."""
    joints = [robot.truth.joints.get(name, TruthJoint()) for name in robot.joint_names]
    return FrictionParameters(
        coulomb=share * np.array([joint.coulomb for joint in joints]),
        viscous=share * np.array([joint.viscous for joint in joints]),
        alpha=np.array([joint.alpha for joint in joints]),
        temperature=share * np.array([joint.temperature for joint in joints]).T,
        load=share * np.array([joint.load for joint in joints]),
        offset=share * np.array([joint.offset for joint in joints]),
        stribeck=share * np.array([joint.stribeck for joint in joints]),
        stribeck_velocity=np.array([joint.stribeck_velocity for joint in joints]),
        pre_sliding=np.array([joint.pre_sliding for joint in joints]),
    )


def temperature_factor(parameters: FrictionParameters, celsius: FloatArray) -> FloatArray:
    """β1 + β2·T + β3·T⁻³ (n,) of AUBO eq. 5, T in kelvin."""
    beta1, beta2, beta3 = parameters.temperature
    kelvin = celsius + ZERO_CELSIUS
    return np.asarray(beta1 + beta2 * kelvin + beta3 / kelvin**3)


def steepest_slope(parameters: FrictionParameters, celsius: float) -> FloatArray:
    """Largest slope (n,) [N·m·s/rad] of the terms that grow with velocity, at velocities up to 1 rad/s."""
    power = parameters.viscous * np.maximum(STRAIGHT_SPEED ** (parameters.alpha - 1.0), parameters.alpha)
    root = temperature_factor(parameters, np.full(len(power), celsius)) / np.sqrt(STRAIGHT_SPEED)
    return np.asarray(np.maximum(power + root, 0.0))


def bristle_stiffness(
    parameters: FrictionParameters, inverse_inertias: FloatArray, step: float
) -> tuple[FloatArray, FloatArray]:
    """Stiffness [N·m/rad] and damping [N·m·s/rad] (n,) of the bristles.

    The stiffness gives break-away after the pre-sliding travel, unless the integration needs a softer one, by its step
    [s] and the inverse joint-space inertia (K, n, n) at K postures.
    """
    inertia = 1.0 / np.max(np.diagonal(inverse_inertias, axis1=1, axis2=2), axis=0)
    stiffness = (parameters.coulomb + parameters.stribeck) / parameters.pre_sliding
    stiffness = np.minimum(np.maximum(stiffness, 1.0), inertia * (STABLE_STEP / step) ** 2)
    root = np.sqrt(stiffness)
    frequency = float(np.sqrt(np.max(np.linalg.eigvalsh(root[:, None] * inverse_inertias * root))))
    stiffness *= min(1.0, STABLE_STEP / (step * frequency)) ** 2
    return stiffness, 2.0 * BRISTLE_DAMPING * np.sqrt(stiffness * inertia)


class SimulatedFriction:
    """The friction of n joints in motion: parameters, operating conditions and the bristles' deflection.

    Stiffness [N·m/rad] and damping [N·m·s/rad] of the bristles are (n,).
    """

    def __init__(self, parameters: FrictionParameters, stiffness: FloatArray, damping: FloatArray) -> None:
        self.parameters = parameters
        self.load_matters = bool(np.any(parameters.load))
        self._stiffness, self._damping = stiffness, damping
        self._deflection = np.zeros_like(stiffness)
        self._stribeck_matters = bool(np.any(parameters.stribeck))
        self._temperature_matters = bool(np.any(parameters.temperature))
        self._linear = not self._temperature_matters and bool(np.all(parameters.alpha == 1.0))
        self._factor = np.zeros_like(stiffness)
        self._dry = parameters.coulomb
        self._largest_deflection = self._dry / stiffness

    def set_conditions(self, celsius: FloatArray, load_torque: FloatArray) -> None:
        """Temperature (n,) [°C] and gravity torque (n,) [N·m] from now on."""
        if self._temperature_matters:
            self._factor = temperature_factor(self.parameters, celsius)
        if self.load_matters:
            self._dry = self.parameters.coulomb + self.parameters.load * load_torque**2
            self._largest_deflection = self._dry / self._stiffness

    def torque(self, velocity: FloatArray, travel: FloatArray) -> FloatArray:
        """Friction torque (n,) [N·m] at a velocity (n,), after the joints went on by `travel` (n,) [rad]."""
        parameters, dry, limit = self.parameters, self._dry, self._largest_deflection
        if self._stribeck_matters:
            dry = dry + parameters.stribeck * np.exp(-((velocity / parameters.stribeck_velocity) ** 2))
            limit = dry / self._stiffness
        self._deflection = np.minimum(np.maximum(self._deflection + travel, -limit), limit)
        stuck = self._stiffness * self._deflection + self._damping * velocity
        torque: FloatArray = np.minimum(np.maximum(stuck, -dry), dry) + parameters.offset
        if self._linear:
            return torque + parameters.viscous * velocity
        # |q̇|^α and √|q̇| as slope · |q̇|, with the slope held below STRAIGHT_SPEED, where it would grow without bound.
        floored = np.maximum(np.abs(velocity), STRAIGHT_SPEED)
        slope = parameters.viscous * floored ** (parameters.alpha - 1.0) + self._factor / np.sqrt(floored)
        return torque + np.maximum(slope, 0.0) * velocity


class PairFriction:
    """Fs·sign(q̇) + Fv·q̇ of every coupled joint q̇ = R⁻¹·q̇_m, mapped to the motors by −R⁻ᵀ."""

    def __init__(self, robot: Robot, model: DynamicModel) -> None:
        joints = [robot.truth.joints.get(name, TruthJoint()) for name in robot.joint_names]
        transmission = model.transmission
        present = np.array(transmission.pair_friction, dtype=float)
        self._viscous = present * [joint.pair_viscous for joint in joints]
        self._coulomb = present * [joint.pair_coulomb for joint in joints]
        self._to_joints = np.linalg.inv(transmission.coupling)
        self.present = bool(np.any(self._viscous) or np.any(self._coulomb))

    def torque(self, velocity: FloatArray) -> FloatArray:
        """Friction torque (n,) [N·m] at the motors for their velocities (n,), counted as the motors' own is."""
        joint_velocity = self._to_joints @ velocity
        at_joints = self._viscous * joint_velocity + self._coulomb * np.tanh(joint_velocity / WIDTH)
        return np.asarray(-self._to_joints.T @ at_joints)


def copper_losses(robot: Robot) -> FloatArray:
    """Copper loss over the square of the drive torque, R/K² (n,) [W/(N·m)²]."""
    given = robot.truth.thermal.copper_loss
    limits = [joint.torque or UNKNOWN_TORQUE_LIMIT for joint in robot.joints]
    return np.array(
        [
            given.get(name, LOSS_AT_TORQUE_LIMIT / limit**2)
            for name, limit in zip(robot.joint_names, limits, strict=True)
        ]
    )


def _heat_matrix(thermal: TruthThermal) -> FloatArray:
    across, out = thermal.winding_to_housing, thermal.housing_to_ambient
    return np.array(
        [
            [-across / thermal.winding_capacity, across / thermal.winding_capacity],
            [across / thermal.housing_capacity, -(across + out) / thermal.housing_capacity],
        ]
    )


class JointHeat:
    """Temperatures of n joints, exact for heat that is constant within a step [s] of `advance`.

    Attributes:
        winding: (n,) [°C].
        housing: (n,) [°C], where the temperature sensor sits.
        ambient: [°C].
    """

    def __init__(self, thermal: TruthThermal, dof: int, step: float) -> None:
        from scipy.linalg import expm

        self.ambient = thermal.ambient
        self.winding = np.full(dof, thermal.ambient)
        self.housing = np.full(dof, thermal.ambient)
        matrix = _heat_matrix(thermal)
        self._decay: FloatArray = expm(matrix * step)
        capacities = np.array([thermal.winding_capacity, thermal.housing_capacity])
        self._gain: FloatArray = np.linalg.solve(matrix, self._decay - np.eye(2)) / capacities

    def advance(self, copper: FloatArray, friction: FloatArray) -> None:
        """One step on with copper and friction losses (n,) [W]."""
        above = np.stack([self.winding, self.housing]) - self.ambient
        above = self._decay @ above + self._gain @ np.stack([copper, friction])
        self.winding, self.housing = above + self.ambient
