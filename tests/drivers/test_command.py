"""The command line's frame: start-up, exit statuses, errors as one line or one JSON object."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from importlib import import_module
from typing import TextIO

import pytest
from each import each

from daq.commands.app import app as daq_commands
from daq.commands.help_text import GROUPS
from daq.robot import loader
from drivers.core.errors import DataError, IdentificationError
from dynid import command
from ident.commands.app import app as ident_commands

HEAVY = ("numpy", "scipy", "pinocchio", "cvxpy", "h5py", "pydantic", "plotly", "rosbags")


def test_help_imports_nothing_heavy():
    code = (
        "import sys; sys.argv = ['dynid', '--help']\n"
        "from dynid.command import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"loaded = [name for name in {HEAVY!r} if name in sys.modules]\n"
        "sys.exit(f'loaded: {loaded}' if loaded else 0)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    for name in ("identify", "import", "info", "robot", "check", "validate", "demo"):
        assert name in done.stdout


def test_a_date_of_sources_that_is_no_number_breaks_nothing(run_dynid, monkeypatch):
    """NumPy's f2py, which SciPy imports, would end in a traceback over it."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "abc")
    assert run_dynid("--version")[0] == 0
    assert "SOURCE_DATE_EPOCH" not in os.environ


def test_every_command_has_help_with_an_example(run_dynid):
    for name in ("robot", "import", "check", "info", "identify", "validate", "demo"):
        status, out, _ = run_dynid(name, "--help")
        assert status == 0
        assert "Example: dynid" in out


def test_version(run_dynid):
    status, out, _ = run_dynid("--version")
    assert status == 0
    assert out.startswith("dynid 0.")


def test_bare_dynid_shows_commands_by_group_with_whole_summaries(run_dynid):
    status, out, err = run_dynid()
    assert (status, err) == (0, "")
    places = [out.index(f"\n{group}:\n") for group in GROUPS]
    assert places == sorted(places)
    assert "..." not in out.partition("Robot:")[2]
    assert run_dynid("-h")[:2] == (0, out)


def test_common_options_come_before_the_panels(run_dynid):
    _, out, _ = run_dynid("identify", "-h")
    order = ["\nOptions:", "--friction ", "\nModel:", "--friction-from", "\nSignals:", "--delay"]
    assert [out.index(text) for text in order] == sorted(out.index(text) for text in order)


def test_version_with_verbose_names_what_a_bug_report_needs(run_dynid):
    status, out, _ = run_dynid("--version", "--verbose")
    assert status == 0
    assert {"dynid", "Python", "numpy", "pin", "compiled"} <= {line.split()[0] for line in out.splitlines()}


def test_an_error_names_dynid_once(run_dynid):
    assert run_dynid("--nope")[2] == "dynid: No such option: --nope (see dynid --help)\n"
    assert run_dynid("identify")[2].startswith("dynid: identify: Missing argument 'recordings' (see ")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("robot show ur5", ["ur5e"]),
        ("check arms/m", ["arms/mine.yaml"]),
        ("identify run.h5 --validate ", ["arms/", "run.h5"]),
        ("record ur5e --trajectory arms/", ["arms/mine.yaml"]),
        ("mer", ["merge"]),
    ],
)
def test_tab_completes(run_dynid, monkeypatch, tmp_path, words, expected):
    (tmp_path / "arms").mkdir()
    (tmp_path / "arms" / "mine.yaml").touch()
    (tmp_path / "run.h5").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("_DYNID_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"dynid {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split(" "))))
    assert run_dynid()[1].split() == expected


@each(
    "arguments",
    [
        ["idntify"],
        ["identify"],
        ["info", "--nope"],
        ["robot", "show"],
        ["info", "--rate"],
        ["info", "a\udcff"],
        ["import", "x.csv", "--robot", "ur5e", "--comment", "a\udcff/b"],
        ["recover", "."],
    ],
)
def test_bad_usage_is_one_line_and_exit_2(run_dynid, arguments):
    status, out, err = run_dynid(*arguments)
    assert status == 2
    assert out == ""
    assert err.startswith("dynid:")
    assert len(err.strip().splitlines()) == 1


def test_bad_usage_with_json_is_an_object(run_dynid):
    status, out, err = run_dynid("info", "--json")
    assert status == 2
    assert err == ""
    assert set(json.loads(out)) == {"error", "where", "hint"}


@pytest.mark.parametrize(
    ("error", "status"), [(DataError("bad", where="x", hint="y"), 2), (IdentificationError("no"), 1)]
)
def test_errors_become_exit_statuses(run_dynid, monkeypatch, error, status):
    def fail() -> None:
        raise error

    monkeypatch.setattr(command, "build_app", lambda word: lambda **_: fail())
    assert run_dynid("anything")[0] == status


def test_error_text_is_one_line():
    error = DataError("first\nsecond", where="file\n.h5", hint="do\nthis")
    assert str(error) == "file .h5: first second (do this)"


