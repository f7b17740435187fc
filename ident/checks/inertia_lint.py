"""What is wrong with the masses, inertias and limits of a robot's description, link by link (`dynid lint`)."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from daq.robot.loader import URDF_SUFFIXES, RobotFile, load_robot, parse_robot, read_robot_text
from daq.robot.new_robot import new_robot_of_urdf
from daq.robot.urdf_robot import MOVABLE, UrdfArm, link_of, origin_of, read_urdf_arm
from daq.robot.validation import TODO
from drivers.core.arrays import FloatArray
from drivers.core.errors import RobotFileError
from drivers.core.text import rounded
from ident.linear_algebra.vectors import rotation_of
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.rigid_arm import RigidArm, rigid_arm
from ident.model.kinematics.urdf import urdf_inertias
from ident.model.kinematics.urdf_shapes import UnusableShapeError, lengths, mesh_folders, mesh_vertices, placed_shape
from ident.model.parameters import inertia_tensor, link_parameters

TRIANGLE = 1.01
"""Largest principal moment over the sum of the others from which on no body has them; published digits are rounded."""

WIDEST, SPREAD, POINT = 0.6, 3.0, 0.02
"""Radius of gyration over the diagonal of the link's box that no body has (its corners: 0.5); moments over those of a
uniform box that are doubted, above and below."""

CERTAIN = 10.0
"""Moments over those of a uniform box that no foot or tool at a link's end explains."""

FARTHEST, POINT_OF_REACH = 2.0, 1e-3
"""The same where only the way to the next joint is known, which a short link's housing exceeds."""

DENSEST, LIGHTEST = 12_000.0, 15.0
"""[kg/m³] of a link's box, beyond that of lead, and below that of foam."""

NEIGHBOURS = 30.0
"""Factor between a link's mass and those of both of its neighbours that looks like a misplaced decimal point."""

OUTSIDE = 0.25
"""Share of the box's diagonal that a centre of mass may be outside of it: covers and cables are in no mesh."""

SLIPS = {
    1e6: "mm² instead of m²",
    1e3: "g instead of kg",
    1e2: "a decimal point that is off by two places",
    10.0: "a misplaced decimal point",
    1e-3: "g for kg·m²",
    1e-2: "a decimal point that is off by two places",
}
"""Inertia over that of a uniform body, and what may have been mistaken."""

ROUND = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)
"""Values that are typed in where none are known."""

POSES = 300
"""Random poses in which gravity is looked at."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or doubtful."""

    severity: Literal["error", "note"]  # "error" where nothing that uses the value can be right, else "note"
    check: str  # name of the check
    links: tuple[str, ...]  # names of the links or joints
    what: str  # what was found
    why: str  # why it matters
    remedy: str  # what to do

    def __str__(self) -> str:
        return f"{self.severity}: {', '.join(self.links)}: {self.what}; {self.why}: {self.remedy} [{self.check}]"


@dataclass(frozen=True, eq=False)
class LintedBody:
    """A link as its description has it, in its own frame."""

    name: str  # of the link
    parent: int  # index of the link that carries it; -1 for the base
    mass: float  # [kg]; 0 where none is stated
    com: FloatArray  # (3,) centre of mass [m]
    inertia: FloatArray  # (3, 3) about it [kg·m²]
    box: FloatArray | None  # corners (2, 3) of what its shapes take [m]; None where they are not known
    reach: float  # distance [m] to the farthest joint that it carries

    @property
    def size(self) -> float:
        """Diagonal of its box, else twice its reach [m]; 0 where neither is known."""
        return 2.0 * self.reach if self.box is None else float(np.linalg.norm(self.box[1] - self.box[0]))


@dataclass(frozen=True)
class LintReport:
    """What `dynid lint` found."""

    name: str  # of the robot
    links: int  # how many links that move were looked at
    findings: tuple[Finding, ...]  # errors first

    @property
    def untrusted(self) -> tuple[str, ...]:
        """Names of links whose mass or inertia no controller can trust, in the order of the findings."""
        errors = (finding for finding in self.findings if finding.severity == "error" and finding.check != "gravity")
        return tuple(dict.fromkeys(link for finding in errors for link in finding.links))


