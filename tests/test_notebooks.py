"""The notebooks' cells run as they stand, on smaller arms and shorter recordings; no outputs are stored in them."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import dynid
from daq.motion.trajectory_file import load_trajectory
from daq.recording.writer import write_recording
from daq.robot.loader import load_robot
from dynid import command
from ident.excite.design import design
from ident.excite.search.search import SearchChoices
from ident.tasks import excitation

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction", "estimates_alone")

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run_cells(name: str, changes: dict[str, str], shell: object = None) -> dict[str, object]:
    """The names that a notebook leaves, its texts changed; lines that begin with ! go to `shell` as words."""
    cells = json.loads((EXAMPLES / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    codes = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in codes)
    text = "\n".join("".join(cell["source"]) for cell in codes)
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    names: dict[str, object] = {"shell": shell}
    lines = [f"shell({line[1:]!r})" if line.startswith("!") else line for line in text.splitlines()]
    exec(compile("\n".join(lines), name, "exec"), names)  # our own text, as a user would run it
    return names


@pytest.mark.realdata
def test_a_public_recording(data_dir, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DYNID_DATA", str(data_dir))
    # `info` identifies once more, quickly; the notebook of the UR asks for it.
    shorter = {"split=19.0": "split=12.0, stop=15.0, delay=0.0", "dynid.info(run)": "dynid.info"}
    names = run_cells("public_recording", shorter)
    assert names["result"].validation.relative_error < 0.3
    assert (tmp_path / "ur10-model" / "report.html").exists()


def test_a_ur_over_rtde(monkeypatch, tmp_path, capsys):
    """The recorder's real time is what is simulated: its commands are only parsed."""
    monkeypatch.chdir(tmp_path)
    started: list[list[str]] = []
    monkeypatch.setattr(
        subprocess, "Popen", lambda words: started.append(words) or SimpleNamespace(terminate=started.clear)
    )
    first_found = SearchChoices(starts=None, time=1e-3, workers=1)
    monkeypatch.setattr(excitation, "design", lambda *given: design(*given[:3], first_found))

    def shell(line: str) -> None:
        words = shlex.split(line)[1:]
        assert started == [["dynid", "sim", "up6"]] or words[0] == "info"
        monkeypatch.setattr(sys, "argv", ["dynid", *words])
        if words[0] == "record":
            load_trajectory(Path(words[words.index("--trajectory") + 1]), load_robot("up6").robot)
            seed = 1 + ("other.h5" in words)  # the first motions that a search finds are the same
            write_recording(Path(words[-1]), dynid.simulate("up6", duration=8.0, seed=seed, rate=100.0))
            return
        with pytest.raises(SystemExit) as stopped:
            command.main()
        assert not stopped.value.code, line

    names = run_cells("ur_over_rtde", {"ur5e": "up6"}, shell)
    assert started == []
    assert names["result"].validation.relative_error < 0.2


def test_a_closed_loop(capsys):
    """On a four-bar linkage; the SR400's identification takes half a minute."""
    smaller = {
        '"sr400"': repr(str(EXAMPLES / "four_bar.yaml")),
        "duration=20.0": "duration=4.0, rate=100.0",
        "validation=other": "validation=other, delay=0.0",
        "np.zeros(len(robot.joint_names))": "np.array([0.0, -1.2, 0.0])",
    }
    names = run_cells("closed_loop_sr400", smaller)
    assert names["result"].validation.relative_error < 0.2
    assert len(names["base"]) > 3


def test_a_servo_arm_for_mujoco(monkeypatch, tmp_path, capsys):
    """The identification, half a minute, is replaced by the truth."""
    from servo_result import true_servo_result

    monkeypatch.chdir(tmp_path)
    robot = load_robot("so101")
    model_class = dynid.ServoModel
    monkeypatch.setattr(dynid, "identify_servo", lambda run, validation: model_class(true_servo_result(robot)))
    names = run_cells("servo_to_mujoco", {"duration=60.0": "duration=4.0", "duration=20.0": "duration=4.0"})
    assert (tmp_path / "so101.xml").exists()
    assert len(names["played"].position)
