"""Whatever dynid prints, draws or writes of a sliding joint is in N, m and kg, never in N·m, rad or kg·m²."""

from __future__ import annotations

import html
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import dynid
from daq.commands.confirmation import Confirmation
from daq.motion.limits import check_limits, check_rest
from daq.motion.trajectories import FourierSeries
from daq.robot.loader import parse_robot
from daq.robot.schema import JointLimits
from daq.session.command_gate import CommandGate, GateLimits
from daq.session.supervisor import Limits, Supervisor
from drivers.core.errors import SafetyStopError, UsageError
from drivers.streams import Batch, ChannelLayout, StreamLayout
from ident.commands.printing.result import print_result

pytestmark = pytest.mark.usefixtures("stated_friction", "mistakes_not_sought")

ARM = """
name: {name}
model:
  mounting: free
  mdh:
    - {{joint: slide, type: prismatic, alpha: pi/2, d: 0, r: 0.3}}
    - {{joint: tip, antecedent: slide, type: {kind}, alpha: pi/2, d: 0, r: 0}}
joints:
  - {{name: slide, position: [-0.8, 0.8], velocity: 1, acceleration: 5, torque: 900}}
  - {{name: tip, position: [-0.6, 0.6], velocity: 1, acceleration: 5, torque: 500}}
drives:
  - {{joint: slide, gain: 50, gain_std: 1}}
  - {{joint: tip, gain: 30, gain_std: 0.6}}
truth:
  links:
    slide: {{mass: 24, com: [0.01, -0.02, -0.05], inertia: [0.2, 0.001, 0, 0.2, 0, 0.3]}}
    tip: {{mass: 10, com: [0.2, 0.01, 0.05], inertia: [0.05, 0, 0.002, 0.09, 0, 0.09]}}
  joints:
    slide: {{viscous: 30, coulomb: 20, offset: 5, motor_inertia: 4.0}}
    tip: {{viscous: 40, coulomb: 30, offset: -4, motor_inertia: 8}}
  noise: {{rate: 100, encoder_resolution: 1.0e-5, torque_std: {{slide: 2, tip: 1}}}}
"""
COMMANDS = {
    "check": "check arm.yaml",
    "robot show": "robot show arm.yaml",
    "sweep": "sweep arm.yaml -o sweep.yaml --page sweep.html --stroke 0.3",
    "info": "info run.h5 --page info",
    "validate": "validate model other.h5 --max-rmse 1e-9",
    "predict": "predict model other.h5 --page predict.html",
    "diff": "diff model model",
    "compare": "compare run.h5 --methods ols --validate other.h5 -o compare",
    "payload": "payload run.h5 loaded.h5 --mass 3 -o payload",
    "gains": "gains run.h5 loaded.h5 --mass 3 -o gains",
}
TURNING = re.compile(r"N[·*]m|\brad\b|\bIa\w*\b(?:(?!\b[XYZ]{2}).){0,150}?kg·m²", re.DOTALL)
"""Units of a turning joint; kg·m² in what follows a motor's inertia, since links have moments of inertia on any arm."""
OF_ANY_ARM = re.compile(r"natural frequency\s+\S+ rad/s|R[XYZ] rad")
"""An angular frequency, and the tool's orientation."""


