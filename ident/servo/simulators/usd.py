"""A servo model as a USD stage: bodies, joints, drives of UsdPhysics, motor inertia and friction of PhysX.

Rotational drives of UsdPhysics are in degrees: stiffness and damping are torques per degree, limits degrees, the
PhysX speed limit degrees per second. The PhysX attributes (`PhysxJointAxisAPI`: armature, static and dynamic friction
efforts, viscous coefficient, speed limit) are those of Omniverse's schema addition; usd-core does not have the schema,
and keeps them as the attributes of an applied schema that it does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError, UsageError
from ident.estimators.feasible.pseudo_inertia import body_of
from ident.export.xml_text import quaternion
from ident.model.kinematics.joints import BASE_INDEX
from ident.model.parameters import LINK_SIZE, inertia_tensor
from ident.servo.links import ServoLinks
from ident.servo.simulators.actuator_law import ActuatorLaw, FileFormat, actuator_law
from ident.servo.terms import INDEX, TERMS

MISSING = ("acceleration_limit", "load_friction", "load_breakaway", "dead_band", "bias", "delay", "backlash")
"""Terms that a drive has no place for."""

FORMAT = FileFormat("USD", "the drives' law", MISSING)

DEGREE = 180.0 / np.pi
"""[°] of a radian."""

BASE_MASS = 1.0
"""[kg] of the base, which is fixed to the world: no mass of it is known, and none matters."""


def usd_installed() -> bool:
    """Return whether usd-core can be imported."""
    from importlib.util import find_spec

    return find_spec("pxr") is not None


def servo_usd(robot_file: RobotFile, links: ServoLinks, values: FloatArray, missing: Sequence[str] = ()) -> str:
    """The text (.usda) of a stage with the articulation, its fixed base at the origin.

    Args:
        robot_file: its speed limits.
        links: bodies.
        values: (n, terms) parameters that drives have a place for.
        missing: what they have none for, in words.

    Raises:
        UsageError: usd-core is not installed.
        ModelError: the arm has loops or coupled motors.
    """
    if not usd_installed():
        raise UsageError("a USD file needs usd-core", hint="pip install 'dynid[usd]'")
    from pxr import Gf, Tf, Usd, UsdGeom, UsdPhysics

    model = links.model
    if not model.transmission.direct:
        raise ModelError("closed loops and coupled motors are not exported as servos", where=model.name)
    law = actuator_law(values, links, 0.0)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.GetRootLayer().comment = (
        f"Servo model of {model.name}, identified with dynid; drives are in degrees. "
        f"Not in this file: {', '.join(missing) or 'nothing'}."
    )
    prims = [Tf.MakeValidIdentifier(joint.name) for joint in model.joints]
    used = ["base", "base_joint", *prims, *(f"{prim}_link" for prim in prims)]
    if twice := [name for name in used if used.count(name) > 1]:
        raise ModelError(f"USD would call two things '{twice[0]}'", where=model.name, hint="rename joints of the arm")
    root_path = "/" + Tf.MakeValidIdentifier(model.name)
    root = UsdGeom.Xform.Define(stage, root_path)
    stage.SetDefaultPrim(root.GetPrim())
    UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
    paths = {BASE_INDEX: f"{root_path}/base"}
    base = UsdGeom.Xform.Define(stage, paths[BASE_INDEX])
    UsdPhysics.RigidBodyAPI.Apply(base.GetPrim())
    UsdPhysics.MassAPI.Apply(base.GetPrim()).CreateMassAttr(BASE_MASS)
    fixed = UsdPhysics.FixedJoint.Define(stage, f"{root_path}/base_joint")
    fixed.CreateBody1Rel().SetTargets([paths[BASE_INDEX]])
    places = {BASE_INDEX: (np.zeros(3), np.eye(3))}
    for index, joint in enumerate(model.joints):
        name = prims[index]
        row = model.active.index(index) if index in model.active else None
        zero = 0.0 if row is None else float(values[row, INDEX["zero"]])
        axes = _axes(joint.axis)
        turn = axes @ (np.eye(3) if joint.prismatic else _about_z(zero))
        frame = joint.rotation @ turn @ axes.T  # of the body where the encoder shows 0
        origin, orientation = places[joint.parent]
        shift = joint.translation + (joint.rotation @ joint.axis * zero if joint.prismatic else 0.0)
        places[index] = (origin + orientation @ shift, orientation @ frame)
        paths[index] = f"{root_path}/{name}_link"
        body = UsdGeom.Xform.Define(stage, paths[index])
        body.AddTranslateOp().Set(Gf.Vec3d(*places[index][0].tolist()))
        body.AddOrientOp().Set(_quaternion(places[index][1]))
        UsdPhysics.RigidBodyAPI.Apply(body.GetPrim())
        _mass(body.GetPrim(), links.inertial[LINK_SIZE * index : LINK_SIZE * (index + 1)])
        kind = UsdPhysics.PrismaticJoint if joint.prismatic else UsdPhysics.RevoluteJoint
        made = kind.Define(stage, f"{root_path}/{name}")
        made.CreateAxisAttr("Z")
        made.CreateBody0Rel().SetTargets([paths[joint.parent]])
        made.CreateBody1Rel().SetTargets([paths[index]])
        made.CreateLocalPos0Attr(Gf.Vec3f(*np.asarray(shift).tolist()))
        made.CreateLocalRot0Attr(_quaternion(joint.rotation @ turn))
        made.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        made.CreateLocalRot1Attr(_quaternion(axes))
        if row is not None:
            speed = robot_file.robot.joints[row].velocity
            _drive(made, law, row, model.limits[row].position, speed, prismatic=joint.prismatic)
    return str(stage.GetRootLayer().ExportToString())


def _drive(
    joint: Any, law: ActuatorLaw, row: int, limits: tuple[float, float], speed: float, *, prismatic: bool
) -> None:
    from pxr import Sdf, UsdPhysics

    kind, unit = ("linear", 1.0) if prismatic else ("angular", DEGREE)
    prim = joint.GetPrim()
    joint.CreateLowerLimitAttr(unit * limits[0])
    joint.CreateUpperLimitAttr(unit * limits[1])
    drive = UsdPhysics.DriveAPI.Apply(prim, kind)
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(float(law.stiffness[row]) / unit)
    drive.CreateDampingAttr(float(law.damping[row]) / unit)
    if np.isfinite(law.effort_limit[row]):
        drive.CreateMaxForceAttr(float(law.effort_limit[row]))
    prim.AddAppliedSchema(f"PhysxJointAxisAPI:{kind}")
    for name, value in (
        ("armature", law.armature[row]),
        ("staticFrictionEffort", law.static[row]),
        ("dynamicFrictionEffort", law.dynamic[row]),
        ("viscousFrictionCoefficient", law.viscous[row] / unit),
        ("maxJointVelocity", speed * unit),
    ):
        prim.CreateAttribute(f"physxJointAxis:{kind}:{name}", Sdf.ValueTypeNames.Float, False).Set(float(value))


def _mass(prim: Any, link: FloatArray) -> None:
    from pxr import Gf, UsdPhysics

    body = body_of(link)
    moments, axes = np.linalg.eigh(inertia_tensor([*body.inertia.values()]))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr(body.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*body.com))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*np.maximum(moments, 0.0).tolist()))
    mass.CreatePrincipalAxesAttr(_quaternion(axes))


def _quaternion(rotation: FloatArray) -> Any:
    from pxr import Gf

    w, x, y, z = quaternion(rotation)
    return Gf.Quatf(w, x, y, z)


def _axes(axis: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose third column is the axis."""
    third = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    other = np.eye(3)[int(np.argmin(np.abs(third)))]
    first = np.cross(other, third)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(third, first), third], axis=1)


