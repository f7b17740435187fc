"""The identified dynamic model: torque, gravity, friction, inertia matrix, forward dynamics, and its uncertainty.

Torques are those at the joints with a motor, as a recording's `torque` has them: they give power with q̇. Where motors
are coupled, motor torques are R⁻ᵀ times these, R = `Model.coupling` (SR400 eq. 6).
"""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from drivers.errors import DataError, ModelError, UsageError
from drivers.streams import FloatArray
from drivers.units import ZERO_CELSIUS
from ident.estimators.feasible.armature import armature_vector
from ident.estimators.feasible.consistent import ConsistentParameters, consistent_parameters
from ident.model.base_parameters import base_parameters
from ident.model.friction_terms import REFERENCE_TEMPERATURE
from ident.model.inverse_dynamics import InverseDynamics
from ident.model.parameters import FRICTION_KINDS
from ident.model.presliding import dry_friction
from ident.model.regressor import CHUNK, regressor
from ident.regression.observability import describe
from ident.regression.pruning import pruned_covariance
from ident.result.arrays import outward, samples
from ident.result.delivered import Parameters, delivered_parameters
from ident.result.schema import Result, read_result
from ident.result.simulated_motion import STEP, Controller, SimulatedMotion, simulated_motion
from ident.result.stored_model import StoredModel, stored_estimate, stored_model
from ident.result.tables import Table, table_of_rows

if TYPE_CHECKING:
    from ident.export.arm import ExportedArm
    from ident.export.export import Export

TorquePart = Literal["inertial", "coriolis", "gravity", "friction"]
"""Parts that a torque is the sum of."""

KINDS: dict[Parameters, str] = {
    "consistent": "the base parameters of bodies that can exist",
    "full": "all base parameters as estimated",
    "essential": "the significant base parameters, the others 0",
}
"""What the models hold, for comments in what they write."""

HOTTEST = 250.0
"""[°C] No joint of an arm is warmer, or as cold; a larger number is in another unit."""

ROUNDING = 1e-9
"""Entries of a regressor below this are rounding: sines of 180° and the like."""


