"""What an identified model writes for others: URDF, MJCF, inertial YAML, C code, a Pinocchio model."""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

from drivers.core.errors import ModelError
from ident.result.delivered import Parameters
from ident.result.model_parameters import ModelParameters

if TYPE_CHECKING:
    from ident.export.arm import ExportedArm
    from ident.export.export import Export

KINDS: dict[Parameters, str] = {
    "consistent": "the base parameters of bodies that can exist",
    "full": "all base parameters as estimated",
    "essential": "the significant base parameters, the others 0",
}
"""What the models hold, for comments in what they write."""


class ExportedModel(ModelParameters):
    """Parameters that can be written as the files of simulators and controllers."""

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

    @cached_property
    def _exported(self) -> ExportedArm:
        from ident.result.exported import exported_arm

        return exported_arm(self.result, self.kind, self._stored, self._dynamics)
