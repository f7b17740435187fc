"""The command `dynid`: one Typer application put together from the entry points `dynid.commands`.

Only Typer is imported here: `dynid --help` must not wait for NumPy, SciPy or Pinocchio. Command modules follow the
same rule and import what they need inside the command.
"""

from __future__ import annotations

import json
import os
import sys
from importlib.metadata import entry_points
from typing import NoReturn

import typer

from drivers.errors import INTERRUPTED_STATUS, DynidError, InputError
from drivers.terminal import show_visibly

COMMANDS_GROUP = "dynid.commands"
USAGE_STATUS = 2

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Set to 1 unless the user has set them, before NumPy is imported: dynid multiplies many small matrices, for which a
second BLAS thread costs more than it brings, and on a busy machine a hundred times more."""


def build_app() -> typer.Typer:
    """The application with the commands of every installed package; one that cannot be imported is named on stderr."""
    app = typer.Typer(
        name="dynid",
        help="Record a robot arm and identify its dynamic model.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # or units in brackets are taken for markup and vanish from the help
    )
    app.callback()(_root)
    for entry in sorted(entry_points(group=COMMANDS_GROUP), key=lambda entry: entry.name):
        try:
            app.add_typer(entry.load())
        except Exception as error:  # a third party's package must not take the others down
            print(f"dynid: the commands of {entry.value} could not be loaded: {error}", file=sys.stderr)
    return app


def _show_version(value: bool) -> None:
    if value:
        from importlib.metadata import version

        print(f"dynid {version('dynid')}")
        raise typer.Exit


def _root(
    version: bool = typer.Option(
        False, "--version", help="Print the version and leave.", is_eager=True, callback=_show_version
    ),
) -> None:
    """Record a robot arm and identify its dynamic model."""


def report_error(error: DynidError, as_json: bool) -> None:
    """Print an error as one line on stderr, or as one JSON object on stdout where `--json` was asked for."""
    if as_json:
        print(json.dumps({"error": error.message, "where": error.where, "hint": error.hint}))
    else:
        print(f"dynid: {error}", file=sys.stderr)


def main() -> None:
    """Run the command line: exit status 0 done, 1 the work failed, 2 bad usage or input, 130 interrupted."""
    as_json = "--json" in sys.argv[1:]
    show_visibly()
    for variable in BLAS_THREADS:
        os.environ.setdefault(variable, "1")
    try:
        status = build_app()(standalone_mode=False)
    except DynidError as error:
        report_error(error, as_json)
        sys.exit(error.exit_status)
    except (KeyboardInterrupt, typer.Abort):
        _exit_interrupted()
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:  # a folder that cannot be written, a full disk
        report_error(InputError(error.strerror or str(error), where=str(error.filename or "")), as_json)
        sys.exit(USAGE_STATUS)
    except Exception as error:
        # Click's usage errors carry their own wording; everything else is a bug and keeps its traceback.
        if not hasattr(error, "format_message"):
            raise
        _report_usage(error, as_json)
        sys.exit(USAGE_STATUS)
    if status == INTERRUPTED_STATUS:  # what Typer makes of Ctrl-C within a command
        _exit_interrupted()
    sys.exit(status if isinstance(status, int) else 0)


def _exit_interrupted() -> NoReturn:
    print("dynid: interrupted", file=sys.stderr)
    sys.exit(INTERRUPTED_STATUS)


def _report_usage(error: Exception, as_json: bool) -> None:
    message = error.format_message()  # type: ignore[attr-defined]
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "dynid"
    report_error(DynidError(message, where=command, hint=f"see {command} --help"), as_json)
