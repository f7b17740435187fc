"""Friction that changes from run to run: intervals that hold its mean, and what they cost where it does not change.

A simulated UR5e, each motor's viscous and Coulomb friction scaled at random in every run, another motion of 12 s for
each; `wls` with `coulomb-viscous`. *Before* is without the repeatability, *growth* the median by which an interval of
friction is longer with it. About two minutes of CPU time.

    python -m studies.coverage.repeatability [seeds]
"""

from __future__ import annotations

import os
import sys
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.identify import identify as identification
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.model.dynamic_model import build_model
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.jackknife import CorrectedCovariance
from ident.regression.repeatability import with_repeatability
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

CASES = ((2, 0.0), (3, 0.0), (2, 0.1), (3, 0.1), (5, 0.05))
"""Runs, and the standard deviation of friction between them over itself."""

PERIOD, DURATION = 10.0, 12.0


def moved(arm: RobotFile, spread: float, generator: np.random.Generator) -> RobotFile:
    """The arm with each motor's friction scaled at random."""
    robot = yaml.safe_load(arm.text)
    for joint in robot["truth"]["joints"].values():
        for key in ("viscous", "coulomb"):
            joint[key] *= 1.0 + spread * float(generator.standard_normal())
    return parse_robot(yaml.safe_dump(robot), where=arm.robot.name, folder=None, urdf_text=arm.urdf_text)


def line(arm: RobotFile, count: int, spread: float, seeds: int) -> str:
    """A row of the table."""
    model, before = build_model(arm), list[CorrectedCovariance]()

    def kept(corrected: CorrectedCovariance, *given: Any) -> CorrectedCovariance:
        before.append(corrected)
        return with_repeatability(corrected, *given)

    choices = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), presliding=False, search_delay=False)
    held_out = simulate_recording(arm, random_fourier_motion(model, PERIOD, 999, 2), 6.0, 999)
    errors, bodies, without, tau = [], [], [], []
    for seed in range(seeds):
        generator = np.random.default_rng(seed)
        runs = [
            simulate_recording(
                moved(arm, spread, generator),
                random_fourier_motion(model, PERIOD, 1000 * seed + run, 3),
                DURATION,
                100 * seed + run,
            )
            for run in range(count)
        ]
        with patch.object(identification, "with_repeatability", kept):
            found = identification.identify(runs, [held_out], choices)
        active = list(found.solution.active)
        friction = np.array([found.base.kinds[column] in ("viscous", "coulomb") for column in active])
        truth = (found.base.projection @ truth_vector(arm))[active]
        error = np.abs(found.solution.parameters[active] - truth)
        errors.append((error / found.std[active])[friction])
        bodies.append((error / found.std[active])[~friction])
        without.append((error / np.sqrt(np.diag(before[-1].covariance)))[friction])
        assert found.repeatability is not None
        tau.append((found.repeatability[active] / np.abs(truth))[friction])
    inside = [100.0 * np.mean(np.concatenate(part) < WITHIN_95_PERCENT) for part in (without, errors, bodies)]
    growth = np.median(np.concatenate(without) / np.concatenate(errors))
    return (
        f"| {count} | {100 * spread:.0f} % | {100 * np.median(np.concatenate(tau)):.1f} % | "
        f"{inside[0]:.0f} → {inside[1]:.0f} % | {growth:.2f} | {inside[2]:.0f} % |"
    )


def main(seeds: int = 8) -> None:
    """Print the table."""
    print("| runs | changes by | repeatability found (median) | friction inside, before → with it | growth | bodies |")
    print("|---|---|---|---|---|---|")
    for count, spread in CASES:
        print(line(load_robot("ur5e"), count, spread, seeds), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 8)
