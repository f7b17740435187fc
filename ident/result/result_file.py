"""Reading and writing result.json."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from daq.output_files import replace_files, warn_of_strange_files
from drivers.core.errors import ResultFileError
from drivers.core.files import RESULT_FILE, read_text
from ident.result.schema import RESULT_SCHEMA, Result
from ident.stored import Stored

Kind = TypeVar("Kind", bound=BaseModel)

_NUMBERS = re.compile(r"\[\n[-+.0-9eEnul,\s]+\]")
"""A list of nothing but numbers, which stands in one line."""


def write_result(path: Path, result: Result) -> None:
    """Write result.json.

    Raises:
        UsageError, DiskError: it cannot be written.
    """
    replace_files({path: result_file_text(result)})


def result_file_text(result: Result) -> str:
    """The text of result.json."""
    return result_json(result) + "\n"


def result_json(result: Result) -> str:
    """The JSON text of a result."""
    return model_json(result)


def model_json(result: Stored) -> str:
    """The JSON text of any kind of result, strict: null stands for what is not a number."""
    text = json.dumps(json.loads(result.model_dump_json()), ensure_ascii=False, indent=1, allow_nan=False)
    return _NUMBERS.sub(lambda match: re.sub(r"\s+", " ", match[0]), text)


def read_result(path: Path) -> Result:
    """Read a result.json.

    Raises:
        ResultFileError: no such file, no JSON, another kind of file, a newer schema, a missing key.
    """
    content = read_content(path)
    if content.get("kind") == "servo":
        raise ResultFileError(
            "is a servo model, which has no torques",
            where=str(path),
            hint="dynid validate and dynid export --mjcf take it, and in Python dynid.load_servo_model",
        )
    if content.get("kind") == "gravity":
        raise ResultFileError(
            "is a model of gravity, which knows no torque of a motion",
            where=str(path),
            hint="dynid validate and dynid export --c take it, and in Python dynid.load_model(…).gravity(q)",
        )
    check_kind(content, path, "result", "dynid identify")
    check_schema(content, path, RESULT_SCHEMA)
    warn_of_strange_files(path, content)
    return stored(Result, content, path, "identify again")


def read_content(path: Path) -> dict[str, Any]:
    """The object of a JSON file of some result; empty where the JSON is no object.

    Raises:
        ResultFileError: no such file, or no JSON.
    """
    try:
        content = json.loads(read_text(path, RESULT_FILE, ResultFileError))
    except (ValueError, RecursionError) as error:  # also a number of more than 4,300 digits
        raise ResultFileError(f"is not JSON: {error}", where=str(path)) from error
    return content if isinstance(content, dict) else {}


def check_kind(content: Mapping[str, Any], path: Path, kind: str, command: str) -> None:
    """Refuse a result of another kind than the command writes.

    Raises:
        ResultFileError: it is one.
    """
    if content.get("kind") != kind:
        raise ResultFileError(f"is not a result of {command} (no key 'kind': '{kind}')", where=str(path))


def check_schema(content: Mapping[str, Any], path: Path, newest: int) -> None:
    """Refuse a file of a later dynid.

    Raises:
        ResultFileError: it is one, or does not say.
    """
    schema = content.get("dynid_schema")
    if not isinstance(schema, int) or schema > newest:
        raise ResultFileError(
            f"has schema version {schema}, this dynid reads up to {newest}", where=str(path), hint="update dynid"
        )


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
        message = first["msg"].removeprefix("Value error, ")
        raise ResultFileError(message, where=f"{path}: {key}" if key else str(path), hint=hint) from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
