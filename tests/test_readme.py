"""README's blocks run as they stand, on a smaller arm; the recorder's real time is the one thing that is simulated."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from daq.motion.trajectory_file import load_trajectory
from daq.recording.writer import write_recording
from daq.robot.loader import load_robot
from dynid import command
from ident.excite.design import design
from ident.excite.search.search import SearchChoices
from ident.tasks import excitation
from sim_drivers.synthetic.measurement import simulate_recording

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")
SMALL = "up6"


def blocks(heading: str, language: str) -> str:
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", README, re.MULTILINE | re.DOTALL)
    assert section is not None
    return "\n".join(re.findall(rf"```{language}\n(.*?)```", section[1], re.DOTALL))


def dynid_exits_with(monkeypatch: pytest.MonkeyPatch, words: list[str]) -> int:
    monkeypatch.setattr(sys, "argv", ["dynid", *words])
    with pytest.raises(SystemExit) as stopped:
        command.main()
    return int(stopped.value.code or 0)


@pytest.mark.usefixtures("short_simulations")
def test_the_five_commands_make_every_file_before_they_use_it(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    first_found = SearchChoices(starts=None, time=1e-3, workers=1)
    monkeypatch.setattr(excitation, "design", lambda *given: design(*given[:3], first_found))
    lines = [shlex.split(line, comments=True) for line in blocks("Five commands", "sh").splitlines()]
    assert [words[:2] for words in lines] == [
        ["dynid", name] for name in ("sim", "excite", "record", "info", "identify", "export")
    ]
    for _, name, *given in lines:
        words = [word for word in given if word != "&"]
        entry = get_command(command.build_app()).commands[name]
        options = entry.make_context(name, list(words)).params  # refuses what the command does not know
        words = [SMALL if word == "ur5e" else word for word in words]
        if name == "record":
            motion = load_trajectory(options["trajectory"], load_robot(SMALL).robot).motion
            simulated = simulate_recording(load_robot(SMALL), motion, motion.duration, seed=1, rate=100.0)
            write_recording(options["out"], simulated)
        elif name != "sim":
            assert dynid_exits_with(monkeypatch, [name, *words]) == 0, capsys.readouterr().err
    assert {"traj.html", "ur5e.urdf", f"{SMALL}.c"} <= {path.name for path in tmp_path.iterdir()}


@pytest.mark.usefixtures("estimates_alone")
def test_the_python_block_runs(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    text = blocks("From Python", "python")
    small = text.replace('"ur5e", duration=60.0', f'"{SMALL}", duration=6.0').replace(
        "[0.0, -1.57, 0.0, -1.57, 0.0, 0.0]", "[0.0] * 3"
    )
    assert small.count(SMALL) == 1
    names: dict[str, object] = {}
    exec(compile(small, "README.md", "exec"), names)  # our own text, as a user would run it
    assert names["model"].gravity([0.0] * 3).shape == (3,)
