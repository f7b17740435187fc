"""The parameters of an identified model of a whole arm, with their covariance, from which all else is computed."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError, ModelError
from drivers.core.units import ZERO_CELSIUS
from ident.estimators.feasible.armature import armature_vector
from ident.estimators.feasible.consistent import ConsistentParameters, consistent_parameters
from ident.friction.table import REFERENCE_TEMPERATURE
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import own_column
from ident.model.regressor import regressor
from ident.regression.estimate import Estimate
from ident.regression.observability import describe
from ident.regression.pruning import pruned_covariance
from ident.result.delivered import Parameters, delivered_parameters
from ident.result.result_file import StoredModel, stored_estimate, stored_model
from ident.result.schema import Result
from ident.result.tables import Table, table_of_rows

HOTTEST = 250.0
"""[°C] No joint of an arm is warmer, or as cold; a larger number is in another unit."""

REGRESSOR_ROUNDING = 1e-9
"""Entries of a regressor below this are rounding: sines of 180° and the like."""


class ModelParameters:
    """The base parameters of a model, consistent, full or essential, with what the recordings say of each.

    Attributes:
        result: what the identification wrote.
        kind: "consistent", of bodies that can exist; "full", all base parameters as estimated; or "essential", the
            significant ones, the others 0.
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
                    hint='identify again, or use parameters="full"',
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

    @property
    def dynamics(self) -> InverseDynamics:
        """Inverse dynamics (n, N) of these parameters, for what evaluates them in parts and sample by sample."""
        return self._dynamics

    @property
    def stored(self) -> StoredModel:
        """The model that these parameters belong to, with its robot file."""
        return self._stored

    def require_complete(self, what: str) -> None:
        """Refuse a model some of whose base parameters have no value, where all are needed for `what`.

        Raises:
            ModelError: names the parameters.
        """
        if self._missing:
            raise ModelError(
                f"{', '.join(self._base.names[index] for index in self._missing)} has no value: the recording did not "
                f"excite it, and {what} needs it",
                where=self.name,
                hint='use the physically consistent model (parameters="consistent", the default)',
            )

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
    def armature(self) -> FloatArray:
        """Inertia (n,) [kg·m²] of motors whose torque sensor sits behind the gear; 0 of the others.

        `simulate` and `export_mjcf` move it; `torque` and `mass_matrix` have none of it. A recorded torque τ of such a
        sensor drives a simulation as τ + armature·q̈. From the robot file (`drives[].armature`), or assumed.
        """
        consistent = self.result.consistent
        return armature_vector(self._stored.model, [] if consistent is None else consistent.armature)

    @property
    def confounded(self) -> tuple[str, ...]:
        """Names of the joints whose weight and offset are one parameter of this model: those that slide along gravity.

        The consistent model has none, for its bodies have weights; the split is then as good as their prior.
        """
        return self._dynamics.confounded

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
        return consistent_parameters(stored.model, self._base, self._estimate, stored.robot_file)

    def _known_std(self) -> dict[str, float | None]:
        """Standard deviations by name; None where a result does not hold what they follow from."""
        if self.kind == "consistent" and self.result.estimate is None:
            return dict.fromkeys(self._base.names)
        return {
            name: std if std is not None and np.isfinite(std) else None for name, std in self._parameter_std().items()
        }

    @cached_property
    def _deviations(self) -> tuple[list[int], FloatArray, list[int]]:
        """Columns of `_error_columns` of known variance, a root of their covariance, and those of unknown variance."""
        active, covariance = self._covariance()
        finite = np.isfinite(np.diag(covariance))
        powers, axes = np.linalg.eigh(covariance[np.ix_(finite, finite)])
        sure = [index for index, there in zip(active, finite, strict=True) if there]
        unsure = [index for index in range(self._base.count) if index not in sure]
        unsure += [index for index in active if index >= self._base.count and index not in sure]
        return sure, axes * np.sqrt(np.clip(powers, 0.0, None)), unsure

    def _covariance(self) -> tuple[tuple[int, ...], FloatArray]:
        """Columns that were estimated, and their covariance (of the essential model its mean square error).

        Those of the shapes come last. Friction at some speed is known far better than each of its parameters is, beside
        a shape that moves all of them.
        """
        estimate = self._estimate
        active, covariance, count = estimate.active, estimate.covariance, len(estimate.active)
        shared = estimate.shape_covariance[:, :count]
        if self.kind == "consistent":
            consistent = self._consistent
            active, covariance = tuple(range(self._base.count)), consistent.base_covariance
            shared = np.where(np.isfinite(shared), shared, 0.0) @ consistent.base_moves.T
        elif self.kind == "essential":
            covariance = pruned_covariance(covariance, self._values[list(active)] - estimate.values)
        shapes = range(self._base.count, self._base.count + len(estimate.shapes))
        whole = np.block([[covariance, shared.T], [shared, estimate.shape_covariance[:, count:]]])
        return (*active, *shapes), whole

    @cached_property
    def _estimate(self) -> Estimate:
        return stored_estimate(self.result, self._stored)

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
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray, kelvin: FloatArray | None = None
    ) -> FloatArray:
        """Joint regressor (n, b, N); the kernel's rows are the motors'. At rest no temperature is needed."""
        heat = np.full_like(position, REFERENCE_TEMPERATURE) if kelvin is None else kelvin
        rows = regressor(self._stored.model, position, velocity, acceleration, self._base.columns, heat)
        return self._at_joints(rows)

    def _error_columns(
        self, columns: FloatArray, position: FloatArray, velocity: FloatArray, kelvin: FloatArray | None
    ) -> FloatArray:
        """Joint regressor (n, b + s, N) with the derivatives by the friction's estimated shapes behind its columns."""
        if not self._estimate.shapes:
            return columns
        model, heat = self._shape_model, np.full_like(position, REFERENCE_TEMPERATURE) if kelvin is None else kelvin
        places = [own_column(model, range(len(model.parameters)), *shape) for shape in self._estimate.shapes]
        rows = regressor(model, position, velocity, np.zeros_like(velocity), [p for p in places if p is not None], heat)
        return np.concatenate([columns, self._at_joints(rows)], axis=1)

    @cached_property
    def _shape_model(self) -> DynamicModel:
        """The model with a column for each shape that was estimated."""
        model = self._stored.model
        return replace(model, terms=replace(model.terms, sensitivities=True))

    def _at_joints(self, rows: FloatArray) -> FloatArray:
        """Rows (n, b, N) of the motors at the joints."""
        if self._stored.model.transmission.direct:
            return rows
        return np.asarray(np.einsum("mn,mbN->nbN", self._dynamics.coupling, rows))

    def _require(self, columns: FloatArray, kinds: tuple[str, ...] = ()) -> None:
        """Refuse a motion that needs a parameter without a value: columns (n, b, N) that act on it."""
        wanted = [index for index in self._missing if not kinds or self._base.kinds[index] in kinds]
        needed = [self._base.names[i] for i in wanted if np.any(np.abs(columns[:, i]) > REGRESSOR_ROUNDING)]
        if needed:
            raise ModelError(
                f"{', '.join(needed)} acts on this motion and has no value: the recording did not excite it",
                where=self.name,
                hint='record a motion that does, or load_model(…, parameters="essential"), which assumes 0',
            )

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
                f"{part} is unknown: weight and offset of {', '.join(confounded)} act alike (together "
                f"{', '.join(values)}), and no motion separates them",
                where=f"{self.name}, {self.kind} model",
                hint='parameters="consistent" (the default) splits them by its bodies; torque() needs no split',
            )

    def __repr__(self) -> str:
        return f"<dynid.Model {self.name}, {self.dof} joints, {self._base.count} base parameters, {self.kind}>"
