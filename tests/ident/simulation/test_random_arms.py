"""Random arms are simulated: numbers everywhere, as an independent integrator of the true bodies has them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from random_arms import random_arm
from true_results import true_result

import dynid
from ident.model.dynamic_model import build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.true_parameters import truth_vector

DURATION = 0.02
STEP = 1e-3


def start(robot_file, seed: int):
    generator = np.random.default_rng(seed)
    middle = [0.5 * sum(joint.position) for joint in robot_file.robot.joints]
    return np.array(middle) + generator.uniform(-0.3, 0.3, len(middle)), generator.uniform(0.1, 0.3, len(middle))


@pytest.mark.parametrize("seed", range(16))
def test_the_motion_is_that_of_the_true_bodies(seed: int) -> None:
    robot_file = random_arm(seed, joints=2 + seed % 6)
    model = build_model(robot_file)
    truth = dict(zip([p.name for p in model.parameters], truth_vector(robot_file), strict=True))
    smooth = {parameter.name: 0.0 for parameter in model.parameters if parameter.kind == "coulomb"}
    arm = dynid.Model(true_result(robot_file, smooth), "full")
    q, dq = start(robot_file, seed)
    torque = arm.torque(q, dq, np.zeros_like(q))
    motion = arm.simulate(q, dq, torque, DURATION, step=STEP)
    assert np.isfinite(motion.position).all()
    assert np.isfinite(motion.velocity).all()

    bodies = pinocchio_model(model, truth_vector(robot_file)[: 10 * model.dof])
    motors = {
        kind: np.array([truth.get(f"{kind}{n + 1}", 0.0) for n in range(model.dof)]) for kind in ("Ia", "Fv", "Fo")
    }
    bodies.armature = motors["Ia"]
    data = bodies.createData()
    position, velocity = q.copy(), dq.copy()
    for _ in range(round(DURATION / STEP)):  # the midpoint rule, by aba
        change = np.zeros_like(q)
        for _ in range(8):
            middle, rate = position + 0.5 * STEP * velocity, velocity + 0.5 * change
            change = STEP * pin.aba(bodies, data, middle, rate, torque - motors["Fv"] * rate - motors["Fo"])
        position = position + STEP * (velocity + 0.5 * change)
        velocity = velocity + change
    np.testing.assert_allclose(motion.velocity[-1], velocity, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(motion.position[-1], position, rtol=1e-6, atol=1e-6)
