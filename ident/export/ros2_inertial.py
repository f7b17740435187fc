"""Inertial parameters as YAML, in the form of `inertia_parameters` of Universal_Robots_ROS2_Description.

There, `physical_parameters.yaml` holds a mass, a centre of mass and an inertia tensor with the rotation of its axes
for each link, in the frame of the link.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from drivers.core.errors import ModelError
from ident.export.arm import ExportedArm
from ident.export.left_out import left_out_of_ros2_inertial
from ident.linear_algebra.vectors import rotation_of

UR_LINKS = {
    "shoulder_pan_joint": "shoulder",
    "shoulder_lift_joint": "upper_arm",
    "elbow_joint": "forearm",
    "wrist_1_joint": "wrist_1",
    "wrist_2_joint": "wrist_2",
    "wrist_3_joint": "wrist_3",
}
"""Names of the links in the package, by the joints that move them."""

_QUARTER = 0.5 * np.pi
UR_ROLLS = (0.0, _QUARTER, 0.0, 0.0, _QUARTER, -_QUARTER)
"""Rolls [rad] of the link frames in each other in the package (`default_kinematics.yaml`, calibration aside)."""

CALIBRATION = 0.05
"""[rad] by which the axes of a calibrated arm may differ from the nominal ones."""


def ros2_inertial(arm: ExportedArm) -> str:
    """The text of the YAML; links are named as in the package where the arm has its joints and frames."""
    import yaml

    names = inertial_names(arm)
    masses = {f"{name}_mass": body.mass for name, body in zip(names, arm.bodies, strict=True)}
    centres = {
        f"{name}_cog": dict(zip("xyz", body.com, strict=True)) for name, body in zip(names, arm.bodies, strict=True)
    }
    tensors = {
        name: {f"i{element}": value for element, value in body.inertia.items()}
        for name, body in zip(names, arm.bodies, strict=True)
    }
    rotations = {name: {"roll": 0.0, "pitch": 0.0, "yaw": 0.0} for name in names}
    content = {"inertia_parameters": {**masses, "center_of_mass": centres, "rotation": rotations, "tensor": tensors}}
    frames = (
        "Put it in place of the same entries of physical_parameters.yaml; keep base_mass and links there."
        if has_ur_frames(arm)
        else "In the frames of the identified arm's joints, whose names the links have."
    )
    head = [
        f"Inertial parameters of {arm.model.name}, identified with dynid; kg, m, kg·m², rad.",
        frames,
        *(f"Not in this file: {sentence}." for sentence in left_out_of_ros2_inertial(arm)),
    ]
    return "".join(f"# {line}\n" for line in head) + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def inertial_names(arm: ExportedArm) -> tuple[str, ...]:
    """Names of the links: the package's for a UR in its frames, else those of the joints that move them."""
    names = arm.model.link_names
    return tuple(UR_LINKS[name] for name in names) if has_ur_frames(arm) else names


def has_ur_frames(arm: ExportedArm) -> bool:
    """Return whether the arm has a UR's six joints, with link frames that lie as in the package."""
    joints = arm.model.joints
    if arm.model.link_names != tuple(UR_LINKS):
        return False
    serial = all(other.parent == index for index, (_, other) in enumerate(pairwise(joints)))
    return serial and all(
        float(np.abs(joint.rotation - rotation_of(roll, 0.0, 0.0)).max()) < CALIBRATION
        and bool(np.array_equal(joint.axis, (0.0, 0.0, 1.0)))
        for joint, roll in zip(joints, UR_ROLLS, strict=True)
    )


def check_ros2_inertial(arm: ExportedArm, text: str) -> None:
    """Read the YAML again and compare every body.

    Raises:
        ModelError: something in it is another number.
    """
    import yaml

    content: dict[str, Any] = yaml.safe_load(text)["inertia_parameters"]
    for name, body in zip(inertial_names(arm), arm.bodies, strict=True):
        centre, tensor = content["center_of_mass"][f"{name}_cog"], content["tensor"][name]
        values = [
            content[f"{name}_mass"],
            *(centre[axis] for axis in "xyz"),
            *(tensor[f"i{element}"] for element in body.inertia),
        ]
        if values != [body.mass, *body.com, *body.inertia.values()]:
            raise ModelError(
                f"the YAML reads back a different body for {name}; it was not written", where=arm.model.name
            )
