"""Reading and writing result.json."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

from pydantic import ValidationError

from daq.output_files import replace_files, warn_of_strange_files
from drivers.core.errors import ResultFileError
from drivers.core.files import RESULT_FILE, read_text
from ident.result.schema import RESULT_SCHEMA, Result
from ident.stored import Stored

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
    where = str(path)
    try:
        content = json.loads(read_text(path, RESULT_FILE, ResultFileError))
    except (ValueError, RecursionError) as error:  # also a number of more than 4,300 digits
        raise ResultFileError(f"is not JSON: {error}", where=where) from error
    if isinstance(content, dict) and content.get("kind") == "servo":
        raise ResultFileError(
            "is a servo model, which has no torques",
            where=where,
            hint="dynid validate and dynid export --mjcf take it, and in Python dynid.load_servo_model",
        )
    if not isinstance(content, dict) or content.get("kind") != "result":
        raise ResultFileError("is not a result of dynid identify (no key 'kind': 'result')", where=where)
    schema = content.get("dynid_schema")
    if not isinstance(schema, int) or schema > RESULT_SCHEMA:
        raise ResultFileError(
            f"has schema version {schema}, this dynid reads up to {RESULT_SCHEMA}", where=where, hint="update dynid"
        )
    warn_of_strange_files(path, content)
    try:
        return Result.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(str(key) for key in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise ResultFileError(message, where=f"{where}: {key}" if key else where, hint="identify again") from error


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
