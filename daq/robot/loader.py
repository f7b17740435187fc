"""Reading robot files: built-in ones by name, others by path."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from importlib.resources import files
from os import PathLike
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from daq.robot.loops import BASE as BASE
from daq.robot.references import sliding_in, urdf_in
from daq.robot.schema import Robot
from daq.robot.urdf_check import urdf_file_text
from daq.robot.urdf_robot import assumed_of_urdf, read_urdf_arm, robot_text_of_urdf, urdf_prismatic_joints
from daq.robot.validation import validated_robot
from drivers.core.errors import RobotFileError
from drivers.core.files import ROBOT_FILE, given_kind, read_text
from drivers.core.text import did_you_mean
from drivers.core.validation import read_mapping

URDF_SUFFIXES = frozenset({".urdf", ".xml"})
BUILTIN_URDF = "builtin:"
"""Prefix of the name of a URDF that ships with dynid."""


class RobotFile(BaseModel):
    """A robot together with the text and the place that it was read from; result of `load_robot`.

    Its `robot` holds joints and limits [rad, rad/s, rad/s², N·m], drive gains [N·m/A or N·m/V] and the rest.

    Example:
        >>> import dynid
        >>> isinstance(dynid.load_robot("panda"), dynid.RobotFile)
        True
    """

    model_config = ConfigDict(defer_build=True, frozen=True)

    robot: Robot
    text: str = Field(description="the YAML as it was read")
    where: str = Field(description="what error messages call the file: its path, or the built-in robot's name")
    folder: Path | None = Field(description="folder that relative paths start from; None for a text without one")
    urdf_text: str | None = Field(default=None, description="the URDF's XML, where the model names one")
    assumed: tuple[str, ...] = Field(default=(), description="what was assumed where a URDF was read as a robot")

    def __repr__(self) -> str:
        return f"<dynid.RobotFile {self.robot.name}: {', '.join(self.robot.joint_names)}>"

    __str__ = __repr__

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that it comes from: itself, its URDF, those that its connections name; empty where it is built in."""
        if self.folder is None:
            return ()
        extras = [value for entry in self.robot.connections.values() for value in (entry.model_extra or {}).values()]
        names = [Path(self.where).name, self.robot.model.urdf, *extras]
        paths = [self.folder / os.path.expanduser(name) for name in names if isinstance(name, str)]
        return tuple(path for path in paths if os.path.isfile(path))

    @property
    def prismatic_joints(self) -> frozenset[str]:
        """Names of the joints with a motor that slide."""
        return frozenset(joint.name for joint in self.robot.joints if joint.sliding)


def builtin_robots() -> tuple[str, ...]:
    """Names of the built-in robot files, sorted.

    Example:
        >>> import dynid
        >>> "ur5e" in dynid.builtin_robots()
        True
    """
    return tuple(sorted(path.name[:-5] for path in files("daq.robot.builtin").iterdir() if path.name.endswith(".yaml")))


def load_robot(name_or_path: str | Path | RobotFile) -> RobotFile:
    """Read a built-in robot by name, or a robot file or URDF by path (a name that exists as a file is a path).

    A URDF gives every movable joint, in the tree's order, with the limits that it states, and its tool link; its
    drives have no gains, so that recordings need torque. `assumed` lists the assumptions in place of what is missing.
    Write a robot file for anything else: `dynid robot new` (`docs/robot-file.md`).

    A `RobotFile` is returned unchanged, so that callers may pass a name, a path or a `RobotFile`.

    Args:
        name_or_path: built-in name, path of a robot file or URDF, or the result of `load_robot`.

    Raises:
        RobotFileError: no such robot or file, or its content is not allowed; names file, key and what is allowed.

    Example:
        >>> import dynid
        >>> robot = dynid.load_robot("ur5e").robot
        >>> robot.dof, robot.joint_names[0], robot.drive("elbow_joint").signal
        (6, 'shoulder_pan_joint', 'current')
    """
    if isinstance(name_or_path, RobotFile):
        return name_or_path
    if not isinstance(name_or_path, (str, PathLike)):
        raise RobotFileError(f"{given_kind(name_or_path)} is neither a robot nor a path of one", hint='such as "ur5e"')
    given = str(name_or_path)
    path = Path(given)
    urdf = path.suffix.lower() in URDF_SUFFIXES
    built_in = given in builtin_robots()
    # A port or folder of that name, such as the simulated arm's own, is no robot file.
    if (
        urdf
        or path.suffix.lower() in {".yaml", ".yml"}
        or (path.is_file() if built_in else os.path.exists(path) and not path.is_dir())
    ):
        text = read_robot_text(path)
        assumed: tuple[str, ...] = ()
        if urdf:
            arm = read_urdf_arm(text, path.name, where=given)
            text, assumed = robot_text_of_urdf(arm, path.name, where=given), assumed_of_urdf(arm)
        return parse_robot(text, where=given, folder=path.resolve().parent).model_copy(update={"assumed": assumed})
    if not built_in:
        raise RobotFileError(f"no built-in robot and no file is called '{given}'", hint=_known_robots(given))
    text = files("daq.robot.builtin").joinpath(f"{given}.yaml").read_text(encoding="utf-8")
    return parse_robot(text, where=f"built-in {given}", folder=None)


