"""No command overwrites a file unasked, or an input at all."""

from __future__ import annotations

import os
import shlex
from importlib.resources import files
from pathlib import Path

import pytest
from typer.main import get_command

from dynid import command

ARGUMENTS = {
    "excite": "arm.yaml -o OUT --csv OUT.csv --page PAGE --from traj.yaml --prior result.json",
    "sweep": "arm.yaml -o OUT --page PAGE --prior result.json",
    "record": "arm.yaml --trajectory traj.yaml --prior result.json --yes -o OUT",
    "import": "run.csv --robot arm.yaml -o OUT",
    "recover": "run.h5 -o OUT",
    "predict": "model run.h5 -o OUT --page PAGE",
    "export": "model --urdf OUT --into arm.urdf --mjcf PAGE",
    "robot new": "arm.urdf -o OUT.yaml",
    "identify": "run.h5 other.h5 --validate val.h5 --friction-from friction.json --robot arm.yaml -o FOLDER",
    "merge": "result.json model --validate val.h5 -o FOLDER",
    "history show": "arm.db --page PAGE --csv OUT",
    "compare": "run.h5 --validate val.h5 --robot arm.yaml -o FOLDER",
    "bench": "--datasets set.yaml -o FOLDER",
    "friction": "run.h5 other.h5 --robot arm.yaml -o FOLDER",
    "payload": "free.h5 loaded.h5 --robot arm.yaml -o FOLDER",
    "gains": "free.h5 loaded.h5 --mass 2 --robot arm.yaml -o FOLDER",
    "info": "run.h5 --robot arm.yaml --page FOLDER",
    "demo": "--robot arm.yaml -o FOLDER",
    "monitor": "--replay run.h5 --model model --contacts labels.csv --quiet free.h5 --page PAGE",
    "fleet": "fleet.yaml -o FOLDER",
    "sim": "arm.yaml --play traj.yaml -o OUT",
}
"""Each command that writes files, with all that it reads; OUT and PAGE are files, FOLDER is a folder."""

READS = {
    "predict": ["model/result.json"],
    "monitor": ["model/result.json"],
    "export": ["model/result.json"],
    "record": ["samples.csv"],
    "merge": ["model/result.json"],
}
"""Files that a command reads without their being named on its line."""

TRAJECTORY = "robot: ur5e\nkind: samples\ncsv: samples.csv\n"


def outputs_of(name: str) -> list[str]:
    words = shlex.split(ARGUMENTS[name])
    if "FOLDER" in words:
        kinds = {
            "compare": ("comparison.json", "report.html"),
            "fleet": ("fleet.json", "report.html"),
            "bench": ("benchmark.json", "report.html"),
            "payload": ("payload.json", "report.html"),
            "gains": ("gains.json", "report.html"),
            "friction": ("friction.json", "report.html"),
            "info": ("info.json", "info.html"),
            "demo": ("identification.h5", "validation.yaml", "result.json", "report.html"),
        }
        return [f"FOLDER/{file}" for file in kinds.get(name, ("result.json", "report.html"))]
    return [word for word in words if word.startswith(("OUT", "PAGE"))]


def inputs_of(name: str) -> list[str]:
    return [word for word in shlex.split(ARGUMENTS[name]) if "." in word and "OUT" not in word] + READS.get(name, [])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Inputs; robot and trajectory are read before the outputs are judged, of the others only the name counts."""
    monkeypatch.chdir(tmp_path)
    for name in ARGUMENTS:
        for file in inputs_of(name):
            Path(file).parent.mkdir(exist_ok=True)
            Path(file).write_text("an input")
    robot = files("daq.robot.builtin").joinpath("ur5e.yaml").read_text(encoding="utf-8")
    Path("arm.yaml").write_text(robot, encoding="utf-8")
    Path("traj.yaml").write_text(TRAJECTORY)
    joints = "shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,wrist_3_joint"
    rows = [f"{time}{',0' * 6}" for time in range(6)]
    Path("samples.csv").write_text("\n".join([f"time,{joints}", *rows]))
    Path("FOLDER").mkdir()
    return tmp_path


@pytest.fixture
def refused(run_dynid):
    """Calls a command by its name, and with more arguments than those of the table: what it refuses."""

    def call(name: str, *more: str) -> str:
        status, out, err = run_dynid(*name.split(), *shlex.split(ARGUMENTS[name]), *more)
        assert (status, out) == (2, ""), err
        return err

    return call


def writing_commands() -> set[str]:
    """Commands with an option for a file or folder to write, or for overwriting it."""
    found = set()
    for name, entry in get_command(command.build_app()).commands.items():
        if entry.hidden:  # another word for a command of the help
            continue
        for words, one in (
            [(name, entry)]
            if not hasattr(entry, "commands")
            else [(f"{name} {sub}", one) for sub, one in entry.commands.items()]
        ):
            if {"--out", "--page", "--force"} & {option for parameter in one.params for option in parameter.opts}:
                found.add(words)
    return found


def test_every_command_that_writes_is_tested_here():
    assert writing_commands() == set(ARGUMENTS)


@pytest.mark.parametrize(("name", "output"), [(name, output) for name in ARGUMENTS for output in outputs_of(name)])
def test_an_output_is_neither_an_input_nor_a_file_that_exists(folder, refused, name, output):
    path = Path(output)
    path.write_text("mine")
    assert f"{output}: exists already" in refused(name)
    for source in inputs_of(name):
        path.unlink()
        path.hardlink_to(source)
        before = path.read_bytes()
        assert f"{output}: is an input of this command" in refused(name, "--force")
        assert Path(source).read_bytes() == before
    path.unlink()
    path.symlink_to("nothing")
    assert f"{output}: is a link" in refused(name, "--force")
    path.unlink()
    os.mkfifo(path)  # as a device is
    assert f"{output}: is not a regular file" in refused(name, "--force")