def _about_z(angle: float) -> FloatArray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def read_usd(text: str, joint_names: Sequence[str], where: str) -> ActuatorLaw:
    """The law of the drives in a stage's text, in SI units.

    Raises:
        ModelError: USD cannot read it, or a joint has no drive.
    """
    from pxr import Sdf, Tf, Usd, UsdPhysics

    layer = Sdf.Layer.CreateAnonymous(".usda")
    if not layer.ImportFromString(text):
        raise ModelError("USD cannot read it", where=where)
    stage = Usd.Stage.Open(layer)
    root = stage.GetDefaultPrim().GetPath()
    rows = []
    for name in joint_names:
        prim = stage.GetPrimAtPath(root.AppendChild(Tf.MakeValidIdentifier(name)))
        kind = "linear" if prim and prim.IsA(UsdPhysics.PrismaticJoint) else "angular"
        if not prim or not prim.HasAPI(UsdPhysics.DriveAPI, kind):
            raise ModelError(f"joint {name} has no drive", where=where)
        unit = 1.0 if kind == "linear" else DEGREE
        drive = UsdPhysics.DriveAPI(prim, kind)
        limit = float(drive.GetMaxForceAttr().Get())
        physx = {
            key: float(prim.GetAttribute(f"physxJointAxis:{kind}:{key}").Get())
            for key in ("armature", "staticFrictionEffort", "dynamicFrictionEffort", "viscousFrictionCoefficient")
        }
        rows.append(
            (
                unit * float(drive.GetStiffnessAttr().Get()),
                unit * float(drive.GetDampingAttr().Get()),
                unit * physx["viscousFrictionCoefficient"],
                physx["armature"],
                physx["staticFrictionEffort"],
                physx["dynamicFrictionEffort"],
                min(limit, TERMS[INDEX["torque_limit"]].absent),
                0.0,
            )
        )
    return ActuatorLaw(*np.array(rows, dtype=np.float64).T)
