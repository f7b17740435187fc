"""Reading and writing result.json."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from daq.output_files import warn_of_strange_files, was_changed
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.errors import ResultFileError
from drivers.core.files import RESULT_FILE, read_text
from drivers.core.text import parsed_json
from drivers.core.validation import in_words_of_files
from ident.model.base_parameters import BaseParameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.joint_columns import quantity_of
from ident.model.parameters import INERTIAL
from ident.regression.estimate import Estimate
from ident.regression.observability import Experiment, experiment_base, whole_arm
from ident.result.estimate import AGAIN
from ident.result.schema import RESULT_SCHEMA, Result
from ident.stored import Stored

Kind = TypeVar("Kind", bound=BaseModel)

SERVO, GRAVITY = "servo", "gravity"
"""Kinds of results beside that of a whole model, in which the key says "result"."""

_NUMBERS = re.compile(r"\[\n[-+.0-9eEnul,\s]+\]")
"""A list of nothing but numbers, which stands in one line."""


def result_json(result: Stored) -> str:
    """The JSON text of any kind of result, strict: null stands for what is not a number."""
    return _NUMBERS.sub(lambda match: re.sub(r"\s+", " ", match[0]), result.model_dump_json(indent=1))


def read_result(path: Path) -> Result:
    """Read a result.json.

    Raises:
        ResultFileError: no such file, no JSON, another kind of file, a newer schema, a missing key.
    """
    content = read_content(path)
    if content.get("kind") == SERVO:
        raise ResultFileError(
            "is a servo model, which has no torques",
            where=str(path),
            hint="dynid validate, predict, diff and export --mjcf take it, and in Python dynid.load_servo_model",
        )
    if content.get("kind") == GRAVITY:
        raise ResultFileError(
            "is a model of gravity, which cannot predict torques of a motion",
            where=str(path),
            hint="dynid validate and dynid export --c take it, and in Python dynid.load_model(…).gravity(q)",
        )
    return checked(Result, content, path, "result", "dynid identify", RESULT_SCHEMA)


def checked(form: type[Kind], content: Mapping[str, Any], path: Path, kind: str, command: str, newest: int) -> Kind:
    """A result of a file's object.

    Raises:
        ResultFileError: another kind of file, a newer schema, a missing key.
    """
    check_kind(content, path, kind, command)
    schema = content.get("dynid_schema")
    if not isinstance(schema, int) or schema > newest:
        raise ResultFileError(
            f"has schema version {schema}, this version of dynid reads up to {newest}",
            where=str(path),
            hint="update dynid",
        )
    warn_of_strange_files(path, content)
    return stored(form, content, path, "identify again")


def kind_of(path: Path) -> str:
    """Return what kind of result a result.json says that it is; empty where it cannot be read."""
    try:
        return str(read_content(path).get("kind", ""))
    except ResultFileError:
        return ""


def read_content(path: Path) -> dict[str, Any]:
    """The object of a JSON file of some result; empty where the JSON is no object.

    Raises:
        ResultFileError: no such file, no JSON, or changed since it was written.
    """
    try:
        content = parsed_json(read_text(path, RESULT_FILE, ResultFileError))
    except ValueError as error:
        raise ResultFileError(f"is not JSON: {error}", where=str(path)) from error
    if not isinstance(content, dict):
        return {}
    if was_changed(content):
        hint = "identify again; if the change is meant, delete 'sha256' in it"
        raise ResultFileError("was changed after dynid wrote it: its verdict may not hold", where=str(path), hint=hint)
    return content


def check_kind(content: Mapping[str, Any], path: Path, kind: str, command: str) -> None:
    """Refuse a result of another kind than the command writes.

    Raises:
        ResultFileError: it is one.
    """
    if content.get("kind") != kind:
        raise ResultFileError(f"is not a result of {command} (no key 'kind': '{kind}')", where=str(path))


def stored(kind: type[Kind], content: Mapping[str, Any], path: Path, hint: str) -> Kind:
    """A result of a file's object.

    Raises:
        ResultFileError: a key is missing or wrong; names the first one.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(key) for key in first["loc"])
        message = in_words_of_files(first["msg"]).removeprefix("Value error, ")
        raise ResultFileError(message, where=f"{path}: {key}" if key else str(path), hint=hint) from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@dataclass(frozen=True)
class StoredModel:
    """The dynamic model that a result's parameters belong to."""

    robot_file: RobotFile  # stored beside them
    model: DynamicModel  # with the columns that were identified
    experiments: tuple[Experiment, ...]  # what the recordings make identifiable
    base: BaseParameters  # the base parameters of these experiments together


def stored_model(result: Result) -> StoredModel:
    """The model of a result.

    Raises:
        ResultFileError: its parts do not belong together.
    """
    robot_file = parse_robot(
        result.robot_file, where="the result's robot file", folder=None, urdf_text=result.urdf or None
    )
    options = result.model_options
    for name in ("motor_inertia", "viscous", "coulomb", "offset"):
        if len(getattr(options, name)) != robot_file.robot.dof:
            raise ResultFileError(
                f"{len(getattr(options, name))} flags for {robot_file.robot.dof} joints",
                where=f"model_options.{name}",
                hint=AGAIN,
            )
    model = replace(
        build_model(robot_file),
        motor_inertia=tuple(options.motor_inertia),
        viscous=tuple(options.viscous),
        coulomb=tuple(options.coulomb),
        offset=tuple(options.offset),
        smoothing=options.smoothing,
        terms=options.terms,
        presliding=() if result.presliding is None else tuple(result.presliding.by_parameter.items()),
    )
    link_free = [parameter for parameter in model.parameters if parameter.kind != "inertial"]
    rubbing = {parameter.name for parameter in link_free if quantity_of(parameter) == "coulomb"}
    if not rubbing.issuperset(name for name, _ in model.presliding):
        raise ResultFileError("names no Coulomb parameter of this model", where="presliding.travels", hint=AGAIN)
    load = options.terms.load_torque
    if load is not None and not all(0 <= column < len(INERTIAL) * len(model.joints) for column in load.columns):
        raise ResultFileError(
            "names columns that belong to no link", where="model_options.terms.load_torque", hint=AGAIN
        )
    if tuple(result.joints) != model.joint_names:
        raise ResultFileError(
            f"are not those of the robot file stored with them, {', '.join(model.joint_names)}",
            where="joints",
            hint=AGAIN,
        )
    experiments = tuple(
        stored.restored(model, f"experiments.{index}") for index, stored in enumerate(result.experiments)
    )
    experiments = experiments or (whole_arm(model),)
    base = experiment_base(model, experiments)
    joints = [model.link_names[joint] for joint in base.joints]
    if {(one.name, one.joint) for one in result.base_parameters} != set(zip(base.names, joints, strict=True)):
        raise ResultFileError("the base parameters do not belong to the robot file stored with them", hint=AGAIN)
    return StoredModel(robot_file, model, experiments, base)


def stored_estimate(result: Result, of: StoredModel) -> Estimate:
    """The estimate of a result, with its covariance.

    Raises:
        ResultFileError: there is none, or its parts do not belong together.
    """
    if result.estimate is None:
        raise ResultFileError("holds no covariance: it was written by an earlier dynid", hint=AGAIN)
    values = {entry.name: entry.value for entry in result.base_parameters}
    return result.estimate.restored(values, of.base, of.model)
