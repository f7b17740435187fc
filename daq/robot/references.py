"""Names that a robot file's sections use for its joints: whether they are consistent, with all problems at once.

The same rules are applied to a valid file and to the names of one whose values are partly wrong, so that a user sees
of a misspelt joint together with everything else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from daq.robot.loops import BASE
from drivers.core.text import counted

OF_JOINTS = (
    ("friction", "joints"),
    ("servo",),
    ("truth", "joints"),
    ("truth", "thermal", "copper_loss"),
    ("truth", "noise", "torque_std"),
    ("truth", "noise", "ripple_amplitude"),
)
"""Mappings of a robot file whose keys are joints that motors move."""


@dataclass(frozen=True)
class JointNames:
    """The names of joints in a robot file."""

    joints: tuple[str, ...]  # of `joints`, those that motors move
    rows: tuple[str, ...] | None  # of `model.mdh`; None where the kinematics are a URDF's
    passive: tuple[str, ...]  # those that `model.loops` makes follow
    driven: tuple[str, ...]  # of `drives`
    keys: tuple[tuple[str, tuple[str, ...]], ...]  # section → the joints that it names
    link_keys: tuple[tuple[str, tuple[str, ...]], ...]  # section → the links that it names, by their joints
    poses: tuple[tuple[str, int], ...]  # name of a pose → number of its positions


def row_problems(rows: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """Problems of the names (joint, antecedent) of an MDH table's rows."""
    problems, names = [], [BASE]
    for joint, antecedent in rows:
        if joint == BASE:
            problems.append("a joint is named 'base'")
        elif joint in names:
            problems.append(f"'mdh' names joint '{joint}' twice")
        if antecedent not in names:
            allowed = ", ".join(sorted(names))
            problems.append(f"joint '{joint}' has antecedent '{antecedent}', but before it come only: {allowed}")
        names.append(joint)
    return tuple(dict.fromkeys(problems))


def name_problems(names: JointNames) -> tuple[str, ...]:
    """Problems of the names of a robot file."""
    joints, links = names.joints, (*names.joints, *names.passive)
    problems = [f"'joints' names '{name}' twice" for name in _repeated(joints)]
    if names.rows is not None:
        problems += [
            f"'model.loops' names joint '{name}', but 'model.mdh' has no such row"
            for name in names.passive
            if name not in names.rows
        ]
        rows = tuple(name for name in names.rows if name not in names.passive)
        if rows != joints:
            expected, listed = ", ".join(rows), ", ".join(joints)
            problems.append(f"'joints' must name the joints of 'model.mdh' in its order: {expected}; found: {listed}")
    problems += [f"'drives' names '{name}' twice" for name in _repeated(names.driven)]
    for section, keys in (("drives", names.driven), *names.keys):
        problems += [
            f"'{section}' names joint '{key}', but 'joints' has only: {', '.join(joints)}"
            for key in keys
            # A passive joint among the drives has a message of its own, see `schema.Robot`.
            if key not in joints and not (section == "drives" and key in names.passive)
        ]
    for section, keys in names.link_keys:
        allowed = links if section in ("truth.links", "prior.links") else (BASE, *links)
        problems += [
            f"'{section}' names '{key}', but there are only: {', '.join(allowed)}" for key in keys if key not in allowed
        ]
    problems += [
        f"'poses.{name}' has {counted(count, 'position')}, but the arm has {len(joints)} joints: {', '.join(joints)}"
        for name, count in names.poses
        if count != len(joints)
    ]
    return tuple(dict.fromkeys(problems))


def names_in(content: Mapping[Any, Any]) -> JointNames | None:
    """The names in a robot file that is not valid as a whole; None where they cannot be read, or depend on loops."""
    model = content.get("model")
    if not isinstance(model, Mapping) or model.get("loops"):
        return None
    joints = _texts(content.get("joints"), "name")
    rows = _texts(model.get("mdh"), "joint") if model.get("mdh") is not None else None
    if not joints or rows == ():
        return None
    poses = _mapping(content.get("poses"))
    return JointNames(
        joints=joints,
        rows=rows,
        passive=(),
        driven=_texts(content.get("drives"), "joint"),
        keys=tuple((".".join(path), _keys(content, path)) for path in OF_JOINTS),
        link_keys=tuple((f"{name}.links", _keys(content, (name, "links"))) for name in ("truth", "prior")),
        poses=tuple((str(name), len(pose)) for name, pose in poses.items() if isinstance(pose, list)),
    )


def rows_in(content: Mapping[Any, Any]) -> tuple[tuple[str, str], ...]:
    """(joint, antecedent) of the MDH rows of such a file; empty where one of them cannot be read."""
    table = _mapping(content.get("model")).get("mdh")
    joints = _texts(table, "joint")
    if table is None or not joints:
        return ()
    return tuple((joint, str(row.get("antecedent", BASE))) for joint, row in zip(joints, table, strict=True))


def sliding_in(content: Mapping[Any, Any]) -> frozenset[str]:
    """Names of the joints whose MDH rows in such a file say that they slide."""
    table = _mapping(content.get("model")).get("mdh")
    rows = [row for row in table if isinstance(row, Mapping)] if isinstance(table, list) else []
    return frozenset(str(row.get("joint")) for row in rows if row.get("type") == "prismatic")


def urdf_in(content: Mapping[Any, Any]) -> str | None:
    """The path of the URDF that such a file names."""
    urdf = _mapping(content.get("model")).get("urdf")
    return urdf if isinstance(urdf, str) else None


def _repeated(names: Sequence[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]


def _mapping(value: Any) -> Mapping[Any, Any]:
    return value if isinstance(value, Mapping) else {}


def _keys(content: Mapping[Any, Any], path: Sequence[str]) -> tuple[str, ...]:
    for key in path:
        content = _mapping(content.get(key))
    return tuple(key for key in content if isinstance(key, str))


def _texts(entries: Any, key: str) -> tuple[str, ...]:
    """The text under a key of each entry of a list; empty where one of them has none."""
    if not isinstance(entries, list):
        return ()
    texts = tuple(entry[key] for entry in entries if isinstance(entry, dict) and isinstance(entry.get(key), str))
    return texts if len(texts) == len(entries) else ()
