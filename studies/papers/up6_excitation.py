"""The UP6's excitation: the SFLA paper's Table 1 and ours, on the paper's criterion and on the condition number.

`python -m studies.papers.up6_excitation 20` gives each of our designs 20 s, by a local solver with derivatives and by
frog leaping. All motions last as long as the paper's does here, 10 s: the paper does not say how long its own is.
J = 1/‖QᵀQ‖₂ (eq. 12) is computed from 1000 samples.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.motion.limits import motion_extremes
from daq.motion.trajectories import Motion, SumOfSines
from daq.robot.loader import load_robot
from ident.excite.choices import DesignChoices
from ident.excite.criteria import MotionSize
from ident.excite.design import design
from ident.excite.path import JointPath
from ident.excite.prior import find_prior
from ident.excite.search.search import SearchChoices
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel, motion_factor

DURATION = 10.0
SAMPLES = 1000
PAPER = SumOfSines(
    DURATION,
    np.zeros(3),
    np.array([[0.5946, 1.1910, 0.8395], [-0.6776, 0.4117, -0.4006], [1.2101, 0.8244, 1.2484]]),
    np.array([[1.2728, 1.2614, -0.4188], [1.2666, -0.0485, 0.7702], [-1.4820, -0.1229, 1.0399]]),
)
"""Table 1; its row of joint 2 prints a13 for a23 in eq. (11)."""


def report(name: str, motion: Motion, start: float = 0.0) -> None:
    """A line: J, the condition of the base regressor, the largest use of the limits."""
    robot_file = load_robot("up6")
    model = build_model(robot_file)
    time = start + np.linspace(0.0, DURATION, SAMPLES, endpoint=False)
    states = motion.evaluate(time)
    kernel = RegressorKernel(model, base_parameters(model).columns)
    factor = motion_factor(kernel, *states)
    size = np.exp(MotionSize().cost(JointPath(time, *states)))
    extremes = motion_extremes(motion)
    uses = {}
    for joint, limits in enumerate(robot_file.robot.joints):
        low, high = limits.position
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        reach = max(abs(extremes.lowest[joint] - middle), abs(extremes.highest[joint] - middle)) / half
        uses[f"position of {limits.name}"] = reach
        uses[f"velocity of {limits.name}"] = extremes.velocity[joint] / limits.velocity
        uses[f"acceleration of {limits.name}"] = extremes.acceleration[joint] / limits.acceleration
    worst = max(uses, key=lambda key: uses[key])
    print(
        f"{name:42} {size:10.3e} {np.linalg.cond(factor):9.2f} {scaled_condition(factor):9.2f} "
        f"{100 * uses[worst]:8.1f} %  {worst}",
        flush=True,
    )


def main(seconds: float) -> None:
    """The paper's motion and ours."""
    print(
        f"{'motion':42} {'J':>10} {'cond(W)':>9} {'scaled':>9} {'largest use':>10}  of (acceleration limits are ours)"
    )
    report("the paper's Table 1", PAPER)
    robot_file = load_robot("up6")
    search = SearchChoices(starts=None, time=seconds)
    cases = {
        "ours, 3 sines, motion-size": DesignChoices(kind="sines", criterion="motion-size", harmonics=3),
        "ours, 3 sines, plain-condition": DesignChoices(kind="sines", criterion="plain-condition", harmonics=3),
        "ours, 3 sines, condition": DesignChoices(kind="sines", criterion="condition", harmonics=3),
        "ours, 5 harmonics, plain-condition": DesignChoices(criterion="plain-condition"),
        "ours, 5 harmonics, condition": DesignChoices(),
    }
    for name, choices in cases.items():
        for solver in ("slsqp", "sfla") if choices.kind == "sines" else ("slsqp",):
            designs = design(robot_file, find_prior(robot_file), choices, replace(search, solver=solver))
            # Full pace begins at half of the ramp's time.
            report(f"{name}, {solver}", designs.motion, choices.ramp)


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 20.0)
