"""The gravity of an identified arm: a model that knows what holds the arm still, and nothing of motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from os import PathLike
from typing import Any, Literal, NoReturn, TypeVar, cast

import numpy as np
import numpy.typing as npt

from daq.robot.loader import parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError, ResultFileError
from ident.export.export import Export
from ident.model.base_parameters import gravity_base, gravity_columns, gravity_rows, resting_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.result.arrays import outward, samples
from ident.result.estimate import AGAIN
from ident.result.gravity import GravityResult
from ident.result.models.model import Model
from ident.result.result_file import StoredModel
from ident.result.tables import Table

Method = TypeVar("Method", bound=Callable[..., Any])


def _at_rest(method: Method, meaning: str) -> Method:
    """A method of `Model` as one of an arm at rest, which refuses motion."""

    @wraps(method)
    def of_rest(
        self: GravityModel,
        q: npt.ArrayLike,
        dq: npt.ArrayLike | None = None,
        ddq: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> Any:
        self._refuse_motion(q, dq, ddq)
        return method(self, q)

    of_rest.__doc__ = f"""{meaning}

        Raises:
            DataError: a wrong shape, or a value is not finite.
            ModelError: the arm moves, or a parameter that was not determined acts.
        """
    return cast(Method, of_rest)


def _refused(method: Method, what: str) -> Method:
    """A method of `Model` that gravity alone does not allow."""

    @wraps(method)
    def refuse(self: GravityModel, *_: Any, **__: Any) -> NoReturn:
        self._refuse(what)

    refuse.__doc__ = f"""Not possible: a model of gravity does not know {what}.

        Raises:
            ModelError: always.
        """
    return cast(Method, refuse)


class GravityModel(Model):
    """Gravity of an arm; made by `load_model` of a folder that `dynid identify --gravity` wrote, or `identify_gravity`.

    `gravity(q)` compensates the arm's weight, `torque(q)` has the motors' offsets too, `torque_std(q)` is the σ of the
    latter. Friction of motions, inertia and everything made of them were not recorded: their methods raise ModelError.
    Of a joint that slides along gravity, weight and offset act alike; both are in `gravity`.

    Attributes:
        result: what the identification wrote.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.load_model("no-such-model")
        ... except dynid.ResultFileError as error:
        ...     print(error.message)
        no such file
    """

    result: GravityResult  # type: ignore[assignment]  # beside `Result`, which a whole model has

    def __init__(self, result: GravityResult) -> None:
        """Build the model of a result.

        Raises:
            ResultFileError: its parts do not belong together.
        """
        self.result = result
        self.kind = "full"
        robot_file = parse_robot(
            result.robot_file, where="the result's robot file", folder=None, urdf_text=result.urdf or None
        )
        model = resting_model(robot_file)
        base = gravity_base(model)
        if [parameter.name for parameter in result.gravity_parameters] != list(base.names):
            raise ResultFileError("the parameters do not belong to the robot file stored with them", hint=AGAIN)
        self._stored = StoredModel(robot_file, model, (), base)
        self._base = base
        values = [np.nan if parameter.value is None else parameter.value for parameter in result.gravity_parameters]
        self._values = np.array(values, dtype=np.float64)
        self._missing = [int(index) for index in np.flatnonzero(np.isnan(self._values))]
        self._dynamics = InverseDynamics(model, base, np.nan_to_num(self._values))
        # Weight and offset of a joint that slides along gravity are one number, which holds the arm: it is gravity's.
        together = [
            index
            for index, column in enumerate(base.columns)
            if model.parameters[column].kind == "offset"
            and model.link_names[model.parameters[column].joint] in self._dynamics.confounded
        ]
        still = np.zeros((model.dof, 1))
        rows = gravity_rows(model, base, still.T)[0][:, together]
        weight = rows @ np.nan_to_num(self._values)[together]
        self._dynamics.weight = model.transmission.at_joints(weight[:, None])[:, 0]
        self._dynamics.confounded = ()

    @property
    def armature(self) -> FloatArray:
        """Not known: zeros (n,)."""
        return np.zeros(self.dof)

    @property
    def parameters(self) -> Table:
        """Gravity parameters and offsets with their 95 % intervals."""
        return self.result.parameters

    torque = _at_rest(
        Model.torque, "Torque [N·m] that holds the arm at rest, motors' offsets included, friction not; shape of `q`."
    )
    torque_parts = _at_rest(
        Model.torque_parts, "The parts of `torque` [N·m]: gravity, and the offsets as friction; shape of `q` each."
    )
    regressor = _at_rest(Model.regressor, 'Regressor at rest, (N, n, b) or (n, b): torque = Y @ parameters["value"].')
    to_pinocchio = _refused(Model.to_pinocchio, "the bodies that Pinocchio needs")
    export_urdf = _refused(Model.export_urdf, "the inertias that a URDF needs")
    export_mjcf = _refused(Model.export_mjcf, "the inertias that an MJCF needs")
    export_ros2_inertial = _refused(Model.export_ros2_inertial, "the inertias of links")
    friction = _refused(Model.friction, "friction at other speeds than that of the passes (`result.of_joints`)")
    coriolis = _refused(Model.coriolis, "Coriolis torques")
    mass_matrix = _refused(Model.mass_matrix, "the inertia matrix")
    forward_dynamics = _refused(Model.forward_dynamics, "the inertia matrix")
    simulate = _refused(Model.simulate, "the inertia matrix")

    def torque_std(
        self,
        q: npt.ArrayLike,
        dq: npt.ArrayLike | None = None,
        ddq: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> FloatArray:
        """Standard deviation σ [N·m] of `torque` from that of the parameters; shape of `q`.

        Raises:
            DataError: a wrong shape, or a value is not finite.
            ModelError: the arm moves, or a parameter that was not determined acts.
        """
        self._refuse_motion(q, dq, ddq)
        (position,), single = samples(self.joint_names, q=q)
        still = np.zeros_like(position)
        columns = self._columns(position, still, still)
        self._require(columns)
        covariance = np.array(self.result.covariance)
        variance = np.einsum("nbk,bc,nck->nk", columns, covariance, columns)
        return outward(np.sqrt(np.maximum(variance, 0.0)), single=single)

    def export_c(
        self, path: str | PathLike[str], *, real: Literal["double", "float"] = "double", overwrite: bool = False
    ) -> Export:
        """Write C99 source of `gravity`, with a self-test.

        Args:
            path: of both files, without suffix: `arm` gives arm.h and arm.c.
            real: type of the arithmetic.
            overwrite: replace what exists.

        Raises:
            UsageError: a file exists, cannot be written, or has a name that C cannot include.
            ModelError: a parameter was not determined, or loops of the arm are solved numerically.
        """
        from ident.export.c_code.source import Parameter
        from ident.export.c_code.write import write_c

        weighing = gravity_columns(self._base)
        missing = [self._base.names[index] for index in self._missing if index in weighing]
        if missing:
            raise ModelError(f"{', '.join(missing)} has no value: no recorded pose determines it", where=self.name)
        parameters = [
            Parameter(
                parameter.name,
                0.0 if parameter.value is None else parameter.value,
                parameter.std,
                parameter.unit,
                parameter.expression,
            )
            for parameter in self.result.gravity_parameters
        ]
        result = self.result
        recordings = [f"  {use.role}: {use.file}, SHA-256 {use.sha256}" for use in result.recordings]
        origin = (
            f"Gravity identified {result.created} by dynid {result.versions.get('dynid', 'unknown')}.",
            "Recordings:",
            *recordings,
            f"Verdict: {result.verdict.headline}",
        )
        return write_c(
            self._dynamics,
            path,
            real=real,
            kind="gravity parameters, and nothing of motion",
            origin=origin,
            parameters=parameters,
            names=("gravity",),
            overwrite=overwrite,
        )

    def _refuse_motion(self, q: npt.ArrayLike, dq: npt.ArrayLike | None, ddq: npt.ArrayLike | None) -> None:
        signals, _ = samples(self.joint_names, q=q, dq=dq, ddq=ddq)
        if any(np.any(signal != 0.0) for signal in signals[1:]):
            self._refuse("torques of a motion")

    def _refuse(self, what: str) -> NoReturn:
        raise ModelError(
            f"this is a model of gravity, without {what}",
            where=self.name,
            hint="gravity(q), torque(q) at rest and export_c are there; the rest needs dynid excite and dynid identify",
        )

    def __repr__(self) -> str:
        return (
            f"<dynid.GravityModel {self.name}, {self.dof} joints, {self.result.verdict.grade} for gravity compensation>"
        )


def refuse_gravity_alone(model: Model, what: str) -> None:
    """Refuse a model of gravity where more is needed.

    Raises:
        ModelError: it is one.
    """
    if isinstance(model, GravityModel):
        model._refuse(what)