def lint(robot: str) -> LintReport:
    """Look at the masses, inertias and limits of a URDF, a robot file or a built-in robot.

    A URDF's links are looked at as it states them, else those of the robot file's `truth`.

    Raises:
        RobotFileError: it cannot be read, or states no link.
    """
    if Path(robot).suffix.lower() in URDF_SUFFIXES:
        xml = read_robot_text(Path(robot))
        arm: UrdfArm = read_urdf_arm(xml, Path(robot).name, where=robot, one_arm=True)
        text = new_robot_of_urdf(arm, Path(robot).name).replace(f"[{TODO}, {TODO}]", "[-1, 1]")
        robot_file = parse_robot(text, where=robot, folder=Path(robot).resolve().parent, urdf_text=xml)
        limits = [(joint.name, joint.torque, joint.velocity) for joint in arm.joints]
    else:
        robot_file = load_robot(robot)
        limits = [(joint.name, joint.torque, joint.velocity) for joint in robot_file.robot.joints]
    model = build_model(robot_file)
    bodies = bodies_of_urdf(robot_file) if robot_file.urdf_text else bodies_of_truth(robot_file, model)
    if not any(body.mass > 0.0 for body in bodies):
        raise RobotFileError(
            "states no mass for any moving link",
            where=robot_file.where,
            hint="use masses from CAD, or identify the arm: its inertias cannot be judged",
        )
    findings = [*link_findings(bodies), *gravity_findings(model, _arm(robot_file, model)), *limit_findings(limits)]
    if not any(_rotor(robot_file, name) for name in robot_file.robot.joint_names):
        findings.append(
            Finding(
                "note",
                "rotor",
                (robot_file.robot.name,),
                "no rotor inertia is stated",
                "behind a gear it is often more than the link's own, and a URDF cannot state it",
                "identify it; an MJCF has armature, a robot file drives[].armature or known: {Ia1: …}",
            )
        )
    errors_first = sorted(findings, key=lambda finding: finding.severity != "error")
    return LintReport(robot_file.robot.name, len(bodies), tuple(errors_first))


def _rotor(robot_file: RobotFile, joint: str) -> bool:
    robot = robot_file.robot
    truth = robot.truth.joints.get(joint)
    stated = robot.drive(joint).armature is not None or not robot.drive(joint).inertia
    return stated or f"Ia{robot.joint_names.index(joint) + 1}" in robot.known or bool(truth and truth.motor_inertia)


def _arm(robot_file: RobotFile, model: DynamicModel) -> RigidArm:
    """The arm with the bodies that are stated, fixed links summed up; those without mass weigh nothing."""
    inertial = np.zeros((len(model.joints), 10))
    for index, body in enumerate(urdf_inertias(robot_file, model.link_names)):
        if body is not None:
            inertial[index] = link_parameters(body[0], body[1].tolist(), body[2][np.triu_indices(3)].tolist())
    for index, name in enumerate(model.link_names):
        if not robot_file.urdf_text and (link := robot_file.robot.truth.links.get(name)) is not None:
            inertial[index] = link_parameters(link.mass, link.com, link.inertia)
    return rigid_arm(model, inertial.ravel(), np.zeros(model.dof))


def bodies_of_truth(robot_file: RobotFile, model: DynamicModel) -> tuple[LintedBody, ...]:
    """The links of `truth`, in the frames of their joints; those that it does not name have no mass."""
    bodies = []
    for index, joint in enumerate(model.joints):
        carried = [float(np.linalg.norm(other.translation)) for other in model.joints if other.parent == index]
        reach = max(carried, default=0.0)
        link = robot_file.robot.truth.links.get(joint.name)
        mass, com, inertia = (
            (0.0, np.zeros(3), np.zeros((3, 3)))
            if link is None
            else (link.mass, np.array(link.com), inertia_tensor(link.inertia))
        )
        bodies.append(LintedBody(joint.name, joint.parent, mass, com, inertia, None, reach))
    return tuple(bodies)


