"""Every command of README and docs is one that dynid takes; the cheap ones run, in the order of a user's afternoon."""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from pathlib import Path

import click
import numpy as np
import pytest
from typer.main import get_command

import dynid
from dynid import command
from ident.fleet.job import run_job

REPOSITORY = Path(__file__).resolve().parents[1]

AFTERNOONS = (
    (
        "dynid --version --verbose",
        "dynid info run.h5",
        "dynid identify run.h5 --validate val.h5 -o model",
        "dynid validate model val.h5 --max-error 0.08 --max-joint-error 0.2 --max-rmse 3",
        "dynid export model --urdf arm.urdf --mjcf arm.xml --ros2-inertial inertial.yaml --c arm",
        "dynid predict model run.h5 -o predicted.h5 --page predicted.html",
        "dynid identify run.h5 --validate val.h5 -o model-june --history arm.db",
        "dynid history add model-may model-june --history arm.db",
        "dynid history arm.db",
        "dynid history arm.db --page wear.html --csv wear.csv",
        "dynid diff model-may model-june",
        "dynid diff model model-june",
        "dynid robot new arm.urdf -o my_arm.yaml",
        "dynid check my_arm.yaml",
        "dynid driver new my_bus",
        "dynid check dynid_my_bus/my_bus/arm.yaml",
        "dynid bench --list",
        "dynid fleet fleet.yaml -o results --history arms.db",
        "dynid import run.csv --robot so101 --column 'position=position_{}' --column 'target_position=target_{}' "
        "-o run.h5",
    ),
    (
        "dynid identify run.h5 -o model",
        "dynid export model --urdf ur5e.urdf --c ur5e",
        "dynid export model --mjcf so101.xml",
        "dynid excite arm.yaml --for gravity -o gravity.yaml",
        "dynid import run.npz --robot so101 -o run.h5",
    ),
    ("dynid identify run.h5 --validate other.h5 -o model", "dynid export model --urdf arm.urdf --c arm"),
    (
        "dynid identify run.h5 --validate val.h5 -o model --accept limits.yaml",
        "dynid export model --c arm",
        "dynid export model --mjcf arm.xml",
        "dynid validate model third.h5",
        "dynid predict model third.h5 -o rolled-out.h5",
    ),
)
"""As they stand in the docs, each afternoon in a folder of its own with recordings and what `before` puts there."""

EXECUTED = {line for afternoon in AFTERNOONS for line in afternoon}

ELSEWHERE = {
    "dynid sim ": "serves until Ctrl-C: tests/wire",
    "dynid record ": "moves an arm in real time: tests/wire",
    "dynid recover ": "the file of a recording that was killed: tests/daq/recording/test_recover.py",
    "dynid monitor ": "live, or a longer recording: tests/ident/monitor",
    "dynid demo ": "minutes: make demo, make wheel",
    " --connect": "needs an arm that is served: tests/wire, tests/drivers",
    "dynid excite ": "searches for seconds to minutes: tests/ident/excite, tests/test_readme.py",
    "dynid sweep ": "designs for many seconds: tests/ident/excite",
    "dynid bench --data": "public recordings: tests/ident/benchmark",
    "dynid compare ": "four identifications, three recordings: tests/dynid/test_compare.py",
    "dynid friction ": "six recordings: tests/ident/experiments",
    "--friction-from": "the result of that: tests/ident/identify/test_held_friction.py",
    "dynid gains ": "a loaded arm: tests/ident/experiments",
    "dynid payload ": "a loaded arm: tests/ident/experiments",
    "locked.h5": "an arm of which two joints rest: tests/ident/experiments/merge",
    "--torques-of": "beside that: tests/ident/experiments/merge",
    "dynid merge ": "of those two: tests/ident/experiments/merge",
    "gravity": "poses held for minutes: tests/ident/experiments/gravity",
    "--method servo": "seconds to minutes: tests/ident/servo",
    "--method wls-rwpso": "a swarm: tests/ident/estimators",
    "--model-file": "a servo model: tests/ident/servo",
    "motion.yaml -o simulated.h5": "a servo model: tests/ident/servo",
    "--ranges": "a servo model: tests/ident/export",
}
"""A part of each command of the docs that does not run here; why, and where it does."""


WRITTEN = re.compile(r"(?:-o|--page|--csv|--urdf|--mjcf|--ros2-inertial) (\S+)")
"""Options that name a file or folder to be written."""


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


def before(line: str) -> None:
    """Put what a line presupposes into the working folder."""
    if "model-may" in line or "model-june --history" in line:
        shutil.copytree("model", "model-may", dirs_exist_ok=True)
    elif "limits.yaml" in line:
        Path("limits.yaml").write_text("relative_error: 0.5")
    elif "fleet.yaml" in line:
        Path("fleet.yaml").write_text("arms: [{name: cell-1, recordings: [run.h5]}]")
    elif "arm.yaml --for" in line:
        shutil.copy(REPOSITORY / "daq" / "robot" / "builtin" / "up6.yaml", "arm.yaml")
    elif "import" in line:
        Path("run.h5").unlink()
        time, names = np.arange(0.0, 4.0, 0.01), dynid.load_robot("so101").robot.joint_names
        position = 0.3 * np.sin(time[:, None] + np.arange(len(names)))
        np.savez("run.npz", time=time, position=position, target_position=position)
        heads = ["time", *(f"{quantity}_{name}" for quantity in ("position", "target") for name in names)]
        rows = np.column_stack([time, position, position])
        np.savetxt("run.csv", rows, delimiter=",", header=",".join(heads), comments="")


def test_the_docs_name_commands_that_exist(monkeypatch):
    listed = commands()
    assert len(listed) > 60
    dynid_itself = get_command(command.build_app())
    for page, line in listed:
        try:
            parsed(dynid_itself, shlex.split(line)[1:])
        except click.exceptions.Exit:  # --version
            continue
        except click.UsageError as error:
            pytest.fail(f"{page}: {line}: {error.format_message()}")
    left_out = [line for _, line in listed if line not in EXECUTED]
    assert [line for line in left_out if not any(part in line for part in ELSEWHERE)] == []
    assert [part for part in ELSEWHERE if not any(part in line for line in left_out)] == []
    assert {line for _, line in listed} >= EXECUTED


@pytest.mark.usefixtures("estimates_alone", "stated_friction")
def test_the_cheap_commands_run_as_they_stand(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ident.fleet.fleet.outcomes", lambda jobs, out, *_: (run_job(job, out) for job in jobs))
    run, val = (dynid.simulate("up6", duration=6.0, seed=seed, rate=100.0) for seed in (0, 1))
    for number, afternoon in enumerate(AFTERNOONS):
        (tmp_path / f"{number}").mkdir()
        monkeypatch.chdir(tmp_path / f"{number}")
        run.save("run.h5")
        for name in ("val", "other", "third"):
            val.save(f"{name}.h5")
        for line in afternoon:
            before(line)
            monkeypatch.setattr(sys, "argv", shlex.split(line))
            with pytest.raises(SystemExit) as stopped:
                command.main()
            assert not stopped.value.code, f"{line}: {capsys.readouterr().err}"
            for written in WRITTEN.findall(line):
                assert Path(written).exists(), f"{line}: no {written}"
