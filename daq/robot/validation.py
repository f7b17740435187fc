"""Make a `Robot` of a robot file's keys, or list everything that is wrong with them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from daq.robot.references import name_problems, names_in, row_problems, rows_in
from daq.robot.schema import Robot
from drivers.core.errors import RobotFileError
from drivers.core.validation import YamlProblem, first_of, key_path, meaning, schema_problems

TODO = "TODO"
"""Prefix of a value that is still to be filled in (`dynid robot new` writes it)."""
STILL_TODO = f"is still to be filled in ({TODO})"


def validated_robot(content: Mapping[Any, Any], where: str, sliding: Collection[str]) -> Robot:
    """A robot from the keys of its file.

    Limits of joints that slide, whose names are `sliding`, are in m.

    Raises:
        RobotFileError: about the first problem; its `problems` are all of them.
    """
    missing = [
        YamlProblem(key_path(location), STILL_TODO, meaning(Robot, location)) for location in _todo_locations(content)
    ]
    invalid: list[YamlProblem] = []
    robot = None
    try:
        robot = Robot.model_validate(content, context={"sliding": sliding})
    except ValidationError as error:
        invalid = list(schema_problems(error, Robot))
        messages = {problem.message for problem in invalid}
        invalid += [problem for problem in _about_names(content) if problem.message not in messages]
    unfilled = {problem.key_path for problem in missing}
    # A name that is still to be filled in fits nowhere; that needs no second message.
    problems = [
        problem for problem in invalid if problem.key_path not in unfilled and not (missing and TODO in problem.message)
    ] + missing
    if robot is not None and not problems:
        return robot
    refused = first_of(problems, where=where, refusal=RobotFileError)
    refused.problems = tuple(first_of([problem], where=where, refusal=RobotFileError) for problem in problems)
    raise refused


def _about_names(content: Mapping[Any, Any]) -> Iterator[YamlProblem]:
    """Problems of joint names in a file with invalid values, where pydantic's own check of the names did not run."""
    for message in row_problems(rows_in(content)):
        yield YamlProblem("model", message, "")
    if (names := names_in(content)) is not None:
        for message in name_problems(names):
            yield YamlProblem("", message, "")


def _todo_locations(content: Mapping[Any, Any]) -> Iterator[tuple[int | str, ...]]:
    # An alias of YAML may stand in many places, or within itself: each mapping and list is looked into once.
    waiting: list[tuple[tuple[int | str, ...], Any]] = [((), content)]
    seen: set[int] = set()
    while waiting:
        location, value = waiting.pop()
        if isinstance(value, str) and value.startswith(TODO):
            yield location
        elif isinstance(value, Mapping | list) and id(value) not in seen:
            seen.add(id(value))
            entries = enumerate(value) if isinstance(value, list) else value.items()
            waiting += reversed(
                [((*location, key if isinstance(key, int) else str(key)), entry) for key, entry in entries]
            )
