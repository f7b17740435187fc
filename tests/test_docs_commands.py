"""Every command of README and docs is one that dynid takes; the cheap ones run, in the order of a user's afternoon."""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from pathlib import Path

import click
import pytest
from typer.main import get_command

import dynid
from dynid import command

REPOSITORY = Path(__file__).resolve().parents[1]

EXECUTED = (
    "dynid info run.h5",
    "dynid identify run.h5 --validate val.h5 -o model",
    "dynid export model --urdf arm.urdf --mjcf arm.xml --ros2-inertial inertial.yaml --c arm",
    "dynid predict model run.h5 -o predicted.h5 --page predicted.html",
    "dynid history add model-may model-june --history arm.db",
    "dynid history arm.db",
    "dynid history arm.db --page wear.html --csv wear.csv",
    "dynid diff model-may model-june",
    "dynid robot new arm.urdf -o my_arm.yaml",
    "dynid check my_arm.yaml",
    "dynid driver new my_bus",
    "dynid bench --list",
)
"""As they stand in the docs, on the recordings and models of `folder`."""

ELSEWHERE = {
    "sim": "serves until Ctrl-C: tests/wire",
    "record": "moves a simulated arm in real time: tests/wire",
    "monitor": "live, or a longer recording: tests/ident/monitor",
    "demo": "minutes: make demo, make wheel",
    "check": "--connect needs an arm that is served: tests/wire, tests/drivers",
    "excite": "searches for seconds to minutes: tests/ident/excite, tests/test_readme.py",
    "sweep": "designs: tests/ident/excite",
    "bench": "public recordings: tests/ident/benchmark",
    "fleet": "processes of their own: tests/ident/fleet",
    "compare": "twelve identifications: tests/dynid/test_compare.py",
    "friction": "six recordings: tests/ident/experiments",
    "gains": "a loaded arm: tests/ident/experiments",
    "payload": "a loaded arm: tests/ident/experiments",
    "merge": "three identifications: tests/ident/experiments",
    "identify": "further methods and options: tests/ident, tests/dynid",
    "validate": "limits that depend on the arm: tests/dynid/test_tasks.py",
    "predict": "servo models: tests/ident/servo",
    "import": "files of others: tests/daq/importers",
    "recover": "a recording that broke off: tests/daq/recording",
    "export": "further formats and models: tests/ident/export",
}
"""Why a command of the docs does not run here, and where it does."""


def commands() -> list[tuple[str, str]]:
    """Page and text of each command; one per line, or per lines that end with a backslash."""
    found = []
    for page in [REPOSITORY / "README.md", *sorted(REPOSITORY.glob("docs/*.md"))]:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        blocks = re.findall(r"^```(?:sh|console)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        indented = re.findall(r"^    (?=dynid )(.*)$", text, re.MULTILINE)
        for line in [*"\n".join(blocks).splitlines(), *indented]:
            words = shlex.split(line.removeprefix("$ "), comments=True)
            if words[:1] == ["dynid"]:
                found.append((page.name, shlex.join(word for word in words if word != "&")))
    return found


def parsed(entry: click.Command, words: list[str]) -> None:
    """Refuse what `dynid`, or one of its group, does not know."""
    name, rest = "dynid", words
    while isinstance(entry, click.Group) and rest and not rest[0].startswith("-"):
        context = click.Context(entry, info_name=name)
        if entry.get_command(context, rest[0]) is None:
            break
        name, chosen, rest = entry.resolve_command(context, rest)
        assert chosen is not None
        entry = chosen
    entry.make_context(name, list(rest))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Where a user works: recordings of a small arm, and what the docs presuppose beside them."""
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("run.h5", "val.h5")):
        dynid.simulate("up6", duration=6.0, seed=seed, rate=100.0).save(name)
    return tmp_path


def test_the_docs_name_commands_that_exist(monkeypatch):
    listed = commands()
    run = {shlex.split(line)[1] for line in EXECUTED}
    assert len(listed) > 60
    dynid_itself = get_command(command.build_app())
    for page, line in listed:
        try:
            parsed(dynid_itself, shlex.split(line)[1:])
        except click.exceptions.Exit:  # --version
            continue
        except click.UsageError as error:
            pytest.fail(f"{page}: {line}: {error.format_message()}")
        assert shlex.split(line)[1] in run | set(ELSEWHERE) | {"--version"}, f"{page}: {line} runs nowhere"
    assert {shlex.split(line)[1] for _, line in listed} >= set(ELSEWHERE)
    assert set(EXECUTED) <= {line for _, line in listed}


@pytest.mark.usefixtures("estimates_alone", "stated_friction")
def test_the_cheap_commands_run_as_they_stand(folder, monkeypatch, capsys):
    for line in EXECUTED:
        monkeypatch.setattr(sys, "argv", shlex.split(line))
        with pytest.raises(SystemExit) as stopped:
            command.main()
        shown = capsys.readouterr()
        assert not stopped.value.code, f"{line}: {shown.err}"
        if line.endswith("-o model"):
            for copy in ("model-may", "model-june"):
                shutil.copytree("model", copy)
    written = {path.name for path in folder.iterdir()}
    assert {"arm.urdf", "arm.xml", "arm.c", "predicted.html", "wear.csv", "my_arm.yaml"} <= written
    assert (folder / "dynid_my_bus").is_dir()
