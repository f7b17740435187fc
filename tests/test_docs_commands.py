"""Every command of README and docs is one that dynid takes; the cheap ones run, in the order of a user's afternoon.

Those that meet a running arm, or take long: `make docs-check` (support/docs_check.py).
"""

from __future__ import annotations

import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import click
import docs_check
import numpy as np
import pytest
from friction_experiment_arm import TWO_BODIES
from loaded_arm import LOAD, arm_runs
from servo_result import true_servo_result
from typer.main import get_command

import dynid
from daq.motion.trajectory_file import load_trajectory
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from dynid import command
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.velocity_sweep import SweepChoices, velocity_sweep
from ident.fleet.job import run_job
from sim_drivers.synthetic.measurement import simulate_recording

REPOSITORY = Path(__file__).resolve().parents[1]

AFTERNOONS = (
    (
        "dynid --version --verbose",
        "dynid info run.h5",
        "dynid identify run.h5 --validate val.h5 -o model",
        "dynid validate model val.h5 --max-error 0.08 --max-joint-error 0.2 --max-rmse 3",
        "dynid export model --urdf arm.urdf --mjcf arm.xml --ros2-inertial inertial.yaml --c arm",
        "dynid predict model run.h5 -o predicted.h5 --page predicted.html",
        "dynid predict model motion.yaml --page planned.html",
        "dynid monitor --replay run.h5 --model model --page contacts.html",
        "dynid identify run.h5 --validate val.h5 -o model-june --history arm.db",
        "dynid history add model-may model-june --history arm.db",
        "dynid history arm.db",
        "dynid history arm.db --page wear.html --csv wear.csv",
        "dynid diff model-may model-june",
        "dynid diff model model-june",
        "dynid robot new arm.urdf -o my_arm.yaml",
        "dynid check my_arm.yaml",
    ),
    (
        "dynid identify run.h5 -o model",
        "dynid export model --urdf ur5e.urdf --c ur5e",
        "dynid export model --mjcf so101.xml",
        "dynid excite arm.yaml --for gravity -o gravity.yaml",
        "dynid identify gravity.h5 --gravity -o gravity",
        "dynid export gravity --c arm",
        "dynid import run.npz --robot so101 -o run.h5",
    ),
    (
        "dynid identify run.h5 --validate other.h5 -o model",
        "dynid export model --urdf arm.urdf --c arm",
        "dynid driver new my_bus",
        "dynid check dynid_my_bus/my_bus/arm.yaml",
        "dynid bench --list",
        "dynid fleet fleet.yaml -o results --history arms.db",
        "dynid import run.csv --robot so101 --column 'position=position_{}' --column 'target_position=target_{}' "
        "-o run.h5",
    ),
    (
        "dynid identify run.h5 --validate val.h5 -o model --accept limits.yaml",
        "dynid export model --c arm",
        "dynid export model --mjcf arm.xml",
        "dynid validate model third.h5",
        "dynid predict model third.h5 -o rolled-out.h5",
    ),
    (
        "dynid compare run.h5 --methods ols,wls --friction viscous,coulomb-viscous --validate val-1.h5 "
        "--validate val-2.h5 --validate val-3.h5 -o comparison",
        "dynid identify run.h5 --method wls-rwpso:particles=200:seed=3 -o model",
        "dynid identify locked.h5 --locked j5,j6 -o arm",
        "dynid identify free.h5 --torques-of j5,j6 -o wrist",
        "dynid merge arm wrist --validate val.h5 -o merged",
    ),
    (
        "dynid gains free.h5 loaded.h5 --mass 2.8",
        "dynid payload free.h5 loaded.h5 --mass 2.8",
        "dynid friction 1.h5 2.h5 3.h5 4.h5 5.h5 6.h5 -o friction",
        "dynid identify run.h5 --validate val.h5 --friction-from friction -o model",
    ),
    (
        "dynid excite so101 --for servo --length 60 -o motion.yaml --csv motion.csv",
        "dynid predict model motion.yaml -o simulated.h5",
        "dynid export model --mjcf arm.xml --ranges ranges.json",
        "dynid validate model third.h5 --model-file arm-as-it-came.xml",
    ),
)
"""Commands of the docs, each afternoon in a folder of its own with recordings and what `BEFORE` puts there."""