def bodies_of_urdf(robot_file: RobotFile) -> tuple[LintedBody, ...]:
    """The links of a URDF that a joint moves, each as it stands there, but fixed ones without an inertial."""
    root = ElementTree.fromstring(robot_file.urdf_text or "<robot/>")
    joints = [joint for joint in root.findall("joint") if joint.find("child") is not None]
    by_child = {link_of(joint, "child"): joint for joint in joints}
    folders = mesh_folders(robot_file)
    bodies: list[LintedBody] = []
    places: dict[str, int] = {}
    for link in _from_the_base([link.get("name", "") for link in root.findall("link")], by_child):
        above: str | None = link
        moved = False
        while above in by_child:
            moved |= by_child[above].get("type") in MOVABLE
            above = link_of(by_child[above], "parent")
        if not moved:
            continue
        element = next(candidate for candidate in root.findall("link") if candidate.get("name") == link)
        mass, com, inertia = _inertial(element)
        fixed = by_child[link].get("type") == "fixed"
        if fixed and mass == 0.0 and not inertia.any():  # a frame
            continue
        carried = [origin_of(joint, "")[0] for joint in joints if link_of(joint, "parent") == link]
        above = link_of(by_child[link], "parent")
        while above not in places and above in by_child:
            above = link_of(by_child[above], "parent")
        places[link] = len(bodies)
        reach = max((float(np.linalg.norm(offset)) for offset in carried), default=0.0)
        bodies.append(LintedBody(link, places.get(above, -1), mass, com, inertia, _box(element, folders), reach))
    return tuple(bodies)


def _from_the_base(links: Sequence[str], by_child: dict[str, ElementTree.Element]) -> list[str]:
    def depth(link: str) -> int:
        steps = 0
        while link in by_child and steps <= len(by_child):
            steps, link = steps + 1, link_of(by_child[link], "parent")
        return steps

    return sorted(links, key=depth)


def _inertial(link: ElementTree.Element) -> tuple[float, FloatArray, FloatArray]:
    """Mass, centre and inertia about it in the link's axes."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    com, angles = origin_of(inertial, "")
    rotation = np.asarray(rotation_of(*angles))
    mass, moments = inertial.find("mass"), inertial.find("inertia")
    stated = {} if moments is None else moments.attrib
    values = [float(stated.get(key, 0.0)) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")]
    return float(0.0 if mass is None else mass.get("value", 0.0)), com, rotation @ inertia_tensor(values) @ rotation.T


class _Origin:
    """The placement of a link's shapes in its own frame."""

    rotation = np.eye(3)
    translation = np.zeros(3)


def _box(link: ElementTree.Element, folders: Sequence[Path]) -> FloatArray | None:
    """Corners (2, 3) of all shapes of a link; None where there is none, or one cannot be read."""
    corners = []
    for element in (*link.findall("collision"), *link.findall("visual")):
        try:
            shape = placed_shape(element, _Origin)
            kind = shape.element.tag
            if kind == "mesh":
                points = mesh_vertices(shape, folders)
                corners += [points.min(axis=0), points.max(axis=0)]
                continue
            if kind == "box":
                half = 0.5 * lengths(shape, "size")
            elif kind == "sphere":
                half = np.repeat(lengths(shape, "radius"), 3)
            else:
                radius, length = lengths(shape, "radius", "length")
                half = np.array([radius, radius, 0.5 * length + (radius if kind == "capsule" else 0.0)])
            spread = np.abs(shape.rotation) @ half
            corners += [shape.centre - spread, shape.centre + spread]
        except UnusableShapeError:
            return None
    return None if not corners else np.array([np.min(corners, axis=0), np.max(corners, axis=0)])


# --- the checks -------------------------------------------------------------------------------------------------------


def link_findings(bodies: Sequence[LintedBody]) -> Iterator[Finding]:
    """What is wrong with each link by itself, then with several beside each other."""
    placeholders = _placeholders(bodies)
    for body in bodies:
        if body.name not in placeholders:
            yield from _of_one(body)
    if placeholders:
        yield Finding(
            "error",
            "placeholder",
            tuple(placeholders),
            "mass or inertia is a round number, the same in all axes",
            "such values are placeholders",
            "use values from CAD, or identify the arm",
        )
    yield from _copies(bodies, placeholders)
    for body in bodies:
        near = [other.mass for other in bodies if other.parent >= 0 and bodies[other.parent] is body and other.mass > 0]
        if body.parent >= 0 and near and body.mass > 0 and bodies[body.parent].mass > 0:
            masses = [bodies[body.parent].mass, *near]
            if body.mass > NEIGHBOURS * max(masses) or NEIGHBOURS * body.mass < min(masses):
                yield Finding(
                    "note", "decimal-slip", (body.name,),
                    f"{body.mass:.3g} kg between links of {' and '.join(f'{mass:.3g}' for mass in masses)} kg",
                    "it looks like a misplaced decimal point, or g for kg", "compare it with CAD or a scale",
                )  # fmt: skip


