"""A URDF's text, and what is wrong with its numbers and size, said before a kinematics library reads it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path

from drivers.core.errors import RobotFileError
from drivers.core.files import URDF_FILE, read_text
from drivers.core.ranges import INERTIA, LENGTH, MASS, NUMBER, Range
from drivers.core.terminal import unfit_name

MOST_LINKS = 1000
MOST_MOVABLE = 200
"""Links of a URDF; its parser calls itself for each along a chain, and a humanoid with hands has 100."""
LEAST_AXIS = 1e-6
"""Length of a joint's axis; a shorter one is no direction."""
MOVING = ("revolute", "continuous", "prismatic", "planar")
ANGLE = Range(-1e4, 1e4, "rad")
"""Angles of an `rpy`: some exporters add turns."""


_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_PREFIXED = re.compile(r"[<\s/]([A-Za-z_][\w.-]*):[A-Za-z_]")


def urdf_file_text(path: Path, hint: str = "") -> str:
    """The text of a URDF, as XML that every parser takes.

    ROS takes files with blank lines before the XML declaration, and with tags and attributes of other programs
    (`drake:acceleration`) whose namespace is not declared: the first go, the second are declared.

    Raises:
        RobotFileError: as `read_text`.
    """
    text = read_text(path, URDF_FILE, RobotFileError, hint).lstrip()
    used = dict.fromkeys(_PREFIXED.findall(_COMMENT.sub("", text)))
    missing = [prefix for prefix in used if f"xmlns:{prefix}" not in text and prefix not in ("xml", "xmlns")]
    declared = "".join(f' xmlns:{prefix}="urn:{prefix}"' for prefix in missing)
    return re.sub(r"<robot\b", f"<robot{declared}", text, count=1) if declared else text


def checked_urdf(xml: str, where: str) -> ElementTree.Element:
    """The root element of a URDF whose size and numbers are sensible.

    Raises:
        RobotFileError: no XML, more links than `MOST_LINKS`, an axis without direction, numbers out of range; names
            the joint or link. A name that holds a control character.
    """
    if _is_xacro(xml):
        raise RobotFileError("is a xacro file, not a URDF", where=where, hint="convert it: xacro FILE > arm.urdf")
    root, problem = _checked(xml)
    if problem is not None:
        hint = "dynid reads URDFs only: take the arm's own" if root is not None and root.tag in _OTHERS else ""
        raise RobotFileError(problem[1], where=f"{where}: {problem[0]}" if problem[0] else where, hint=hint)
    assert root is not None
    return root


_XACRO = re.compile(r"<\w+:(?:macro|include|property|arg|if|unless)\b|=\s*[\"'][^\"'<>]*\$[({]")
"""Tags of xacro, and attributes that it fills in: `${mass}`, `$(arg name)`."""


@lru_cache(maxsize=16)
def _is_xacro(xml: str) -> bool:
    """Comments aside: converted files keep those of their xacro."""
    return _XACRO.search(_COMMENT.sub("", xml)) is not None


_OTHERS = {"mujoco": "an MJCF file", "sdf": "an SDF file"}


class _UrdfError(ValueError):
    """A problem; the message is all but its place."""


@lru_cache(maxsize=16)
def _checked(xml: str) -> tuple[ElementTree.Element | None, tuple[str, str] | None]:
    try:
        root = ElementTree.fromstring(xml)
    except (ElementTree.ParseError, ValueError) as error:  # a NUL, or an encoding that is not known
        return None, ("", f"is not a URDF: {error}")
    if root.tag != "robot":
        return root, ("", f"is {_OTHERS.get(root.tag, f'XML of <{root.tag}>')}, not a URDF")
    count = sum(1 for _ in root.iter("link"))
    if count > MOST_LINKS:
        return root, ("", f"has {count} links; at most {MOST_LINKS} are read")
    movable = sum(1 for joint in root.iter("joint") if joint.get("type") in MOVING)
    if movable > MOST_MOVABLE:
        return root, ("", f"has {movable} movable joints; at most {MOST_MOVABLE} are read")
    if problem := _name_problem(root):
        return root, ("", problem)
    place = ""
    try:
        for joint in root.findall("joint"):
            place = f"joint {joint.get('name', '')}"
            _check_joint(joint)
        for link in root.findall("link"):
            place = f"link {link.get('name', '')}"
            _check_link(link)
    except _UrdfError as error:
        return root, (place, str(error))
    return root, None


def _name_problem(root: ElementTree.Element) -> str:
    for element in root.iter():
        for key in ("name", "link", "joint"):
            if (name := element.get(key)) and (unfit := unfit_name(name)):
                return f"has a {element.tag} whose {key} {unfit}; change it"
    nameless = next((child.tag for child in root if child.tag in ("joint", "link") and not child.get("name")), "")
    return f"has a {nameless} without a name; give it one" if nameless else ""


def _check_joint(joint: ElementTree.Element) -> None:
    _check_origin(joint)
    axis = joint.find("axis")
    if axis is not None and joint.get("type") in MOVING:
        values = _numbers(axis, "xyz", NUMBER, count=3)
        if values and sum(value * value for value in values) < LEAST_AXIS**2:
            raise _UrdfError("has an axis of length 0, which is not a direction")
    for tag in ("limit", "mimic", "dynamics"):
        element = joint.find(tag)
        for name in () if element is None else element.keys():
            if name != "joint" and not name.startswith("{"):  # another program's
                _numbers(element, name, _UNBOUNDED if tag == "limit" else NUMBER, count=1)


def _check_link(link: ElementTree.Element) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    _check_origin(inertial)
    for tag, allowed in (("mass", MASS), ("inertia", INERTIA)):
        element = inertial.find(tag)
        for name in () if element is None else element.keys():
            _numbers(element, name, allowed, count=1)


def _check_origin(owner: ElementTree.Element) -> None:
    origin = owner.find("origin")
    if origin is not None:
        _numbers(origin, "xyz", LENGTH, count=3, what="an origin")
        _numbers(origin, "rpy", ANGLE, count=3, what="an origin")


_UNBOUNDED = Range(-1.8e308, 1.8e308)
"""Limits are checked where a robot file takes them over; it may state others."""


def _numbers(
    element: ElementTree.Element | None, name: str, allowed: Range, *, count: int, what: str = ""
) -> tuple[float, ...]:
    """The numbers of an attribute; empty where it is absent."""
    if element is None or (text := element.get(name)) is None:
        return ()
    said = what or f"{'an' if element.tag[0] in 'aeiou' else 'a'} {element.tag}"
    try:
        values = tuple(float(word) for word in text.split())
    except ValueError:
        raise _UrdfError(f"has {said} that is not a number") from None
    if len(values) != count:
        raise _UrdfError(f"has {said} that is not {'three numbers' if count == 3 else 'one number'}")
    for value in values:
        if not abs(value) < float("inf"):
            raise _UrdfError(f"has {said} that is not finite")
        if not allowed.holds(value):
            raise _UrdfError(f"has {said} whose {name} holds {value:g}, which is not within {allowed}")
    return values
