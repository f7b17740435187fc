"""What the data determine is the same in all units of length and mass."""

from __future__ import annotations

import json

import numpy as np
import pytest
from random_arms import random_arm

from daq.robot.loader import RobotFile, parse_robot
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

pytestmark = pytest.mark.usefixtures("not_simulated", "stated_friction")


def in_other_units(robot_file: RobotFile, length: float, mass: float) -> RobotFile:
    """The arm, its file's numbers of lengths and masses multiplied by factors, and all others as follows from them."""
    content = json.loads(robot_file.text)
    torque = mass * length**2
    model, truth = content["model"], content["truth"]
    model["gravity"] = [length * one for one in model.get("gravity", (0.0, 0.0, -9.81))]
    for row in model["mdh"]:
        row |= {"d": length * row["d"], "r": length * row["r"]}
    for link in truth["links"].values():
        link |= {
            "mass": mass * link["mass"],
            "com": [length * one for one in link["com"]],
            "inertia": [torque * one for one in link["inertia"]],
        }
    for joint in truth["joints"].values():
        joint |= {name: torque * value for name, value in joint.items() if name not in ("alpha", "stribeck_velocity")}
    for name in ("torque_std", "ripple_amplitude"):
        truth["noise"][name] = {joint: torque * value for joint, value in truth["noise"].get(name, {}).items()}
    for limits in content["joints"]:
        limits |= {"torque": torque * limits["torque"]} if limits.get("torque") else {}
    return parse_robot(json.dumps(content), where="in other units", folder=None)


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_determined_does_not_depend_on_units(seed):
    arm = random_arm(seed, joints=3, trees=False, sliding=0.0)
    motion = random_fourier_motion(build_model(arm), 10.0, seed, candidates=2)

    def found(robot_file: RobotFile) -> Identification:
        recording = simulate_recording(robot_file, motion, 10.0, seed, rate=100.0)
        return identify([recording], [], IdentifyChoices(search_delay=False))

    one, other = found(arm), found(in_other_units(arm, 0.05, 1e-3))
    assert other.base.names == one.base.names
    assert other.solution.active == one.solution.active
    used = list(one.solution.active)
    certainty = [np.abs(each.solution.parameters / each.std)[used] for each in (one, other)]
    assert np.allclose(certainty[1], certainty[0], rtol=1e-6)
    shares = [each.consistent.parameters.determined for each in (one, other) if each.consistent is not None]
    assert np.allclose(*shares, atol=1e-6)
    assert np.isclose(other.fit.relative_error, one.fit.relative_error, rtol=1e-6)