@pytest.fixture(scope="module", params=["prismatic", "revolute"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an arm's file, two recordings and the model identified from one; its last joint may turn."""
    folder = tmp_path_factory.mktemp(request.param)
    text = ARM.format(name=request.param, kind=request.param)
    (folder / "arm.yaml").write_text(text, encoding="utf-8")
    robot_file = parse_robot(text, where="arm", folder=None)
    runs = [dynid.simulate(robot_file, duration=3.0, seed=seed) for seed in (1, 2)]
    loaded = parse_robot(text.replace("mass: 10,", "mass: 13,"), where="loaded arm", folder=None)
    runs.append(dynid.simulate(loaded, duration=3.0, seed=1))
    for name, recording in zip(("run.h5", "other.h5", "loaded.h5"), runs, strict=True):
        dynid.write_recording(folder / name, recording)
    dynid.identify(runs[0], validation=runs[1], friction="coulomb-viscous+stribeck").save(folder / "model")
    return folder


def turning_units(folder: Path, text: str) -> list[str]:
    """Where a text has units of a turning joint: anywhere, or only in what names the joint that slides."""
    text = re.sub(r'"bdata":"[^"]*"|<script>.*?</script>|"robot_file": ".*?[^\\]"', "", text, flags=re.DOTALL)
    text = OF_ANY_ARM.sub("", html.unescape(text))
    if folder.name.startswith("revolute"):
        panels = re.findall(r'slide[^"<>|\n]*', text)
        text = "\n".join([line for line in text.splitlines() if "slide" in line and "tip" not in line] + panels)
        text = re.sub(r"(N·m|rad(/s)?²?) or (N|m(/s)?²?)\b", "", text)
    return [text[max(0, unit.start() - 60) : unit.end() + 20] for unit in TURNING.finditer(text)]


@pytest.mark.parametrize("name", COMMANDS)
def test_of_commands(arm, name, run_dynid, monkeypatch):
    if name == "compare" and arm.name.startswith("revolute"):
        return  # an identification more, whose tables have no row per joint
    monkeypatch.chdir(arm)
    before = set(arm.rglob("*"))
    status, out, err = run_dynid(*COMMANDS[name].split())
    assert status == (1 if name == "validate" else 0), err
    assert turning_units(arm, out) == []
    for path in set(arm.rglob("*")) - before:
        if path.suffix in (".html", ".json"):
            assert turning_units(arm, path.read_text(encoding="utf-8")) == [], path


def test_of_a_result(arm, capsys):
    print_result(dynid.load_result(arm / "model").result, arm / "report.html", verbose=True)
    assert turning_units(arm, capsys.readouterr().out) == []
    for file in ("report.html", "result.json"):
        assert turning_units(arm, (arm / "model" / file).read_text(encoding="utf-8")) == [], file


def test_of_motions_and_commands(clock, capsys):
    robot = parse_robot(ARM.format(name="portal", kind="revolute"), where="portal", folder=None).robot
    slide, tip = robot.joints
    motion = FourierSeries(4.0, np.zeros(2), np.array([[0.2], [0.0]]), np.zeros((2, 1)))
    narrow = JointLimits(name="slide", position=(-0.1, 0.1), velocity=1).of_kind(sliding=True)
    with pytest.raises(UsageError, match=r"joint slide: position .* passes its limit of -?0\.1 m"):
        check_limits(motion, [narrow, tip], "motion")
    with pytest.raises(UsageError, match=r"begins with joint slide at \S+ m/s, not at rest"):
        check_rest(motion, [slide, tip], "motion")
    gate = CommandGate(print, print, GateLimits.of_joints(robot.joints), 0.01, clock)
    with pytest.raises(SafetyStopError, match=r"position of slide: 2 m passes 0\.8 m; the command was not sent"):
        gate.command(np.array([2.0, 0.0]), 0.0)
    channels = tuple(ChannelLayout(quantity, robot.joint_names) for quantity in ("position", "velocity", "torque"))
    supervisor = Supervisor(Limits.of_robot(robot), [StreamLayout("joints", channels)])
    for quantity, unit in (("position", "m"), ("velocity", "m/s"), ("torque", "N")):
        breach = supervisor.check(Batch("joints", np.zeros(1), np.zeros(1), {quantity: np.array([[1e4, 0.0]])}), 0.0)
        assert breach is not None
        assert breach.unit == unit
    Confirmation(motion, robot.joints, None, None, sys.stdout).ask()
    shown = capsys.readouterr().out
    assert "faster than 1, 1 rad/s or m/s or changes faster than 5, 5 rad/s² or m/s²" in shown
    assert "0.2 rad or m away" in shown
