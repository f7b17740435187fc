"""The errors of all four packages.

    DynidError
    ├── InputError                 exit status 2: what the user gave is wrong, nothing was done
    │   ├── UsageError             options that contradict each other or do not exist
    │   │   └── ArgumentError      a function of Python has no such argument, or lacks one
    │   ├── MotionRefusedError     a motion that is not safe or was not confirmed; nothing was moved
    │   ├── RobotFileError         a robot file or the URDF that it names
    │   ├── RecordingError         an HDF5 recording: truncated, foreign, newer, half-written
    │   ├── ImportFileError        a CSV, npz, mat, bag or MCAP file that cannot be taken over as it is
    │   ├── DataError              a readable recording that does not allow what was asked
    │   └── ResultFileError        a result.json
    └── WorkError                  exit status 1: the input was fine, the work failed
        ├── IdentificationError    no solution: rank lost, no convergence
        ├── ModelError             an identified model cannot give what was asked of it
        ├── ConnectionFailedError  no answer, or not from the expected device
        ├── ConnectionLostError    the connection broke or went silent while recording
        ├── DriverStateError       a driver was asked for something that its state does not allow
        ├── DiskError              a file cannot be written any more: the disk is full or fails
        └── SafetyStopError        a limit was passed and the arm was stopped

A message names what was wrong; `where` the file, key, joint or sample; `hint` what to do. `ValueError` and `TypeError`
are raised only for mistakes in calling code (an array of the wrong shape), never for a user's input.
"""

from __future__ import annotations

import errno

INTERRUPTED_STATUS = 130
"""Exit status of a command that Ctrl-C ended."""


class DynidError(Exception):
    """An error meant for people.

    Attributes:
        message: what was wrong, one line.
        where: file, key path, joint or sample; empty when the message says it.
        hint: what to do about it; empty when there is nothing to say.
        exit_status: of the command `dynid`.

    Example:
        >>> import dynid
        >>> try:
        ...     dynid.load_robot("ur5")
        ... except dynid.DynidError as error:
        ...     error.message, error.hint
        ("no built-in robot and no file is called 'ur5'", "did you mean 'ur5e'?")
    """

    exit_status = 1

    def __init__(self, message: str, *, where: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.message = " ".join(message.split())
        self.where = " ".join(where.split())
        self.hint = " ".join(hint.split())

    def __str__(self) -> str:
        text = f"{self.where}: {self.message}" if self.where else self.message
        return f"{text} ({self.hint})" if self.hint else text


class DynidWarning(UserWarning):
    """A warning meant for people, about something that does not stop the work."""


class InputError(DynidError):
    """What the user gave is wrong; nothing was done."""

    exit_status = 2


class UsageError(InputError):
    """Options that contradict each other or do not exist."""


class ArgumentError(UsageError, TypeError):
    """A function of Python has no such argument, or lacks one; it is a TypeError, too, as Python's own are."""


class MotionRefusedError(InputError):
    """A motion comes too near to something or needs too much torque, or was not confirmed; nothing was moved."""


class RobotFileError(InputError):
    """A robot file, or the URDF that it names, cannot be used.

    Attributes:
        problems: an error about each thing that is wrong with the file, this one included; empty where only one was
            looked for.
    """

    problems: tuple[RobotFileError, ...] = ()


class RecordingError(InputError):
    """An HDF5 recording cannot be read or written."""


class ImportFileError(InputError):
    """A foreign file cannot be taken over as it is."""


class DataError(InputError):
    """A readable recording does not allow what was asked of it."""


class ResultFileError(InputError):
    """A result file cannot be read."""


class WorkError(DynidError):
    """The input was fine, the work failed."""


class IdentificationError(WorkError):
    """No solution was found: rank lost, or no convergence."""


class ModelError(WorkError):
    """An identified model cannot give what was asked: a value is missing, or its inertia matrix is not positive."""


class ConnectionFailedError(WorkError):
    """No answer at the other end of a connection, or not from the expected device."""


class ConnectionLostError(WorkError):
    """A connection broke, or went silent, while it was in use."""


class DriverStateError(WorkError):
    """A driver was asked for something that its state does not allow."""


class DiskError(WorkError):
    """A file cannot be written any more: the disk is full or fails."""


class SafetyStopError(WorkError):
    """A limit was passed and the arm was stopped."""


def out_of_memory(error: BaseException) -> bool:
    """Whether an error, or what caused it, is the system's refusal of memory, of a thread or of a library's pages."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError) or (isinstance(cause, OSError) and cause.errno == errno.ENOMEM):
            return True
        said = str(cause) if isinstance(cause, (ImportError, RuntimeError, OSError)) else ""
        if any(words in said for words in ("failed to map segment", "allocate memory", "start new thread")):
            return True
        cause = cause.__cause__ or cause.__context__
    return False