def read_robot_text(path: Path) -> str:
    """The text of a robot file or URDF.

    Raises:
        RobotFileError: no such file, not a regular one, too large, or no UTF-8 text.
    """
    if path.suffix.lower() in URDF_SUFFIXES:
        return urdf_file_text(path, hint=_known_robots(str(path)))
    return read_text(path, ROBOT_FILE, RobotFileError, hint=_known_robots(str(path)))


def _known_robots(given: str) -> str:
    return did_you_mean(given, builtin_robots()) or f"built-in: {', '.join(builtin_robots())}"


def parse_robot(text: str, *, where: str, folder: Path | None, urdf_text: str | None = None) -> RobotFile:
    """Validate a robot file's text.

    Args:
        text: the YAML.
        where: its name in error messages.
        folder: base of a relative `model.urdf`.
        urdf_text: the URDF's XML where it is known already (a recording carries it); read from disk otherwise.

    Raises:
        RobotFileError: names the key path, the value and what is allowed.
    """
    robot = _robot(text, where, folder, urdf_text)
    if robot.model.urdf is not None and urdf_text is None:
        urdf_text = _read_urdf(robot.model.urdf, folder, where)
    if robot.model.mdh is not None:
        sliding = frozenset(row.joint for row in robot.model.mdh if row.type == "prismatic")
    else:
        sliding = urdf_prismatic_joints(urdf_text or "<robot/>")
    joints = tuple(joint.of_kind(sliding=joint.name in sliding) for joint in robot.joints)
    robot = robot.model_copy(update={"joints": joints})
    return RobotFile(robot=robot, text=text, where=where, folder=folder, urdf_text=urdf_text)


_MOST_READ = 64
_read: dict[str, Robot] = {}
"""Robots by text: reading the YAML takes 15 ms, and a recording's robot is read several times, under several names."""


def _robot(text: str, where: str, folder: Path | None, urdf_text: str | None) -> Robot:
    if (robot := _read.get(text)) is None:
        hint = "see a built-in one: dynid robot show ur5e --yaml"
        content = read_mapping(text, kind="a robot file", where=where, refusal=RobotFileError, hint=hint)
        if urdf_text is None and (urdf := urdf_in(content)) is not None:
            with suppress(RobotFileError):  # what is wrong with the robot file itself comes first
                urdf_text = _read_urdf(urdf, folder, where)
        robot = validated_robot(content, where, sliding_in(content) | urdf_prismatic_joints(urdf_text or "<robot/>"))
        if len(_read) >= _MOST_READ:
            del _read[next(iter(_read))]
        _read[text] = robot
    return robot


def _read_urdf(urdf: str, folder: Path | None, where: str) -> str:
    if urdf.startswith(BUILTIN_URDF):
        shipped = {path.name: path for path in files("daq.robot.builtin").iterdir() if path.name.endswith(".urdf")}
        name = urdf.removeprefix(BUILTIN_URDF)
        if name not in shipped:
            hint = f"built-in URDFs: {', '.join(sorted(shipped))}"
            raise RobotFileError(f"no built-in URDF is called '{name}'", where=f"{where}: model.urdf", hint=hint)
        return shipped[name].read_text(encoding="utf-8")
    path = Path(urdf)
    if not path.is_absolute() and not urdf.startswith("~"):
        if folder is None:
            raise RobotFileError(f"the relative path '{urdf}' has no base folder", where=f"{where}: model.urdf")
        path = folder / path
    try:
        return urdf_file_text(path.expanduser())
    except (RobotFileError, RuntimeError) as error:  # ~ of no user
        raise RobotFileError(
            f"cannot read the URDF {path}: {error.message if isinstance(error, RobotFileError) else error}",
            where=f"{where}: model.urdf",
            hint="a relative path starts at the robot file's folder",
        ) from error


SECTIONS = ("joints", "model", "workspace", "payload", "truth")
"""What limits, clearances and predicted torques of a motion depend on."""
_DIGITS = 12


def fingerprint(robot: Robot, urdf_text: str | None = None) -> dict[str, str]:
    """Section → the first digits of the SHA-256 of what it says; also of a URDF."""
    content = robot.model_dump(mode="json", include=set(SECTIONS))
    texts = {name: json.dumps(content.get(name), sort_keys=True) for name in SECTIONS}
    if urdf_text is not None:
        texts["urdf"] = urdf_text
    return {name: hashlib.sha256(text.encode()).hexdigest()[:_DIGITS] for name, text in texts.items()}


def changed_since(designed_for: Mapping[str, str], robot: Robot, urdf_text: str | None = None) -> str:
    """Say which sections differ from those that a motion was designed for; empty where none does."""
    now = fingerprint(robot, urdf_text)
    differ = [name for name, digits in designed_for.items() if now.get(name, digits) != digits]
    return f"the robot file changed since the motion was designed: {', '.join(differ)}" if differ else ""
