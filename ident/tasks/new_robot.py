"""The file of a new robot: from a URDF, an installed robot description, or a number of joints (`dynid robot new`)."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from daq.output_files import check_outputs, replace_files
from daq.robot.loader import URDF_SUFFIXES, RobotFile, parse_robot
from daq.robot.new_robot import ArmGuess, new_robot_of_joints, new_robot_of_urdf, unknown_positions
from daq.robot.urdf_check import urdf_file_text
from daq.robot.urdf_robot import UrdfArm, read_urdf_arm
from daq.robot.validation import TODO
from drivers.core.errors import UsageError
from drivers.core.ranges import JOINTS
from drivers.core.text import did_you_mean

DESCRIPTIONS = "robot_descriptions"
"""Package of robot descriptions by name; it clones their repositories when they are first asked for."""


@dataclass(frozen=True)
class NewRobot:
    """A robot file that was written."""

    path: Path  # of the file
    text: str  # its content
    arm: UrdfArm | None  # content of the URDF; None where there was none
    guess: ArmGuess  # what was guessed beyond it
    unknown: tuple[str, ...] | None  # joints whose position limits the URDF does not state; None where there is no URDF

    @property
    def todo(self) -> int:
        """Return how many values no command runs without are still to be filled in."""
        return sum(line.partition("#")[0].count(TODO) for line in self.text.splitlines())


def new_robot_file(
    source: str | Path | None,
    joints: int | None = None,
    out: Path | None = None,
    *,
    overwrite: bool = False,
    progress: Callable[[str], None] = lambda step: None,
) -> NewRobot:
    """Write the file of a new robot.

    Args:
        source: a URDF, or the name of a description of the package robot_descriptions; None for modified DH rows.
        joints: number of joints, where there is no URDF.
        out: the file to write; the arm's name in the current folder where None.
        overwrite: whether it may exist already.
        progress: called with the name of each step.

    Raises:
        UsageError: neither or both of `source` and `joints`; `out` exists, cannot be written or is no YAML file's name;
            no such description, or it cannot be had.
        RobotFileError: the URDF cannot be read, or is no arm.
    """
    if (source is None) == (joints is None):
        raise UsageError("give either a URDF or --joints", hint="dynid robot new arm.urdf")
    if joints is not None and not 1 <= joints <= int(JOINTS.most):
        raise UsageError(f"--joints {joints} is not from 1 to {int(JOINTS.most)}")
    progress("finding the URDF")
    urdf, shared = (None, False) if source is None else _urdf_of(source)
    path = out or Path(f"{'my_arm' if urdf is None else re.sub(r'[^A-Za-z0-9_.-]+', '_', urdf.stem)}.yaml")
    if path.suffix.lower() not in {".yaml", ".yml"}:
        raise UsageError(f"'{path}' is not a name for a robot file", where="--out", hint="end it in .yaml")
    check_outputs([path], [urdf], overwrite=overwrite)
    if urdf is None:
        new = NewRobot(path, new_robot_of_joints(joints or 0), None, ArmGuess(), None)
    else:
        progress("looking at shapes and poses")
        new = _of_urdf(urdf, path, absolute=shared)
    replace_files({path: new.text})
    return new


def _of_urdf(urdf: Path, path: Path, *, absolute: bool) -> NewRobot:
    from ident.checks.urdf_guess import guess_of_urdf

    xml = urdf_file_text(urdf)
    arm = read_urdf_arm(xml, urdf.name, where=str(urdf), one_arm=True)
    place = urdf.resolve() if absolute else Path(os.path.relpath(urdf.resolve(), path.resolve().parent))
    unknown = unknown_positions(arm)
    stated = new_robot_of_urdf(arm, place.as_posix()).replace(f"[{TODO}, {TODO}]", "[-1, 1]")
    guess = guess_of_urdf(_parsed(stated, urdf, path, xml), limited=not unknown)
    text = new_robot_of_urdf(arm, place.as_posix(), guess)
    if not unknown:
        _parsed(text, urdf, path, xml)
    return NewRobot(path, text, arm, guess, unknown)


def _parsed(text: str, urdf: Path, path: Path, xml: str) -> RobotFile:
    """The robot file; errors name the URDF, which is what can be wrong."""
    return parse_robot(text, where=str(urdf), folder=path.resolve().parent, urdf_text=xml)


def _urdf_of(source: str | Path) -> tuple[Path, bool]:
    """The URDF that is meant, and whether it belongs to an installed package."""
    path = Path(source)
    if path.suffix.lower() in URDF_SUFFIXES | {".xacro"} or path.exists() or len(path.parts) > 1:
        return path, False
    return _of_description(str(source)), True


def _of_description(name: str) -> Path:
    """The URDF of a description by name, which is cloned where it is not in the package's cache.

    Raises:
        UsageError: the package is not installed, knows no such description, or cannot clone it; or it is no URDF.
    """
    spec = find_spec(DESCRIPTIONS)
    if spec is None:
        hint = f"give the path of a URDF; names need the package: pip install {DESCRIPTIONS.replace('_', '-')}"
        raise UsageError(f"no file and no robot description is called '{name}'", hint=hint)
    folders = spec.submodule_search_locations or ()
    packages = sorted(file.stem for folder in folders for file in Path(folder).glob("*_description.py"))
    module = name if name.endswith("_description") else f"{name}_description"
    if module not in packages or module.startswith("_"):
        hint = did_you_mean(module, packages) or f"{len(packages)} are known: python -m {DESCRIPTIONS} list"
        raise UsageError(f"{DESCRIPTIONS} has no '{name}'", hint=hint)
    try:
        description = import_module(f"{DESCRIPTIONS}.{module}")
    except Exception as error:  # of git, of the network, of a package that it needs
        reason = next(
            (line.strip() for line in reversed(str(error).splitlines()) if line.strip()), type(error).__name__
        )
        hint = "it is downloaded at first use: connect this computer once, or give the path of a URDF"
        raise UsageError(f"{DESCRIPTIONS} cannot get '{module}': {reason}", hint=hint) from error
    urdf = getattr(description, "URDF_PATH", None)
    if urdf is None:
        kind = "a xacro" if hasattr(description, "XACRO_PATH") else "an MJCF"
        hint = "convert it: xacro FILE > arm.urdf" if kind == "a xacro" else "another description may be a URDF"
        raise UsageError(f"'{module}' is {kind} file, not a URDF", hint=hint)
    return Path(urdf)