def test_interrupt_exits_130(run_dynid, monkeypatch):
    def interrupted(**_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "build_app", lambda word: interrupted)
    status, _, err = run_dynid("anything")
    assert (status, err) == (130, "dynid: interrupted\n")


def test_a_broken_third_party_package_is_named_and_left_out(run_dynid, monkeypatch):
    from importlib.metadata import EntryPoint

    broken = EntryPoint("broken", "no_such_package.commands:app", command.COMMANDS_GROUP)
    known = list(command.entry_points(group=command.COMMANDS_GROUP))
    monkeypatch.setattr(command, "entry_points", lambda group: [broken, *known])
    status, out, err = run_dynid("robots")
    assert status == 0
    assert "ur5e" in out
    assert "no_such_package.commands:app could not be loaded" in err


def test_each_command_is_in_the_module_that_its_package_names():
    for name, module in {**daq_commands, **ident_commands}.items():
        app = import_module(module).app
        assert name in {entry.name for entry in (*app.registered_commands, *app.registered_groups)}


HOSTILE = "arm\x1b]0;owned\x07\x1b[2J\x9b31m\u202e"


@pytest.mark.parametrize(
    "arguments", [["info", HOSTILE], ["check", HOSTILE], ["identify", HOSTILE], [HOSTILE], ["info", f"--{HOSTILE}"]]
)
@pytest.mark.parametrize("as_json", [False, True])
def test_what_was_given_commands_no_terminal(run_dynid, arguments, as_json):
    status, out, err = run_dynid(*arguments, *(["--json"] if as_json else []))
    assert status == 2
    assert not set("\x1b\x07\x9b\u202e") & set(out + err)
    assert "1b" in out + err


def test_what_a_file_says_commands_no_terminal(run_dynid, tmp_path):
    path = tmp_path / f"{HOSTILE.replace('/', '')}.yaml"
    path.write_text('name: "a\\e[2J"\nmodel: {mdh: [{joint: "j\\e[31m", antecedent: "b\\a"}]}\n"k\\e[5m": 1\n')
    status, out, err = run_dynid("check", str(path))
    assert status == 2
    assert not set("\x1b\x07\x9b\u202e") & set(out + err)


def closed(*descriptors: int) -> None:
    for number in descriptors:
        os.close(number)


def stream_at_start(number: int) -> TextIO | None:
    """Return the standard stream that the interpreter would make."""
    try:
        return os.fdopen(number, "rw"[number > 0], closefd=False)
    except OSError:
        return None


def led_to(path: str, *descriptors: int) -> None:
    for number in descriptors:
        os.dup2(os.open(path, os.O_WRONLY), number)


def led_to_a_broken_pipe() -> None:
    reading, writing = os.pipe()
    os.dup2(writing, 1)
    os.close(reading)


def in_no_folder() -> None:
    folder = tempfile.mkdtemp()
    os.chdir(folder)
    os.rmdir(folder)


def without_memory() -> None:
    """What is loaded already differs from process to process: the arm asks for more than any computer has."""
    loader.load_robot = lambda name: bytearray(1 << 60)


@pytest.mark.parametrize(
    ("prepare", "arguments", "status", "said"),
    [
        (partial(closed, 0, 1, 2), "robots", 0, ""),
        (partial(closed, 1), "robots", 0, ""),
        (partial(closed, 2), "nonsense", 2, ""),
        (partial(led_to, "/dev/full", 1), "robots", 1, "standard output cannot be written: No space left on device"),
        (partial(led_to, "/dev/full", 1), "nonsense --json", 1, "standard output cannot be written"),
        (partial(led_to, "/dev/full", 1, 2), "robots", 1, ""),
        (partial(led_to, "/dev/full", 2), "nonsense", 2, ""),
        (led_to_a_broken_pipe, "robots", 1, ""),
        (in_no_folder, "robots", 0, ""),
        (in_no_folder, "check arm.yaml", 2, "arm.yaml"),
        (without_memory, "robot show ur5e", 1, "needs more memory than it may have"),
    ],
)
def test_a_process_without_streams_folder_or_memory_ends_in_order(tmp_path, prepare, arguments, status, said):
    """The interpreter itself would exit with 120 where it cannot flush."""
    errors = tmp_path / "errors"
    process = os.fork()
    if process == 0:
        ended = 99
        try:
            led = os.open(errors, os.O_WRONLY | os.O_CREAT)
            for number in (1, 2):
                os.dup2(led, number)
            prepare()
            for number, name in enumerate(("stdin", "stdout", "stderr")):
                setattr(sys, name, stream_at_start(number))
            sys.argv = ["dynid", *arguments.split()]
            command.main()
        except SystemExit as stopped:
            ended = int(stopped.code or 0)
            for stream in (sys.stdout, sys.stderr):
                try:
                    stream.flush()
                except OSError:
                    ended = 120
        finally:
            os._exit(ended)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == status
    text = errors.read_text()
    assert said in text
    assert "Traceback" not in text
    assert status == 0 or len(text.splitlines()) == (1 if said else 0)
