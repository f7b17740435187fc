"""The command `dynid`: one Typer application put together from the entry points `dynid.commands`.

Only Typer is imported here: `dynid --help` must not wait for NumPy, SciPy or Pinocchio. Command modules follow the
same rule and import what they need inside the command.
"""

from __future__ import annotations

import atexit
import gc
import json
import os
import sys
import warnings
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

import typer

from daq.commands.help_text import CONTEXT, GroupedCommands
from daq.output_files import DISK_ERRORS, outputs_of_a_command
from drivers.core.errors import (
    INTERRUPTED_STATUS,
    DiskError,
    DynidError,
    DynidWarning,
    InputError,
    UsageError,
    WorkError,
    out_of_memory,
)
from drivers.core.files import check_utf8
from drivers.core.options import spoken_in_a_shell
from drivers.core.terminal import drop_unwritten, open_standard_streams, show_visibly

COMMANDS_GROUP = "dynid.commands"

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Set to 1 unless the user has set them, before NumPy is imported: dynid multiplies many small matrices, for which a
second BLAS thread costs more than it brings, and on a busy machine a hundred times more."""

OBJECTS_PER_COLLECTION, COLLECTIONS_PER_SECOND_LOOK = 10_000, 100
"""New objects after which Python looks for cycles, and how many times it does before it looks at those that stayed;
otherwise 700 and 10. Imports make many that stay, and to go through them again and again takes 6 % of an
identification."""


def build_app(word: str = "") -> typer.Typer:
    """The application with the commands of every installed package; one that cannot be imported is named on stderr.

    An entry point is a Typer application, or a dictionary of modules by command, each with an `app`. Where `word` is a
    command of such a dictionary, only its module is imported.
    """
    app = typer.Typer(
        name="dynid",
        cls=GroupedCommands,
        context_settings=CONTEXT,
        invoke_without_command=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # or units in brackets are taken for markup and vanish from the help
    )
    app.callback()(_root)
    modules: dict[str, str] = {}
    for entry in sorted(entry_points(group=COMMANDS_GROUP), key=lambda entry: entry.name):
        try:
            commands = entry.load()
            if isinstance(commands, dict):
                modules |= commands
            else:
                app.add_typer(commands)
        except Exception as error:  # a third party's package must not take the others down
            if out_of_memory(error):
                raise
            print(f"dynid: the commands of {entry.value} could not be loaded: {error}", file=sys.stderr)
    for module in [modules[word]] if word in modules else dict.fromkeys(modules.values()):
        app.add_typer(import_module(module).app)
    return app


def _root(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", help="Print the version; --verbose: all for a bug report."),
    verbose: bool = typer.Option(False, "--verbose", "-v", hidden=True),
) -> None:
    """Record a robot arm and identify its dynamic model.

    Every command has --help with an example. First steps: dynid demo.
    """
    if version:
        print("\n".join([*_versions(), _compiled()] if verbose else _versions()[:1]))
        raise typer.Exit
    if context.invoked_subcommand is None:
        print(context.get_help())
    elif verbose:
        raise UsageError("--verbose belongs behind a command", hint=f"dynid {context.invoked_subcommand} … --verbose")


def _versions() -> list[str]:
    """Versions of dynid, Python, the system, and of what dynid requires, a line each."""
    import platform
    import re
    from importlib.metadata import PackageNotFoundError, requires, version

    lines = [
        f"dynid {version('dynid')}",
        f"Python {platform.python_version()} at {sys.executable}",
        f"{platform.platform()}, {os.cpu_count()} cores",
        f"dynid at {os.path.dirname(__file__)}",
    ]
    names = [re.match(r"[\w.-]+", text) for text in requires("dynid") or () if "extra ==" not in text]
    for name in sorted(match.group() for match in names if match):
        try:
            lines.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            lines.append(f"{name} not installed")
    return lines


def _compiled() -> str:
    """Return where the compiled kernels are, or why there are none."""
    from ident.compiled.library import kernels

    return f"compiled kernels: {kernels().said}"


def report_error(error: DynidError, as_json: bool) -> None:
    """Print an error as one line on stderr, or as one JSON object on stdout where `--json` was asked for."""
    if as_json:
        print(json.dumps({"error": error.message, "where": error.where, "hint": error.hint}))
    else:
        with suppress(OSError):  # the exit status says the rest
            print(f"dynid: {error}", file=sys.stderr)


def main() -> None:
    """Run the command line: exit status 0 done, 1 the work failed, 2 bad usage or input, 130 interrupted."""
    open_standard_streams()
    show_visibly()
    for variable in BLAS_THREADS:
        os.environ.setdefault(variable, "1")
    if not os.environ.get("SOURCE_DATE_EPOCH", "0").isdecimal():
        del os.environ["SOURCE_DATE_EPOCH"]  # NumPy's f2py, which SciPy imports, reads it and breaks
    gc.set_threshold(OBJECTS_PER_COLLECTION, COLLECTIONS_PER_SECOND_LOOK)
    atexit.register(gc.freeze)  # or Python searches all that imports made for cycles once more
    try:
        status = _status("--json" in sys.argv[1:])
        sys.stdout.flush()
    except OSError as error:  # of standard output or standard error
        with suppress(OSError):
            if not isinstance(error, BrokenPipeError):
                print(f"dynid: standard output cannot be written: {error.strerror}", file=sys.stderr, flush=True)
        status = WorkError.exit_status
    finally:
        drop_unwritten()
    sys.exit(status)


def _status(as_json: bool) -> int:
    """Run the command; its exit status.

    Raises:
        OSError: standard output or standard error cannot be written.
    """
    try:
        with warnings.catch_warnings(), outputs_of_a_command(), spoken_in_a_shell():
            warnings.simplefilter("always", DynidWarning)
            warnings.showwarning = partial(_show_warning, warnings.showwarning)
            for argument in sys.argv[1:]:
                folder, name = os.path.split(argument)  # a folder may have any name: files hold names without it
                check_utf8(name if os.path.isdir(folder.partition("=")[2] or folder) else argument, UsageError)
            status = build_app(*sys.argv[1:2])(prog_name="dynid", standalone_mode=False)
    except DynidError as error:
        report_error(error, as_json)
        return error.exit_status
    except (KeyboardInterrupt, typer.Abort):
        status = INTERRUPTED_STATUS
    except Exception as error:
        sys.stdout.flush()  # fails again where that is the reason
        user_error = _user_error(error)
        if user_error is None:  # a bug, which keeps its traceback
            raise
        report_error(user_error, as_json)
        return user_error.exit_status
    if status == INTERRUPTED_STATUS:  # Typer returns it after Ctrl-C within a command
        print("dynid: interrupted", file=sys.stderr)
    return status if isinstance(status, int) else 0


def _user_error(error: Exception) -> DynidError | None:
    """The message for an error of the system, or of the command's usage; None for a bug."""
    if out_of_memory(error):
        return WorkError(
            "needs more memory than it may have", hint="close other programs, raise the limit, or give it less at once"
        )
    if isinstance(error, OSError):  # a folder that cannot be written, a full disk
        kind = DiskError if error.errno in DISK_ERRORS else InputError
        if error.filename is None and not _working_folder_exists():
            return InputError("the working folder does not exist any more", hint="cd to one that does")
        return kind(error.strerror or str(error), where=str(error.filename or ""))
    if hasattr(error, "format_message"):  # Click's own wording
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "dynid"
        where = command.removeprefix("dynid").strip()
        return UsageError(error.format_message().rstrip("."), where=where, hint=f"see {command} --help")
    return None


def _working_folder_exists() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _show_warning(others: Any, message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    """A warning meant for people as one line; any other as Python shows it."""
    if issubclass(category, DynidWarning):
        print(f"dynid: warning: {message}", file=sys.stderr)
    else:
        others(message, category, *place, **more)