def _of_one(body: LintedBody) -> Iterator[Finding]:
    name, mass, inertia = (body.name,), body.mass, body.inertia
    if mass <= 0.0:
        what = "has an inertia but no mass" if np.any(inertia) else "moves and has no mass"
        yield Finding(
            "error", "mass", name, what, "simulators reject it or become unstable", "state mass, centre and inertia",
        )  # fmt: skip
        return
    moments: FloatArray = np.asarray(np.linalg.eigvalsh(inertia), dtype=np.float64)
    if moments[0] < 0.0 or moments[2] > TRIANGLE * (moments[0] + moments[1]) or not moments[2] > 0.0:
        listed = ", ".join(f"{moment:.3g}" for moment in moments)
        central = _moved(body)
        hint = "state it about the centre of mass, in kg·m², with the signs of the URDF (ixy = -∫xy dm)"
        yield Finding(
            "error", "triangle", name,
            "its inertia is zero"
            if not np.any(inertia)
            else f"no body has the principal moments {listed} kg·m²"
            + ("" if central is None else " (they are one's about the link's origin)"),
            "each must be positive and below the sum of the other two, or energy is created", hint,
        )  # fmt: skip
        return
    yield from _spread(body, moments)
    yield from _placed(body)


def _moved(body: LintedBody) -> FloatArray | None:
    """Inertia about the centre of mass if the stated one is about the link's origin; None if no body has it then."""
    central = body.inertia - body.mass * (body.com @ body.com * np.eye(3) - np.outer(body.com, body.com))
    moments = np.linalg.eigvalsh(central)
    possible = moments[0] > 0.0 and moments[2] <= TRIANGLE * (moments[0] + moments[1])
    return central if possible else None


def _spread(body: LintedBody, moments: FloatArray) -> Iterator[Finding]:
    """How far the mass is spread, against the size of the link."""
    size = body.size
    if not size > 0.0:
        return
    gyration = math.sqrt(0.5 * float(moments.sum()) / body.mass)
    sides = np.full(3, size / math.sqrt(3.0)) if body.box is None else body.box[1] - body.box[0]
    uniform = body.mass * float(sides @ sides) / 6.0
    ratio = float(moments.sum()) / uniform
    where = "its box" if body.box is not None else "twice the distance to the next joint"
    wide = gyration > (WIDEST if body.box is not None else FARTHEST) * size
    central = _moved(body) if ratio > SPREAD and body.com @ body.com > (0.1 * size) ** 2 else None
    if central is not None and float(np.trace(central)) < SPREAD * uniform:
        moved = float(np.trace(central)) / uniform
        yield Finding(
            "error" if wide and ratio > CERTAIN else "note", "origin", (body.name,),
            f"its inertia is {rounded(ratio)} times a uniform body's; {rounded(moved)} times if it is about the link's "
            "origin",
            "a URDF means the centre of mass (origin of <inertial>)", "move it there: subtract m·(c²·1 - c·cᵀ)",
        )  # fmt: skip
        return
    slip = next((words for factor, words in SLIPS.items() if 0.5 < ratio / factor < 2.0), "a wrong unit or link")
    if wide:
        yield Finding(
            "error" if body.box is not None and ratio > CERTAIN else "note", "gyration", (body.name,),
            f"its mass is spread over a radius of gyration of {gyration:.3g} m, {where} being {size:.3g} m long: "
            f"{rounded(ratio)} times the inertia of a uniform body",
            f"it looks like {slip}", "compare it with CAD",
        )  # fmt: skip
    elif ratio < (POINT if body.box is not None else POINT_OF_REACH):
        yield Finding(
            "note", "gyration", (body.name,),
            f"its inertia is {ratio:.1g} times that of a uniform body of {size:.3g} m",
            f"as if it were a point; it looks like {slip}", "compare it with CAD",
        )  # fmt: skip