EXECUTED = {line for afternoon in AFTERNOONS for line in afternoon}

ELSEWHERE = {
    "dynid sim dynid_my_bus": "an installed package of its own: tests/sim_drivers/conformance/test_toy_driver.py",
    "dynid record dynid_my_bus": "the same",
    "--hand-guided": "a person at the key, on a pseudo-terminal in tests/daq/session/test_guiding.py",
    "dynid demo ": "minutes: make demo, make wheel",
    "dynid bench --data": "public recordings: tests/ident/benchmark",
    "--up-and-down": "joints one after the other: tests/ident/experiments/gains",
}
"""A part of each command of the docs that runs neither here nor in docs_check.py; why, and where it does."""


SWEPT = (
    TWO_BODIES
    + """  joints:
    j1: {viscous: 5, coulomb: 4, motor_inertia: 0.6}
    j2: {viscous: 3, coulomb: 3, motor_inertia: 0.3}
  noise: {rate: 100, torque_std: {j1: 0.05, j2: 0.05}}
"""
)
"""Two joints with friction, for its experiments and for loads."""

SINES = (
    "{robot: up6, kind: sines, duration: 8, ramp: 1, offset: [0, 0, 0], "
    "amplitude: [[0.5, 0.3], [0, 0], [0, 0]], frequency: [[0.7, 2.1], [1, 2], [1, 2]]}"
)
"""A trajectory file of the first joint of the UP6."""

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


def played(robot: str | RobotFile, trajectory: str, seed: int) -> Recording:
    """What a simulated arm records of a trajectory file."""
    arm = load_robot(robot) if isinstance(robot, str) else robot
    motion = load_trajectory(Path(trajectory), arm.robot).motion
    return simulate_recording(arm, motion, motion.duration, seed=seed, rate=50.0)


def model_of_may() -> None:
    shutil.copytree("model", "model-may", dirs_exist_ok=True)


def gravity_poses() -> None:
    played("arm.yaml", "gravity.yaml", 1).save("gravity.h5")


def foreign_files() -> None:
    Path("run.h5").unlink()
    time, names = np.arange(0.0, 4.0, 0.01), dynid.load_robot("so101").robot.joint_names
    position = 0.3 * np.sin(time[:, None] + np.arange(len(names)))
    np.savez("run.npz", time=time, position=position, target_position=position)
    heads = ["time", *(f"{quantity}_{name}" for quantity in ("position", "target") for name in names)]
    rows = np.column_stack([time, position, position])
    np.savetxt("run.csv", rows, delimiter=",", header=",".join(heads), comments="")


def recorded(robot: str | RobotFile, *names: str) -> None:
    for seed, name in enumerate(names, 10):
        dynid.simulate(robot, duration=6.0, seed=seed, rate=50.0).save(f"{name}.h5", overwrite=True)


def locked_joints() -> None:
    three = re.sub(r"\b[SLU](?=[,:])", lambda match: f"j{4 + 'SLU'.index(match[0])}", load_robot("up6").text)
    Path("arm.yaml").write_text(three)
    Path("first.yaml").write_text(SINES)
    played("arm.yaml", "first.yaml", 1).save("locked.h5")
    recorded("arm.yaml", "free", "val")


def loaded_runs() -> None:
    arm = parse_robot(SWEPT, where="arm", folder=None)
    free, loaded = arm_runs(arm, dict.fromkeys(arm.robot.joint_names, 1.0), LOAD, 1)
    free.save("free.h5")
    loaded.save("loaded.h5")


def sweeps() -> None:
    arm = parse_robot(SWEPT, where="arm", folder=None)
    motion = velocity_sweep(arm, ArmMotionCheck(arm), SweepChoices(stroke=1.0, slowest=0.5, speeds=3)).motion
    for seed in range(1, 7):
        simulate_recording(arm, motion, motion.duration, seed=seed, rate=50.0).save(f"{seed}.h5")
    recorded(arm, "run", "val")


def servo_recordings() -> None:
    shutil.copy("arm.xml", "arm-as-it-came.xml")
    shutil.copy("simulated.h5", "third.h5")


