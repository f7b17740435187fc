"""The command line's frame: start-up, exit statuses, errors as one line or one JSON object."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from drivers.errors import DataError, IdentificationError
from dynid import command

HEAVY = ("numpy", "scipy", "pinocchio", "cvxpy", "h5py", "pydantic", "plotly", "rosbags")


def run(monkeypatch, capsys, *arguments: str) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["dynid", *arguments])
    with pytest.raises(SystemExit) as stopped:
        command.main()
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


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
    for name in ("identify", "import", "info", "robots", "check", "validate", "demo"):
        assert name in done.stdout


def test_every_command_has_help_with_an_example(monkeypatch, capsys):
    for name in ("robots", "import", "check", "info", "identify", "validate", "demo"):
        status, out, _ = run(monkeypatch, capsys, name, "--help")
        assert status == 0
        assert "Example: dynid" in out


def test_version(monkeypatch, capsys):
    status, out, _ = run(monkeypatch, capsys, "--version")
    assert status == 0
    assert out.startswith("dynid 0.")


@pytest.mark.parametrize(
    "arguments", [["idntify"], ["identify"], ["info", "--nope"], ["robot", "show"], ["info", "--rate"]]
)
def test_bad_usage_is_one_line_and_exit_2(monkeypatch, capsys, arguments):
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert status == 2
    assert out == ""
    assert err.startswith("dynid:")
    assert len(err.strip().splitlines()) == 1


def test_bad_usage_with_json_is_an_object(monkeypatch, capsys):
    status, out, err = run(monkeypatch, capsys, "info", "--json")
    assert status == 2
    assert err == ""
    assert set(json.loads(out)) == {"error", "where", "hint"}


@pytest.mark.parametrize(
    ("error", "status"), [(DataError("bad", where="x", hint="y"), 2), (IdentificationError("no"), 1)]
)
def test_errors_become_exit_statuses(monkeypatch, capsys, error, status):
    def fail() -> None:
        raise error

    monkeypatch.setattr(command, "build_app", lambda: lambda **_: fail())
    assert run(monkeypatch, capsys, "anything")[0] == status


def test_error_text_is_one_line():
    error = DataError("first\nsecond", where="file\n.h5", hint="do\nthis")
    assert str(error) == "file .h5: first second (do this)"


def test_interrupt_exits_130(monkeypatch, capsys):
    def interrupted(**_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "build_app", lambda: interrupted)
    status, _, err = run(monkeypatch, capsys, "anything")
    assert (status, err) == (130, "dynid: interrupted\n")


def test_a_broken_third_party_package_is_named_and_left_out(monkeypatch, capsys):
    from importlib.metadata import EntryPoint

    broken = EntryPoint("broken", "no_such_package.commands:app", command.COMMANDS_GROUP)
    known = list(command.entry_points(group=command.COMMANDS_GROUP))
    monkeypatch.setattr(command, "entry_points", lambda group: [broken, *known])
    status, out, err = run(monkeypatch, capsys, "robots")
    assert status == 0
    assert "ur5e" in out
    assert "no_such_package.commands:app could not be loaded" in err


HOSTILE = "arm\x1b]0;owned\x07\x1b[2J\x9b31m\u202e"


@pytest.mark.parametrize(
    "arguments",
    [["info", HOSTILE], ["check", HOSTILE], ["identify", HOSTILE], [HOSTILE], ["info", f"--{HOSTILE}"]],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_what_was_given_commands_no_terminal(monkeypatch, capsys, arguments, as_json):
    status, out, err = run(monkeypatch, capsys, *arguments, *(["--json"] if as_json else []))
    assert status == 2
    assert not set("\x1b\x07\x9b\u202e") & set(out + err)
    assert "1b" in out + err


def test_what_a_file_says_commands_no_terminal(monkeypatch, capsys, tmp_path):
    path = tmp_path / f"{HOSTILE.replace('/', '')}.yaml"
    path.write_text('name: "a\\e[2J"\nmodel: {mdh: [{joint: "j\\e[31m", antecedent: "b\\a"}]}\n"k\\e[5m": 1\n')
    status, out, err = run(monkeypatch, capsys, "check", str(path))
    assert status == 2
    assert not set("\x1b\x07\x9b\u202e") & set(out + err)