def _placed(body: LintedBody) -> Iterator[Finding]:
    """Findings on where the centre of mass is, and on how heavy the link is for its size."""
    if body.box is None:
        distance = float(np.linalg.norm(body.com))
        if body.reach > 0.0 and distance > 2.0 * body.reach + 0.1:
            yield Finding(
                "note", "centre", (body.name,),
                f"the centre of mass is {distance:.3g} m from the link's frame, the next joint {body.reach:.3g} m",
                "gravity torques follow from it", "check that it is in m, and in the link's own frame",
            )  # fmt: skip
        return
    outside = float(np.linalg.norm(np.maximum(0.0, np.maximum(body.box[0] - body.com, body.com - body.box[1]))))
    if outside > OUTSIDE * body.size:
        yield Finding(
            "error", "centre", (body.name,),
            f"the centre of mass is {outside:.3g} m outside of the link's shapes, which are {body.size:.3g} m long",
            "gravity torques follow from it", "check that it is in m, and in the link's own frame",
        )  # fmt: skip
    volume = float(np.prod(np.maximum(body.box[1] - body.box[0], 1e-3)))
    density = body.mass / volume
    if not LIGHTEST <= density <= DENSEST:
        comparison = "denser than lead" if density > DENSEST else "lighter than foam"
        yield Finding(
            "error" if density > DENSEST else "note", "mass", (body.name,),
            f"{body.mass:.3g} kg in a box of {volume * 1e3:.3g} l is {density:.2g} kg/m³",
            f"that is {comparison}", "check that the mass is in kg, and the mesh in m (scale)",
        )  # fmt: skip


def _placeholders(bodies: Sequence[LintedBody]) -> dict[str, None]:
    """Links whose three moments are one round number; or whose mass is, as several links' masses are."""

    def is_round(value: float) -> bool:
        return any(math.isclose(value, figure, rel_tol=1e-9) for figure in ROUND)

    names: dict[str, None] = {}
    ones = [body for body in bodies if math.isclose(body.mass, 1.0, rel_tol=1e-12)]
    for body in bodies:
        diagonal = np.diag(body.inertia)
        same = not np.any(body.inertia - np.diag(diagonal)) and np.ptp(diagonal) == 0.0
        if body.mass > 0.0 and ((same and is_round(float(diagonal[0]))) or (len(ones) > 2 and body in ones)):
            names[body.name] = None
    return names


def _copies(bodies: Sequence[LintedBody], placeholders: Collection[str]) -> Iterator[Finding]:
    """Links, one carrying the next, that share mass and moments to the last digit."""
    groups: dict[tuple[float, ...], list[LintedBody]] = {}
    for body in bodies:
        if body.mass > 0.0 and np.any(body.inertia) and body.name not in placeholders:
            key = (body.mass, *np.sort(np.round(np.linalg.eigvalsh(body.inertia), 12)).tolist())
            groups.setdefault(key, []).append(body)
    for group in groups.values():
        if len(group) > 1 and any(one.parent >= 0 and bodies[one.parent] in group for one in group):
            yield Finding(
                "note", "copied", tuple(body.name for body in group),
                "have the same mass and moments of inertia to the last digit",
                "similar links contain different motors and covers", "correct only if the parts are identical",
            )  # fmt: skip


def gravity_findings(model: DynamicModel, arm: RigidArm) -> Iterator[Finding]:
    """Joints whose torque limit does not hold the arm in its worst pose."""
    low, high = np.array([limits.position for limits in model.limits]).T
    positions = np.random.default_rng(0).uniform(low, high, (POSES, model.dof))
    worst = np.max([np.abs(arm.gravity(position)) for position in positions], axis=0)
    for limits, needed in zip(model.limits, worst, strict=True):
        if limits.torque is not None and needed > limits.torque:
            unit = limits.unit("N·m")
            yield Finding(
                "error", "gravity", (limits.name,),
                f"gravity needs {needed:.3g} {unit} in the worst pose, its torque limit is {limits.torque:.3g} {unit}",
                "the arm could not hold itself", "a mass is too large, or the limit a placeholder or the motor's own",
            )  # fmt: skip


def limit_findings(limits: Sequence[tuple[str, float | None, float | None]]) -> Iterator[Finding]:
    """Limits (name, effort, velocity) that are missing or look typed in."""
    for index, (word, matters) in enumerate(
        (("effort", "torques are not supervised"), ("velocity", "motions are slow"))
    ):
        values = {name: (effort, velocity)[index] for name, effort, velocity in limits}
        missing = tuple(name for name, value in values.items() if not value)
        if missing:
            yield Finding("note", "limit", missing, f"no {word} limit", matters, "state the data sheet's")
        stated = {value for value in values.values() if value}
        if len(values) > 2 and len(stated) == 1 and not missing and math.log10(next(iter(stated))) % 1 == 0.0:
            yield Finding(
                "note", "limit", tuple(values), f"every {word} limit is {next(iter(stated)):g}",
                "it looks like a placeholder", "state the data sheet's",
            )  # fmt: skip
