"""An MJCF of the whole model: bodies, motors with inertia, friction and offsets, coupled motors, closed loops."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from drivers.core.arrays import FloatArray
from drivers.core.errors import ModelError
from drivers.core.units import common_unit
from ident.export.arm import ExportedArm, Segment, link_segments
from ident.export.left_out import left_out_of_mjcf
from ident.export.urdf import link_name
from ident.export.xml_text import comment_text, number, numbers, quaternion
from ident.model.kinematics.joints import BASE_INDEX, ancestors
from ident.model.kinematics.linkages.build import RANK
from ident.model.kinematics.linkages.closed_loops import ClosedLoops
from ident.model.kinematics.loops import loop_ends, place_tree
from ident.model.kinematics.transmission import LinearTransmission

TIME_STEP = 0.001
"""[s] of the file: friction and stiff loops want it shorter than MuJoCo's default of 2 ms."""

STIFFEST = {"solref": "0.002 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
"""How hard loops are closed and joints stick: MuJoCo's constraints are springs and dampers. The stiffest that the time
step allows, and an impedance that leaves 1e-4 of the acceleration to them. By MuJoCo's defaults a joint that sticks
creeps, the faster the lower its inertia."""

SECOND_POINT = 0.1
"""[m] along the axis of an opened joint at which a second point holds the axes parallel, where one does not do."""


def mjcf(arm: ExportedArm) -> str:
    """The text of the MJCF; bodies in the frames of the robot file, named after their joints.

    Raises:
        ModelError: a coupled motor turns with joints of different branches.
    """
    model = arm.model
    _check_coupled(arm)
    root = ElementTree.Element("mujoco", model=model.name)
    lines = [
        f"Dynamic model of {model.name}, identified with dynid; torque in ctrl, offsets included "
        f"[{common_unit('N·m', model.sliding)}].",
        "Not in this file:",
        *(f"- {sentence}" for sentence in left_out_of_mjcf(arm)),
    ]
    if arm.closed:
        lines.append("Loops close at the keyframe 'home' only: start a simulation there.")
    root.append(ElementTree.Comment("\n" + comment_text(lines)))
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true")
    ElementTree.SubElement(
        root, "option", gravity=numbers(model.gravity), timestep=number(TIME_STEP), integrator="implicitfast"
    )
    default = ElementTree.SubElement(root, "default")
    ElementTree.SubElement(default, "geom", contype="0", conaffinity="0", mass="0", rgba="0.6 0.65 0.7 1")
    ElementTree.SubElement(default, "joint", {f"{name}friction": value for name, value in STIFFEST.items()})
    if arm.closed:
        ElementTree.SubElement(default, "equality", STIFFEST)
    world = ElementTree.SubElement(root, "worldbody")
    ElementTree.SubElement(world, "light", pos="0 0 3", dir="0 0 -1")
    elements = _bodies(arm, world)
    tendons, equalities, actuators = (ElementTree.Element(tag) for tag in ("tendon", "equality", "actuator"))
    _loops(arm, elements, tendons, equalities)
    _motors(arm, tendons, actuators)
    for element in (tendons, equalities, actuators):
        if len(element):
            root.append(element)
    _keyframe(arm, root, world)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _check_coupled(arm: ExportedArm) -> None:
    """Refuse what MuJoCo's inertia matrix has no place for: joints of different branches that one motor couples."""
    joints = arm.model.joints
    for motor, several in enumerate(arm.coupled):
        moving = [arm.model.active[joint] for joint in np.flatnonzero(arm.coupling[motor])]
        branch = {*ancestors(joints, max(moving)), max(moving)}
        if several and arm.motors.inertia[motor] and not branch.issuperset(moving):
            raise ModelError(
                f"the motor of {arm.model.joint_names[motor]} turns with joints of different branches, "
                f"{', '.join(joints[index].name for index in moving)}: MuJoCo cannot couple their inertias",
                where=arm.model.name,
                hint="export a URDF, or the C code",
            )


def _bodies(arm: ExportedArm, world: ElementTree.Element) -> dict[int, ElementTree.Element]:
    """The elements of the bodies by their link's number, the world's by `BASE_INDEX`."""
    model, segments = arm.model, link_segments(arm)
    elements = {BASE_INDEX: world}
    _geoms(world, segments.get(BASE_INDEX, []))
    for index, joint in enumerate(model.joints):
        body = ElementTree.SubElement(
            elements[joint.parent],
            "body",
            name=link_name(joint.name),
            pos=numbers(joint.translation),
            quat=numbers(quaternion(joint.rotation)),
        )
        elements[index] = body
        _inertial(arm, body, index)
        attributes = {"name": joint.name, "type": "slide" if joint.prismatic else "hinge", "axis": numbers(joint.axis)}
        if index in model.active:
            motor, terms = model.active.index(index), arm.at_joints
            attributes |= {
                "range": numbers(model.limits[motor].position),
                "armature": number(terms.inertia[motor]),
                "damping": number(terms.viscous[motor]),
                "frictionloss": number(terms.coulomb[motor]),
            }
        ElementTree.SubElement(body, "joint", attributes)
        _geoms(body, segments.get(index, []))
    return elements


def _inertial(arm: ExportedArm, element: ElementTree.Element, index: int) -> None:
    body = arm.bodies[index]
    xx, xy, xz, yy, yz, zz = body.inertia.values()
    ElementTree.SubElement(
        element,
        "inertial",
        pos=numbers(body.com),
        mass=number(body.mass),
        fullinertia=numbers((xx, yy, zz, xy, xz, yz)),
    )


def _geoms(element: ElementTree.Element, segments: list[Segment]) -> None:
    for start, end, radius in segments:
        if np.array_equal(start, end):
            ElementTree.SubElement(element, "geom", type="sphere", pos=numbers(start), size=number(radius))
        else:
            ends = numbers([*start, *end])
            ElementTree.SubElement(element, "geom", type="capsule", fromto=ends, size=number(radius))


def _motors(arm: ExportedArm, tendons: ElementTree.Element, actuators: ElementTree.Element) -> None:
    """An actuator per motor; where several joints move it, at a fixed tendon with the motor's inertia and friction.

    A constant bias beside the control holds the offset: force = ctrl − Fo.
    """
    model, terms = arm.model, arm.motors
    for motor, (name, limits) in enumerate(zip(model.joint_names, model.limits, strict=True)):
        attributes = {"name": name}
        row = arm.coupling[motor]
        if arm.coupled[motor]:
            tendon = ElementTree.SubElement(
                tendons,
                "fixed",
                name=name,
                armature=number(terms.inertia[motor]),
                damping=number(terms.viscous[motor]),
                frictionloss=number(terms.coulomb[motor]),
            )
            _shares(tendon, model.joint_names, row)
            attributes["tendon"] = name
        else:
            joint = int(np.flatnonzero(row)[0])
            attributes |= {"joint": model.joint_names[joint], "gear": number(row[joint])}
        if terms.offset[motor]:
            attributes |= {"biastype": "affine", "biasprm": numbers((-terms.offset[motor], 0.0, 0.0))}
        if limits.torque is not None:
            attributes["ctrlrange"] = numbers((-limits.torque, limits.torque))
        ElementTree.SubElement(actuators, "general", attributes)


def _shares(tendon: ElementTree.Element, names: tuple[str, ...], factors: FloatArray) -> None:
    for index in np.flatnonzero(factors):
        ElementTree.SubElement(tendon, "joint", joint=names[index], coef=number(factors[index]))


def _loops(
    arm: ExportedArm,
    bodies: dict[int, ElementTree.Element],
    tendons: ElementTree.Element,
    equalities: ElementTree.Element,
) -> None:
    transmission, names = arm.model.transmission, arm.model.link_names
    if isinstance(transmission, LinearTransmission):
        for index in set(range(len(names))) - set(transmission.active):
            row = np.zeros(len(names))
            row[list(transmission.active)] = -transmission.follow[index]
            row[index] = 1.0
            _linear_equation(
                tendons, equalities, names, row, float(transmission.offset[index]), f"{names[index]}_follows"
            )
    elif isinstance(transmission, ClosedLoops):
        equations = transmission.equations
        for number_, (row, right) in enumerate(zip(equations.linear, equations.right, strict=True), start=1):
            _linear_equation(tendons, equalities, names, row, float(right), f"loop_equation_{number_}")
        _closing_frames(arm, transmission, bodies, equalities)


def _linear_equation(
    tendons: ElementTree.Element,
    equalities: ElementTree.Element,
    names: tuple[str, ...],
    row: FloatArray,
    right: float,
    name: str,
) -> None:
    """Σ row·q = right: of one or two joints as an equality of joints, of more as one of a fixed tendon's length."""
    involved = np.flatnonzero(row)
    if len(involved) <= 2:
        first, *others = sorted(involved, key=lambda index: abs(row[index]), reverse=True)
        attributes = {"name": name, "joint1": names[first]}
        slope = 0.0
        if others:
            attributes["joint2"] = names[others[0]]
            slope = -row[others[0]] / row[first]
        ElementTree.SubElement(
            equalities, "joint", attributes, polycoef=numbers((right / row[first], slope, 0.0, 0.0, 0.0))
        )
        return
    _shares(ElementTree.SubElement(tendons, "fixed", name=name), names, row)
    ElementTree.SubElement(equalities, "tendon", name=name, tendon1=name, polycoef=numbers((right, 0.0, 0.0, 0.0, 0.0)))


def _closing_frames(
    arm: ExportedArm, transmission: ClosedLoops, bodies: dict[int, ElementTree.Element], equalities: ElementTree.Element
) -> None:
    """Points of the two closing frames that meet; a second pair on the axes where one pair leaves them free to turn."""
    model = arm.model
    joint_numbers = {joint.name: index for index, joint in enumerate(model.joints)}
    loops = [loop for loop in arm.robot_file.robot.model.loops if loop.passive is not None]
    frames = [*place_tree(model.joints, transmission.start), (np.eye(3), np.zeros(3))]
    for count, (loop, chain) in enumerate(zip(loops, transmission.equations.chains, strict=True), start=1):
        ends = loop_ends(loop, joint_numbers)
        axes = [(frames[link][0] @ rotation)[:, 2] for link, (rotation, _) in ends]
        same = 1.0 if float(axes[0] @ axes[1]) > 0 else -1.0
        jacobian = chain.at(transmission.start[:, None]).jacobian()[:, :, 0]
        one_does = np.linalg.matrix_rank(jacobian, tol=RANK) == np.linalg.matrix_rank(jacobian[:3], tol=RANK)
        for point in range(1 if one_does else 2):
            sites = []
            for side, (link, (rotation, translation)) in enumerate(ends, start=1):
                along = SECOND_POINT * point * (same if side == 2 else 1.0)
                name = f"loop_{count}_{'ab'[point]}{side}"
                ElementTree.SubElement(
                    bodies[link], "site", name=name, pos=numbers(translation + along * rotation[:, 2]), size="0.005"
                )
                sites.append(name)
            ElementTree.SubElement(
                equalities, "connect", name=f"loop_{count}_{'ab'[point]}", site1=sites[0], site2=sites[1]
            )


def _keyframe(arm: ExportedArm, root: ElementTree.Element, world: ElementTree.Element) -> None:
    """A pose within the limits at which all loops close, with the torques that hold it against gravity."""
    model, home = arm.model, arm.home
    order = {joint.name: index for index, joint in enumerate(model.joints)}
    tree = model.tree_position(home)
    # MuJoCo numbers joints as they stand in the file, depth first.
    position = [tree[order[joint.get("name", "")]] for joint in world.iter("joint")]
    still = np.zeros((model.dof, 1))
    holding = arm.dynamics.torque(home[:, None], still, still)[:, 0]
    motors = np.linalg.solve(arm.coupling.T, holding)
    limits = [np.inf if limit.torque is None else limit.torque for limit in model.limits]
    key = ElementTree.SubElement(root, "keyframe")
    ElementTree.SubElement(
        key, "key", name="home", qpos=numbers(position), ctrl=numbers(np.clip(motors, -np.array(limits), limits))
    )