class Model:
    """The identified dynamic model of an arm; made by `load_model`, or `result.model` after `identify`.

    Arrays are (N, n), time first, joints last in the order of `joint_names`; a single sample (n,) gives (n,). Positions
    `q` in rad, velocities `dq` in rad/s, accelerations `ddq` in rad/s², torques in N·m at the joints (of prismatic
    joints: m, m/s, m/s², N). In loops, only the joints with a motor count; the others follow.

    The equation is τ = M(q)·q̈ + C(q, q̇)·q̇ + g(q) + friction(q̇), linear in the base parameters (SR400 eq. 13). Base
    parameters are combinations of masses and inertias: every term above follows from them, the masses of single links
    do not. An estimate that is far from the truth can have an inertia matrix that is not positive definite.

    One model is for one thread at a time.

    Attributes:
        result: what the identification wrote.
        kind: "consistent", of bodies that can exist; "full", all base parameters as estimated; or "essential", the
            significant ones, the others 0.

    Example:
        >>> import dynid
        >>> run = dynid.simulate("ur5e", duration=10.0, seed=1)
        >>> model = dynid.identify(run).model
        >>> q, dq, ddq = [0.1] * 6, [0.2] * 6, [0.5] * 6
        >>> model.torque(q, dq, ddq).shape, model.mass_matrix(q).shape
        ((6,), (6, 6))
        >>> model.torque([q] * 100, [dq] * 100, [ddq] * 100).shape
        (100, 6)
    """

    def __init__(self, result: Result, kind: Parameters | None = None) -> None:
        """Build the model of a result.

        Args:
            result: of an identification or a merge.
            kind: which of its parameters; None takes the consistent ones where there are any, else the full ones.

        Raises:
            ModelError: the recordings identify only some of the base parameters.
            ResultFileError: parts of the result do not belong together.
        """
        self.result: Result = result
        self.kind: Parameters = delivered_parameters(result.consistent) if kind is None else kind
        self._stored = stored_model(result)
        self._check_whole_arm(self._stored)
        base = self._base = self._stored.base
        entries = {parameter.name: parameter for parameter in result.base_parameters}
        ordered = self._entries = [entries[name] for name in base.names]
        if self.kind == "consistent":
            if result.consistent is None:
                raise ModelError(
                    "this result holds no physically consistent parameters",
                    where=result.robot,
                    hint='identify again, or take parameters="full"',
                )
            values = [result.consistent.base_values.get(name, np.nan) for name in base.names]
        elif self.kind == "full":
            values = [np.nan if entry.value is None else entry.value for entry in ordered]
        else:
            values = [0.0 if entry.essential_value is None else entry.essential_value for entry in ordered]
        self._values: FloatArray = np.array(values, dtype=np.float64)
        self._missing = [int(index) for index in np.flatnonzero(np.isnan(self._values))]
        self._dynamics = InverseDynamics(
            self._stored.model,
            base,
            np.nan_to_num(self._values),
            self._standard() if self.kind == "consistent" else None,
            self.armature,
        )

    def _standard(self) -> FloatArray | None:
        """Standard parameters (p,) of the consistent model; None where the result does not hold them all."""
        held = () if self.result.consistent is None else self.result.consistent.parameters
        values = {parameter.name: parameter.value for parameter in held}
        names = [parameter.name for parameter in self._stored.model.parameters]
        return np.array([values[name] for name in names]) if set(names) <= set(values) else None

    def _refuse_confounded(self, part: str) -> None:
        """Refuse a part of the torque that the base parameters do not tell from another."""
        confounded = self._dynamics.confounded
        if confounded:
            values = [
                f"{value:.4g} {entry.unit}"
                for entry, value in zip(self._entries, self._values, strict=True)
                if entry.kind == "offset" and entry.joint in confounded
            ]
            raise ModelError(
                f"{part} is not known: weight and offset of {', '.join(confounded)} act alike, together "
                f"{', '.join(values)}, and no motion separates them",
                where=f"{self.name}, {self.kind} model",
                hint='parameters="consistent" (the default) splits them by its bodies; torque() needs no split',
            )

    @staticmethod
    def _check_whole_arm(stored: StoredModel) -> None:
        if stored.base.count == base_parameters(stored.model).count:
            return
        texts = "; ".join(describe(stored.model, experiment) for experiment in stored.experiments)
        raise ModelError(
            f"the recordings identify only some of the base parameters ({texts}), not the whole arm",
            where=stored.robot_file.robot.name,
            hint="merge it with an experiment that identifies the rest; validate() works with a partial model",
        )

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.result.robot

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names (n,) of the joints with a motor, in the order of every array's columns."""
        return self._stored.model.joint_names

    @property
    def dof(self) -> int:
        """Number n of joints with a motor."""
        return self._stored.model.dof

    def require_temperature(self, kelvin: FloatArray | None, where: str) -> None:
        """Refuse joint temperatures (N, n) [K] that lack those of joints whose friction depends on them.

        Raises:
            DataError: names the joints.
        """
        self._stored.model.require_temperature(None if kelvin is None else kelvin.T, where)

    @property
    def coupling(self) -> FloatArray:
        """(n, n) R of q_motor = R·q_joint; motor torques are R⁻ᵀ times joint torques. The identity in most arms."""
        return self._dynamics.coupling.copy()

    @property
    def parameters(self) -> Table:
        """The base parameters (b,) in the order of the regressor's columns: value, σ, unit, expression."""
        entries = {parameter.name: parameter for parameter in self.result.base_parameters}
        deviations = self._parameter_std()
        rows = [
            (
                name,
                None if np.isnan(value) else float(value),
                deviations[name],
                entries[name].unit,
                entries[name].kind,
                entries[name].joint,
                entries[name].expression,
            )
            for name, value in zip(self._base.names, self._values, strict=True)
        ]
        headings = [(name, "") for name in ("name", "value", "std", "unit", "kind", "joint", "expression")]
        return table_of_rows(f"Base parameters of {self.name} ({self.kind} model)", headings, rows)

    @property
    def armature(self) -> FloatArray:
        """Inertia (n,) [kg·m²] of motors whose torque sensor sits behind the gear; 0 of the others.

        `simulate` and `export_mjcf` move it; `torque` and `mass_matrix` have none of it. A recorded torque τ of such a
        sensor drives a simulation as τ + armature·q̈. From the robot file (`drives[].armature`), or assumed.
        """
        consistent = self.result.consistent
        return armature_vector(self._stored.model, [] if consistent is None else consistent.armature)

    def _parameter_std(self) -> dict[str, float | None]:
        entries = self.result.base_parameters
        if self.kind == "full":
            return {entry.name: entry.std for entry in entries}
        if self.kind == "essential":
            return {entry.name: entry.essential_std for entry in entries}
        return dict(zip(self._base.names, np.sqrt(np.diag(self._consistent.base_covariance)).tolist(), strict=True))

    @cached_property
    def _consistent(self) -> ConsistentParameters:
        """The consistent parameters found again, with their covariance, which the file does not hold."""
        stored = self._stored
        return consistent_parameters(
            stored.model, self._base, stored_estimate(self.result, self._base), stored.robot_file
        )

    def torque(
        self, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike, temperature: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Joint torque τ [N·m] of a motion, friction and motor inertia included; shape of `q`.

        Args:
            q: (N, n) or (n,) positions [rad].
            dq: the same of velocities [rad/s].
            ddq: the same of accelerations [rad/s²].
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
            ModelError: a parameter without a value acts on this motion.
        """
        (position, velocity, acceleration), single = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        motion = position, velocity, acceleration
        kelvin = self._kelvin(temperature, position.shape[1])
        if self._missing:
            self._require(self._columns(*motion, kelvin))
        return outward(self._dynamics.torque(*motion, kelvin), single=single)

    @property
    def slides_gradually(self) -> bool:
        """Whether some joint has a pre-sliding travel."""
        return bool(self._stored.model.presliding)

    def presliding_torque(self, q: npt.ArrayLike, dq: npt.ArrayLike, rate: float) -> FloatArray:
        """What presliding adds to `torque` along a motion in time [N·m]; shape of `q`.

        Near a velocity reversal, dry friction follows Dahl's model in place of sign(q̇) where `identify` found a travel;
        0 elsewhere. It slides at the first motion.

        Args:
            q: (N, n) positions on a uniform grid of time [rad].
            dq: the same of velocities [rad/s].
            rate: [Hz].

        Raises:
            DataError: a wrong shape, or a value is not finite.
        """
        travels = dict(self._stored.model.presliding)
        (position, velocity), single = samples(self.joint_names, q=q, dq=dq)
        dry = dry_friction(self._stored.model, self._base, self._values)
        change = self._dynamics.coupling.T @ dry.torque_change(travels, position, velocity, rate)
        return outward(change, single=single)

    def gravity(self, q: npt.ArrayLike) -> FloatArray:
        """Gravity's part g(q) of the torque [N·m]; shape of `q`.

        Args:
            q: (N, n) or (n,) positions [rad].

        Raises:
            DataError: a wrong shape, or a value is not finite.
            ModelError: a parameter without a value acts at these positions; or, of the full and the essential model,
                a joint slides along gravity, so that its weight and its offset are one parameter.
        """
        self._refuse_confounded("gravity")
        (position,), single = samples(self.joint_names, q=q)
        return outward(self._gravity(position), single=single)

    def friction(
        self, dq: npt.ArrayLike, q: npt.ArrayLike | None = None, temperature: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Friction's part of the torque [N·m], constant offsets included; shape of `dq`.

        Friction of motors and coupled joints; joints without a motor are taken as free of it, so that friction depends
        on the position only through the load torque, and only where the model has load-dependent friction.

        Args:
            dq: (N, n) or (n,) velocities [rad/s].
            q: the same of positions [rad], where the friction depends on the load.
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: a wrong shape, a value is not finite, or positions or a temperature are missing.
            ModelError: the friction of a joint that moves has no value; or, of the full and the essential model, a
                joint slides along gravity, so that its weight and its offset are one parameter.
        """
        self._refuse_confounded("friction")
        if q is None and self._stored.model.needs_load_torque:
            raise DataError("positions are missing: the friction depends on the load", where="q", hint="give q=")
        given = {"dq": dq} if q is None else {"dq": dq, "q": q}
        (velocity, *others), single = samples(self.joint_names, **given)
        position = others[0] if others else np.zeros_like(velocity)
        kelvin = self._kelvin(temperature, velocity.shape[1])
        return outward(self._friction(position, velocity, kelvin), single=single)

    @property
    def confounded(self) -> tuple[str, ...]:
        """Names of the joints whose weight and offset are one parameter of this model: those that slide along gravity.

        The consistent model has none, for its bodies have weights; the split is then as good as their prior.
        """
        return self._dynamics.confounded

    def torque_parts(
        self, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike, temperature: npt.ArrayLike | None = None
    ) -> dict[TorquePart, FloatArray]:
        """The parts of `torque` that add up to it, each in the shape of `q`: inertial, coriolis, gravity, friction.

        The weight of joints that are `confounded` counts as friction, with their offset.

        Args:
            q: (N, n) or (n,) positions [rad].
            dq: the same of velocities [rad/s].
            ddq: the same of accelerations [rad/s²].
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
            ModelError: a parameter without a value acts on this motion.
        """
        total = self.torque(q, dq, ddq, temperature)
        (position, velocity), single = samples(self.joint_names, q=q, dq=dq)
        kelvin = self._kelvin(temperature, position.shape[1])
        parts: dict[TorquePart, FloatArray] = {
            "coriolis": self._coriolis(position, velocity),
            "gravity": self._gravity(position),
            "friction": self._friction(position, velocity, kelvin),
        }
        shaped = {name: outward(values, single=single) for name, values in parts.items()}
        return {"inertial": np.asarray(total - sum(shaped.values())), **shaped}

    def coriolis(self, q: npt.ArrayLike, dq: npt.ArrayLike) -> FloatArray:
        """The vector C(q, q̇)·q̇ of Coriolis and centrifugal torques [N·m], not the matrix C; shape of `q`.

        Args:
            q: (N, n) or (n,) positions [rad].
            dq: the same of velocities [rad/s].

        Raises:
            DataError: shapes differ, or a value is not finite.
            ModelError: a parameter without a value acts on this motion.
        """
        (position, velocity), single = samples(self.joint_names, q=q, dq=dq)
        return outward(self._coriolis(position, velocity), single=single)

    def mass_matrix(self, q: npt.ArrayLike) -> FloatArray:
        """Joint-space inertia matrices M(q) [kg·m²], (N, n, n) or (n, n), motor inertia included.

        Symmetric, but of an estimate not always positive definite; `forward_dynamics` refuses where it is not.

        Args:
            q: (N, n) or (n,) positions [rad].

        Raises:
            DataError: a wrong shape, or a value is not finite.
            ModelError: a parameter without a value acts at these positions.
        """
        (position,), single = samples(self.joint_names, q=q)
        matrices = self._inertia(position)
        return matrices[0] if single else matrices

    def forward_dynamics(
        self, q: npt.ArrayLike, dq: npt.ArrayLike, tau: npt.ArrayLike, temperature: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Accelerations q̈ [rad/s²] that joint torques cause; inverts `torque`; shape of `q`.

        Args:
            q: (N, n) or (n,) positions [rad].
            dq: the same of velocities [rad/s].
            tau: the same of joint torques [N·m].
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
            ModelError: the inertia matrix is not positive definite there, which leaves accelerations undefined; or a
                parameter without a value acts on this motion.
        """
        (position, velocity, torque), single = samples(self.joint_names, q=q, dq=dq, tau=tau)
        kelvin = self._kelvin(temperature, position.shape[1])
        matrices = self._inertia(position)
        self._check_positive(matrices)
        if self._missing:
            self._require(self._columns(position, velocity, np.zeros_like(velocity), kelvin))
        driving = torque - self._dynamics.torque(position, velocity, np.zeros_like(velocity), kelvin)
        acceleration = np.asarray(np.linalg.solve(matrices, driving.T[..., None])[..., 0].T, dtype=np.float64)
        return outward(acceleration, single=single)

    def simulate(
        self,
        q0: npt.ArrayLike,
        dq0: npt.ArrayLike,
        torque: npt.ArrayLike | Controller | None,
        duration: float,
        *,
        step: float = STEP,
        temperature: npt.ArrayLike | None = None,
    ) -> SimulatedMotion:
        """Simulate the arm forward in time, with friction, closed loops and coupled motors.

        Dry friction is a set-valued force (Moreau's midpoint rule, `ident.simulation.time_stepping`): a joint stays at
        rest until the torque breaks it away. A Coulomb column with smoothing is simulated as one without. Joint limits,
        floor and collisions are not.

        Args:
            q0: (n,) positions at the start [rad].
            dq0: (n,) velocities at the start [rad/s].
            torque: (n,) constant joint torques [N·m]; (N, n), evenly spaced from start to end, interpolated; a
                controller (t, q, dq) → (n,), asked once per step; None for no torque. They drive the motors: see
                `armature` where sensors sit behind the gears.
            duration: [s].
            step: [s]; the error grows with its square, at reversals and stops in proportion to it.
            temperature: (n,) constant, of the joints [°C], where the friction depends on it.

        Raises:
            DataError: a wrong shape, a value is not finite, or a temperature is missing.
            UsageError: duration or step is not positive.
            ModelError: the model cannot be simulated (negative Coulomb friction, a parameter without a value, an
                inertia matrix that is not positive definite), a loop does not close, or the motion diverges.

        Example:
            >>> import dynid
            >>> model = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1)).model
            >>> goal = model.simulate([0.0] * 6, [0.0] * 6, lambda t, q, dq: -200 * q - 40 * dq, 0.5)
            >>> goal.position.shape
            (501, 6)
        """
        if self._missing:
            raise ModelError(
                f"{', '.join(self._base.names[index] for index in self._missing)} has no value: the recording did not "
                "excite it",
                where=self.name,
                hint='simulate the physically consistent model (parameters="consistent", the default)',
            )
        kelvin = self._kelvin(temperature, 1)
        return simulated_motion(
            self._dynamics, q0, dq0, torque, duration, step, None if kelvin is None else kelvin[:, 0]
        )

    def regressor(
        self, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike, temperature: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Regressor Y(q, q̇, q̈), (N, n, b) or (n, b): torque = Y @ parameters["value"].

        A column has the unit of N·m over that of its parameter; columns are in the order of `parameters`.

        Args:
            q: (N, n) or (n,) positions [rad].
            dq: the same of velocities [rad/s].
            ddq: the same of accelerations [rad/s²].
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
        """
        (position, velocity, acceleration), single = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        motion = position, velocity, acceleration
        kelvin = self._kelvin(temperature, position.shape[1])
        rows = np.ascontiguousarray(np.moveaxis(self._columns(*motion, kelvin), -1, 0))
        return rows[0] if single else rows

    def torque_std(
        self, q: npt.ArrayLike, dq: npt.ArrayLike, ddq: npt.ArrayLike, temperature: npt.ArrayLike | None = None
    ) -> FloatArray:
        """Standard deviation σ [N·m] of `torque` from that of the parameters, √diag(Y·Σ·Yᵀ); shape of `q`.

        Σ is the stored covariance, corrected for autocorrelated residuals. That of the essential model is the full
        one's plus the outer product of what the pruning changed, since the dropped parameters are not exactly 0. σ is
        inf where a parameter of unknown variance acts. What the model lacks altogether is not in it: see `validation`
        for that.

        Args:
            q: (N, n) or (n,) positions [rad].
            dq: the same of velocities [rad/s].
            ddq: the same of accelerations [rad/s²].
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
            ModelError: a parameter without a value acts on this motion.
            ResultFileError: the result holds no covariance.
        """
        (position, velocity, acceleration), single = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        kelvin = self._kelvin(temperature, position.shape[1])
        sure, root, unsure = self._deviations
        deviations = np.empty_like(position)
        for start in range(0, deviations.shape[1], CHUNK):
            chunk = slice(start, start + CHUNK)
            heat = None if kelvin is None else kelvin[:, chunk]
            columns = self._columns(position[:, chunk], velocity[:, chunk], acceleration[:, chunk], heat)
            self._require(columns)
            deviations[:, chunk] = np.linalg.norm(np.swapaxes(columns[:, sure], 1, 2) @ root, axis=-1)
            if len(unsure):
                acting = np.any(np.abs(columns[:, unsure]) > ROUNDING, axis=1)
                deviations[:, chunk] = np.where(acting, np.inf, deviations[:, chunk])
        return outward(deviations, single=single)

    def to_pinocchio(self) -> Any:
        """A `pinocchio.Model` of the arm: bodies, armature, damping, dry friction, limits, gravity.

        `pin.rnea` gives the links' and the motor inertias' torques; friction is left to the user of Pinocchio. Closed
        loops are open in it, with free joints; coupled motors and offsets are not in it.

        Raises:
            UsageError: these are not the consistent parameters.
            ModelError: some friction was not identified.
        """
        from ident.export.pinocchio_arm import pinocchio_arm

        return pinocchio_arm(self._exported)

    def export_urdf(
        self, path: str | PathLike[str], *, into: str | PathLike[str] | None = None, force: bool = False
    ) -> Export:
        """Write a URDF: the robot's own with new inertials, friction and limits, or a complete one from MDH.

        It is read again by Pinocchio (and MuJoCo, if installed), compared with `torque`, and simulated for 5 s.

        Args:
            path: of the file.
            into: another URDF of the same arm, with meshes for instance, to put the model in.
            force: whether to overwrite.

        Raises:
            UsageError: the file exists or cannot be written, or these are not the consistent parameters.
            RobotFileError: `into` is not a URDF of this arm.
            ModelError: some friction was not identified, or the file reads back as another model.
        """
        from ident.export.export import export_urdf

        return export_urdf(self._exported, path, into=into, force=force)

    def export_mjcf(self, path: str | PathLike[str], *, force: bool = False) -> Export:
        """Write an MJCF with motor inertia (`armature` included), friction, offsets, coupled motors and closed loops.

        Where MuJoCo is installed it is read again, compared with `torque`, and simulated for 5 s.

        Args:
            path: of the file.
            force: whether to overwrite.

        Raises:
            UsageError: the file exists or cannot be written, or these are not the consistent parameters.
            ModelError: some friction was not identified, or the file reads back as another model.
        """
        from ident.export.arm import with_armature
        from ident.export.export import export_mjcf

        return export_mjcf(with_armature(self._exported, self.armature), path, force=force)

    def export_ros2_inertial(self, path: str | PathLike[str], *, force: bool = False) -> Export:
        """Write the links' bodies as YAML in the form of Universal_Robots_ROS2_Description's `inertia_parameters`.

        Args:
            path: of the file.
            force: whether to overwrite.

        Raises:
            UsageError: the file exists or cannot be written, or these are not the consistent parameters.
            ModelError: some friction was not identified.
        """
        from ident.export.export import export_ros2_inertial

        return export_ros2_inertial(self._exported, path, force=force)

    def export_c(
        self, path: str | PathLike[str], *, real: Literal["double", "float"] = "double", force: bool = False
    ) -> Export:
        """Write C99 source of this model: torque and its parts, inertia matrix, forward dynamics, payload, regressor.

        Straight-line code for this arm and these parameters, without allocation, with a self-test. The header says
        where the parameters come from: versions, recordings with their hashes, held-out error.

        Args:
            path: of both files, without suffix: `arm` gives arm.h and arm.c.
            real: type of the arithmetic.
            force: whether to overwrite.

        Raises:
            UsageError: a file exists, cannot be written, or has a name that C cannot include.
            ModelError: a parameter was not identified, or loops of the arm are solved numerically.
        """
        from ident.export.c_code.source import Parameter
        from ident.export.c_code.write import write_c
        from ident.result.origin import origin_lines

        if self._missing:
            raise ModelError(
                f"{', '.join(self._base.names[index] for index in self._missing)} has no value: the recording did not "
                "excite it",
                where=self.name,
                hint='record a motion that does, or load_model(…, parameters="essential"), which takes it as 0',
            )
        if self.kind == "consistent":
            _ = self._exported  # refuses friction that no recording determined
        deviations = self._known_std()
        parameters = [
            Parameter(entry.name, float(value), deviations[entry.name], entry.unit, entry.expression)
            for entry, value in zip(self._entries, self._values, strict=True)
        ]
        return write_c(
            self._dynamics,
            path,
            real=real,
            kind=KINDS[self.kind],
            origin=origin_lines(self.result, self.kind),
            parameters=parameters,
            force=force,
        )

    def _known_std(self) -> dict[str, float | None]:
        """Standard deviations by name; None where a result does not hold what they follow from."""
        if self.kind == "consistent" and self.result.estimate is None:
            return dict.fromkeys(self._base.names)
        return {
            name: std if std is not None and np.isfinite(std) else None for name, std in self._parameter_std().items()
        }

    @cached_property
    def _exported(self) -> ExportedArm:
        from ident.result.exported import exported_arm

        return exported_arm(self.result, self.kind, self._stored, self._dynamics)

    def __repr__(self) -> str:
        return f"<dynid.Model {self.name}, {self.dof} joints, {self._base.count} base parameters, {self.kind}>"

    def _kelvin(self, temperature: npt.ArrayLike | None, count: int) -> FloatArray | None:
        """Temperatures (n, N) [K] of `count` samples, as given in °C; None where none are given nor needed."""
        model, kelvin = self._stored.model, None
        if temperature is not None:
            try:
                celsius = np.broadcast_to(np.asarray(temperature, dtype=np.float64), (count, self.dof))
            except (TypeError, ValueError) as error:
                raise DataError(
                    f"is not ({self.dof},) or ({count}, {self.dof}) numbers", where="temperature", hint="in °C"
                ) from error
            if np.any(np.abs(celsius) > HOTTEST):
                raise DataError(f"is not within ±{HOTTEST:g} °C", where="temperature")
            kelvin = celsius.T + ZERO_CELSIUS
        model.require_temperature(kelvin, self.name)
        return kelvin

    def _columns(
        self,
        position: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        kelvin: FloatArray | None = None,
    ) -> FloatArray:
        """Joint regressor (n, b, N); the kernel's rows are the motors'. At rest no temperature is needed."""
        heat = np.full_like(position, REFERENCE_TEMPERATURE) if kelvin is None else kelvin
        rows = regressor(self._stored.model, position, velocity, acceleration, self._base.columns, heat)
        if self._stored.model.transmission is None:
            return rows
        return np.asarray(np.einsum("mn,mbN->nbN", self._dynamics.coupling, rows))

    def _gravity(self, position: FloatArray) -> FloatArray:
        still = np.zeros_like(position)
        if self._missing:
            self._require(self._columns(position, still, still), kinds=("inertial",))
        return self._dynamics.gravity(position)

    def _friction(self, position: FloatArray, velocity: FloatArray, kelvin: FloatArray | None) -> FloatArray:
        if self._missing:
            columns = self._columns(position, velocity, np.zeros_like(velocity), kelvin)
            self._require(columns, kinds=(*FRICTION_KINDS, "coupling"))
        return self._dynamics.friction(velocity, position, kelvin)

    def _coriolis(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        still = np.zeros_like(position)
        if self._missing:
            moving = self._columns(position, velocity, still) - self._columns(position, still, still)
            self._require(moving, kinds=("inertial",))
        links = self._dynamics.links
        return np.asarray(links(position, velocity, still) - links(position, still, still))

    def _inertia(self, position: FloatArray) -> FloatArray:
        if self._missing:
            still = np.zeros_like(position)
            resting = self._columns(position, still, still)
            for joint in range(self.dof):
                unit = np.zeros_like(position)
                unit[joint] = 1.0
                self._require(self._columns(position, still, unit) - resting)
        return self._dynamics.inertia(position)

    def _require(self, columns: FloatArray, kinds: tuple[str, ...] = ()) -> None:
        """Refuse a motion that needs a parameter without a value: columns (n, b, N) that act on it."""
        wanted = [index for index in self._missing if not kinds or self._base.kinds[index] in kinds]
        needed = [self._base.names[i] for i in wanted if np.any(np.abs(columns[:, i]) > ROUNDING)]
        if needed:
            raise ModelError(
                f"{', '.join(needed)} acts on this motion and has no value: the recording did not excite it",
                where=self.name,
                hint='record a motion that does, or load_model(…, parameters="essential"), which takes it as 0',
            )

    def _check_positive(self, matrices: FloatArray) -> None:
        smallest = np.linalg.eigvalsh(matrices)[:, 0]
        bad = np.flatnonzero(~(smallest > 0.0))
        if len(bad):
            place = (
                f"sample {bad[0]} and {len(bad) - 1} more of {len(smallest)}" if len(bad) > 1 else f"sample {bad[0]}"
            )
            raise ModelError(
                f"the inertia matrix is not positive definite (smallest eigenvalue {smallest[bad[0]]:.3g} kg·m² at "
                f"{place}), which leaves accelerations undefined",
                where=f"{self.name}, {self.kind} model",
                hint="record a longer or stronger motion, or leave out motor inertia where the torque sensors sit "
                "behind the gears",
            )

    @cached_property
    def _deviations(self) -> tuple[list[int], FloatArray, list[int]]:
        """Parameters of known variance, a root (a, a) of their covariance, and parameters of unknown variance."""
        active, covariance = self._covariance()
        known = np.isfinite(np.diag(covariance))
        powers, axes = np.linalg.eigh(covariance[np.ix_(known, known)])
        sure = [index for index, there in zip(active, known, strict=True) if there]
        unsure = [index for index in range(self._base.count) if index not in sure]
        return sure, axes * np.sqrt(np.clip(powers, 0.0, None)), unsure

    def _covariance(self) -> tuple[tuple[int, ...], FloatArray]:
        """Base parameters that were estimated, and their covariance (of the essential model its mean square error)."""
        if self.kind == "consistent":
            return tuple(range(self._base.count)), self._consistent.base_covariance
        estimate = stored_estimate(self.result, self._base)
        if self.kind == "full":
            return estimate.active, estimate.covariance
        difference = self._values[list(estimate.active)] - estimate.values
        return estimate.active, pruned_covariance(estimate.covariance, difference)


def result_path(path: str | PathLike[str]) -> Path:
    """The result.json that a path means: itself, or the one in a folder that `identify` wrote."""
    given = Path(path)
    return given / "result.json" if given.is_dir() else given


def load_model(path: str | PathLike[str], parameters: Parameters | None = None) -> Model:
    """The model that `identify` wrote.

    Args:
        path: a folder that `identify`, `merge` or `result.save` wrote, or its result.json.
        parameters: "consistent", those of bodies that can exist, with an inertia matrix that is always positive
            definite; "full", every base parameter as estimated; "essential", the significant ones, the others 0. None
            takes the model that the verdict grades: consistent where there is one, else full.

    Raises:
        ResultFileError: no such file, or it is no result.
        UsageError: there are no such parameters in it.
        ModelError: the recordings identify only some of the base parameters.

    Example:
        >>> import dynid, tempfile
        >>> run = dynid.simulate("ur5e", duration=10.0, seed=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     dynid.identify(run).save(folder)
        ...     model = dynid.load_model(folder, parameters="essential")
        >>> model.gravity([0.0] * 6).shape
        (6,)
    """
    result = read_result(result_path(path))
    if parameters is not None and parameters not in get_args(Parameters):
        raise UsageError(f"there are no '{parameters}' parameters", hint="consistent, full or essential")
    return Model(result, parameters)
