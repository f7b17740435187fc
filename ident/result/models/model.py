"""The identified dynamic model: torque, gravity, friction, inertia matrix, forward dynamics, and its uncertainty.

Torques are those at the joints with a motor, as a recording's `torque` has them: they give power with q̇. Where motors
are coupled, motor torques are R⁻ᵀ times these, R = `Model.coupling` (SR400 eq. 6).
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from daq.plotting import Backend, LinePanel, line_figure
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, ModelError, UsageError
from ident.friction.table import FRICTION_KINDS
from ident.model.presliding import dry_friction
from ident.model.regressor import SAMPLES_AT_ONCE
from ident.result.arrays import outward, samples
from ident.result.models.exported_model import ExportedModel
from ident.result.models.model_parameters import REGRESSOR_ROUNDING
from ident.result.models.simulated_motion import DEFAULT_STEP, Controller, SimulatedMotion, simulated_motion

TorquePart = Literal["inertial", "coriolis", "gravity", "friction"]
"""Parts that a torque is the sum of."""


class Model(ExportedModel):
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
        >>> model.torque([q] * 100, [dq] * 100, [ddq] * 100).shape, model.torque([q] * 100).shape
        ((100, 6), (100, 6))
    """

    def torque(
        self,
        q: npt.ArrayLike,
        dq: npt.ArrayLike | None = None,
        ddq: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Joint torque τ [N·m] of a motion, friction and motor inertia included; shape of the longest argument.

        Args:
            q: (N, n) or (n,) positions [rad]; (n,) beside (N, n) stands for all N samples.
            dq: the same of velocities [rad/s]; 0 where None.
            ddq: the same of accelerations [rad/s²]; 0 where None.
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
        """Return whether some joint has a pre-sliding travel."""
        return bool(self._stored.model.presliding)

    def presliding_torque(self, q: npt.ArrayLike, dq: npt.ArrayLike, rate: float) -> FloatArray:
        """Return what presliding adds to `torque` along a motion in time [N·m]; shape of `q`.

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
        on the position only where the model has friction of the load or of the position, or torque ripple.

        Args:
            dq: (N, n) or (n,) velocities [rad/s].
            q: the same of positions [rad], where the friction depends on them or on the load.
            temperature: (N, n) or (n,) of the joints [°C], where the friction depends on it.

        Raises:
            DataError: a wrong shape, a value is not finite, or positions or a temperature are missing.
            ModelError: the friction of a joint that moves has no value; or, of the full and the essential model, a
                joint slides along gravity, so that its weight and its offset are one parameter.
        """
        self._refuse_confounded("friction")
        if q is None and self._stored.model.needs_position:
            raise DataError("positions are missing: the friction depends on them", where="q", hint="give q=")
        given = {"dq": dq} if q is None else {"dq": dq, "q": q}
        (velocity, *others), single = samples(self.joint_names, **given)
        position = others[0] if others else np.zeros_like(velocity)
        kelvin = self._kelvin(temperature, velocity.shape[1])
        return outward(self._friction(position, velocity, kelvin), single=single)

    def torque_parts(
        self,
        q: npt.ArrayLike,
        dq: npt.ArrayLike | None = None,
        ddq: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> dict[TorquePart, FloatArray]:
        """The parts of `torque` that add up to it, each in the shape of `q`: inertial, coriolis, gravity, friction.

        The weight of joints that are `confounded` counts as friction, with their offset. Arguments and errors are
        those of `torque`.
        """
        total = self.torque(q, dq, ddq, temperature)
        (position, velocity, _), single = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        kelvin = self._kelvin(temperature, position.shape[1])
        parts: dict[TorquePart, FloatArray] = {
            "coriolis": self._coriolis(position, velocity),
            "gravity": self._gravity(position),
            "friction": self._friction(position, velocity, kelvin),
        }
        shaped = {name: outward(values, single=single) for name, values in parts.items()}
        return {"inertial": np.asarray(total - sum(shaped.values())), **shaped}

    def friction_curve(
        self,
        *joints: str,
        speed: float | None = None,
        q: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
        backend: Backend = "plotly",
    ) -> Any:
        """Friction torque of each joint over its velocity, the others at rest, as a figure.

        Args:
            joints: names of those to show; all where none is named.
            speed: greatest velocity shown [rad/s or m/s]; the robot file's limit of each joint where None.
            q: (n,) positions [rad], where the friction depends on them or on the load.
            temperature: (n,) of the joints [°C], where the friction depends on it.
            backend: "plotly" gives a `plotly.graph_objects.Figure`, "matplotlib" a `matplotlib.figure.Figure`.

        Raises:
            UsageError: there is no such joint, or the backend does not exist or is not installed.
            DataError, ModelError: as `friction`.

        Example:
            >>> import dynid
            >>> model = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1)).model
            >>> [axis.title.text for axis in model.friction_curve("elbow_joint").select_yaxes()]
            ['N·m']
        """
        for joint in joints:
            if joint not in self.joint_names:
                raise UsageError(f"there is no joint '{joint}'", hint=f"joints: {', '.join(self.joint_names)}")
        panels = []
        for joint, limits in zip(self.joint_names, self._stored.robot_file.robot.joints, strict=True):
            if joints and joint not in joints:
                continue
            side = (speed or limits.velocity) * np.linspace(0.0, 1.0, 101)[1:] ** 2  # dense where it bends
            over = np.concatenate([-side[::-1], [np.nan], side])  # a gap, not a line, where dry friction jumps
            velocity = np.zeros((len(over), self.dof))
            place = self.joint_names.index(joint)
            velocity[:, place] = np.nan_to_num(over)
            torque = self.friction(velocity, q, temperature)[:, place]
            panels.append(
                LinePanel(
                    joint,
                    over,
                    {"friction": np.where(np.isnan(over), np.nan, torque)},
                    f"velocity [{limits.unit('rad/s')}]",
                    limits.unit("N·m"),
                )
            )
        return line_figure(panels, min(2, len(panels)), backend)

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
        step: float = DEFAULT_STEP,
        temperature: npt.ArrayLike | None = None,
    ) -> SimulatedMotion:
        """Simulate the arm forward in time, with friction, closed loops and coupled motors.

        Dry friction is a set-valued force (Moreau's midpoint rule, `ident.simulation.time_stepping`): a joint stays at
        rest until the torque breaks it away. Where `identify` found a presliding travel it gives way like a spring, its
        contacts deflected at the start if it moves then. A Coulomb column with smoothing is simulated as one without.
        Joint limits, floor and collisions are not.

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
        self.require_complete("a simulation")
        kelvin = self._kelvin(temperature, 1)
        return simulated_motion(
            self._dynamics, q0, dq0, torque, duration, step, None if kelvin is None else kelvin[:, 0]
        )

    def regressor(
        self,
        q: npt.ArrayLike,
        dq: npt.ArrayLike | None = None,
        ddq: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Regressor Y(q, q̇, q̈), (N, n, b) or (n, b): torque = Y @ parameters["value"].

        A column has the unit of N·m over that of its parameter; columns are in the order of `parameters`. Arguments are
        those of `torque`.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
        """
        (position, velocity, acceleration), single = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        motion = position, velocity, acceleration
        kelvin = self._kelvin(temperature, position.shape[1])
        rows = np.ascontiguousarray(np.moveaxis(self._columns(*motion, kelvin), -1, 0))
        return rows[0] if single else rows

    def torque_std(
        self,
        q: npt.ArrayLike,
        dq: npt.ArrayLike | None = None,
        ddq: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Standard deviation σ [N·m] of `torque` from that of the parameters, √diag(Y·Σ·Yᵀ); shape of `q`.

        Σ is the stored covariance, corrected for autocorrelated residuals, of parameters and estimated shapes of
        friction together. That of the essential model is the full
        one's plus the outer product of what the pruning changed, since the dropped parameters are not exactly 0. σ is
        inf where a parameter of unknown variance acts. What the model lacks altogether is not in it: see `validation`
        for that. Arguments are those of `torque`.

        Raises:
            DataError: shapes differ, a value is not finite, or a temperature is missing.
            ModelError: a parameter without a value acts on this motion.
            ResultFileError: the result holds no covariance.
        """
        (position, velocity, acceleration), single = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        kelvin = self._kelvin(temperature, position.shape[1])
        sure, root, unsure = self._deviations
        deviations = np.empty_like(position)
        for start in range(0, deviations.shape[1], SAMPLES_AT_ONCE):
            chunk = slice(start, start + SAMPLES_AT_ONCE)
            heat = None if kelvin is None else kelvin[:, chunk]
            columns = self._columns(position[:, chunk], velocity[:, chunk], acceleration[:, chunk], heat)
            self._require(columns)
            columns = self._error_columns(columns, position[:, chunk], velocity[:, chunk], heat)
            deviations[:, chunk] = np.linalg.norm(np.swapaxes(columns[:, sure], 1, 2) @ root, axis=-1)
            if len(unsure):
                acting = np.any(np.abs(columns[:, unsure]) > REGRESSOR_ROUNDING, axis=1)
                deviations[:, chunk] = np.where(acting, np.inf, deviations[:, chunk])
        return outward(deviations, single=single)

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


def result_path(path: str | PathLike[str]) -> Path:
    """The result.json that a path means: itself, or the one in a folder that `identify` wrote.

    Raises:
        UsageError: it is no path.
    """
    if not isinstance(path, (str, PathLike)):
        raise UsageError(
            f"a {type(path).__name__} is neither a result nor a path of one",
            hint="give the folder that identify wrote, or its result.json",
        )
    given = Path(path)
    return given / "result.json" if given.is_dir() else given