BEFORE: dict[str, Callable[[], object]] = {
    "model-may": model_of_may,
    "model-june --history": model_of_may,
    "motion.yaml --page": lambda: Path("motion.yaml").write_text(SINES),
    "limits.yaml": lambda: Path("limits.yaml").write_text("relative_error: 0.5"),
    "fleet.yaml": lambda: Path("fleet.yaml").write_text("arms: [{name: cell-1, recordings: [run.h5]}]"),
    "arm.yaml --for": lambda: shutil.copy(REPOSITORY / "daq" / "robot" / "builtin" / "up6.yaml", "arm.yaml"),
    "gravity.h5": gravity_poses,
    "dynid import": foreign_files,
    "dynid compare": lambda: recorded("up6", "val-1", "val-2", "val-3"),
    "--locked": locked_joints,
    "dynid gains": loaded_runs,
    "dynid friction": sweeps,
    "--for servo --length": lambda: dynid.ServoModel(true_servo_result(load_robot("so101"))).save("model"),
    "--model-file": servo_recordings,
}
"""Puts into the working folder what a line with this part presupposes."""


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
    left_out = [line for _, line in listed if line not in EXECUTED | docs_check.COMMANDS]
    assert [line for line in left_out if not any(part in line for part in ELSEWHERE)] == []
    assert [part for part in ELSEWHERE if not any(part in line for line in left_out)] == []
    assert {line for _, line in listed} >= EXECUTED | docs_check.COMMANDS


@pytest.mark.usefixtures("estimates_alone", "stated_friction")
@pytest.mark.parametrize("afternoon", AFTERNOONS, ids=range(len(AFTERNOONS)))
def test_the_cheap_commands_run_as_they_stand(afternoon, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("ident.fleet.fleet.outcomes", lambda jobs, out, *_: (run_job(job, out) for job in jobs))
    for reading in ("pinocchio_reading", "mujoco_reading"):
        monkeypatch.setattr(f"ident.export.{reading}.DURATION", 0.5)  # 5 s of fall and of tracking: tests/ident/export
    monkeypatch.chdir(tmp_path)
    dynid.simulate("up6", duration=12.0, seed=0, rate=50.0).save("run.h5")
    for name in ("val", "other", "third"):
        dynid.simulate("up6", duration=12.0, seed=1, rate=50.0).save(f"{name}.h5")
    for line in afternoon:
        for part, prepare in BEFORE.items():
            if part in line:
                prepare()
        monkeypatch.setattr(sys, "argv", shlex.split(line))
        with pytest.raises(SystemExit) as stopped:
            command.main()
        assert not stopped.value.code, f"{line}: {capsys.readouterr().err}"
        for written in WRITTEN.findall(line):
            assert Path(written).exists(), f"{line}: no {written}"


PYTHON_PAGES = ("recordings", "python", "model", "history", "gravity")
"""Pages whose Python blocks run here, each after those before it."""

PYTHON_ELSEWHERE = {"benchmark": "tests/ident/benchmark", "drivers": "tests/sim_drivers/conformance"}


@pytest.mark.usefixtures("estimates_alone", "stated_friction")
def test_the_python_blocks_run_as_they_stand(tmp_path, monkeypatch, capsys):
    block = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
    texts = {page.stem: page.read_text(encoding="utf-8") for page in REPOSITORY.glob("docs/*.md")}
    assert {name for name, text in texts.items() if block.search(text)} == {*PYTHON_PAGES, *PYTHON_ELSEWHERE}
    monkeypatch.chdir(tmp_path)
    run, other = (dynid.simulate("up6", duration=6.0, seed=seed, rate=50.0) for seed in (0, 1))
    run.save("run.h5")
    motion = dynid.design_gravity_motion("up6", poses=6)[0]
    simulate_recording(motion.robot_file, motion.motion, motion.duration, seed=1, rate=50.0).save("gravity.h5")
    zero = np.zeros(3)
    names: dict[str, object] = {"frame": run.to_frame(), "other": other, "another": other, "dq": zero, "ddq": zero}
    names |= {"q0": zero, "dq0": zero, "goal": zero, "kp": 100.0, "kd": 20.0}
    for page in PYTHON_PAGES:
        if page == "history":
            shutil.copytree("model", "model-june")
        text = "\n".join(block.findall(texts[page])).replace('"ur5e"', '"up6"')
        exec(compile(text, f"{page}.md", "exec"), names)  # our own text, as a user would run it
        names["q"] = zero  # recordings.md's are samples
