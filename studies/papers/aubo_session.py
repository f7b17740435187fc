"""A simulated AUBO i5 with the paper's friction, and a session in which it warms up: for aubo_iirls and aubo_coverage.

Bodies, motor inertia, noise and limits are those of the built-in file. Friction is AUBO eq. 3 to 6 with a bristle and a
Stribeck term, which no model here describes, near zero velocity. Coulomb friction and the wrist's viscous coefficients
are of the size of the paper's Table II; α, f_L and β are printed nowhere and invented: at 1 rad/s, friction falls by 11
to 13 % in the main axes from 25.5 to 40.6 °C, and by 3 to 4 % in the wrist from 26.4 to 29.5 °C; load
of 50 N·m adds 3.75 N·m to the upper arm's.
"""

from __future__ import annotations

import numpy as np
import yaml

from daq.motion.trajectories import Motion, PointToPoint, RestToRest
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from ident.excite.choices import SweepChoices
from ident.excite.motion_check import ArmMotionCheck
from ident.excite.velocity_sweep import velocity_sweep
from ident.friction.table import temperature_coefficients
from ident.model.dynamic_model import build_model
from sim_drivers.plant.plant import Plant
from sim_drivers.synthetic.measurement import random_fourier_motion
from studies.synthetic.controlled_run import record_plant

COULOMB = (4.2, 4.4, 4.6, 0.38, 0.51, 0.36)
VISCOUS = (8.0, 12.0, 8.0, 3.5, 4.0, 4.0)
ALPHA = (0.8, 0.85, 0.8, 0.75, 0.75, 0.75)
LOAD = (0.0, 0.0015, 0.004, 0.05, 0.05, 0.0)
ROOT = (4.0, 4.0, 4.0, 1.0, 1.0, 1.0)
SLOPE = (-0.16, -0.18, -0.16, -0.06, -0.06, -0.06)
CURVATURE = (25.0, 25.0, 25.0, 8.0, 8.0, 8.0)
"""f_c [N·m], f_v [N·m·(s/rad)^α], α, f_L [1/(N·m)], and Ft, Fts, Ftc of eq. 5 about 25 °C (`ident.friction.table`)."""

STRIBECK = 0.15
STRIBECK_VELOCITY = 0.05
"""Share of the Coulomb friction; [rad/s]."""

COLD = np.array([25.5, 25.5, 25.5, 26.4, 26.4, 26.4])
WARM = np.array([40.6, 40.6, 40.6, 29.5, 29.5, 29.5])
"""Housings at the beginning and at the end of the session [°C], as above the paper's Tables III and IV."""

RATE = 200.0
PERIOD = 40.0
"""[s]: the paper's fundamental frequency, 0.05π, read as rad/s."""
RAMP = 2.0
TIME_CONSTANT = 0.3
"""Time constant of the warming, as a share of the session."""


def aubo(stribeck: float = STRIBECK) -> RobotFile:
    """The arm; a Stribeck term of 0 leaves the bristle alone."""
    robot = yaml.safe_load(load_robot("aubo_i5").text)
    for k, joint in enumerate(robot["truth"]["joints"].values()):
        beta = temperature_coefficients(ROOT[k], SLOPE[k], CURVATURE[k])
        joint |= {"coulomb": COULOMB[k], "viscous": VISCOUS[k], "alpha": ALPHA[k], "load": LOAD[k]}
        joint |= {"temperature": list(beta), "stribeck": stribeck * COULOMB[k], "stribeck_velocity": STRIBECK_VELOCITY}
    return parse_robot(yaml.safe_dump(robot), where="aubo_i5", folder=None)


def temperatures(share: float) -> FloatArray:
    """Temperatures of the housings [°C], this share of the session after its beginning."""
    risen = (1.0 - np.exp(-share / TIME_CONSTANT)) / (1.0 - np.exp(-1.0 / TIME_CONSTANT))
    return np.asarray(COLD + risen * (WARM - COLD))


def excitation(robot_file: RobotFile, seed: int, candidates: int) -> RestToRest:
    """A Fourier series of order 5 within the limits, the best of so many random ones, from rest to rest."""
    return RestToRest(random_fourier_motion(build_model(robot_file), PERIOD, seed, candidates), 1, RAMP)


def sweep(robot_file: RobotFile) -> PointToPoint:
    """The friction experiment, a shorter `dynid sweep`: one joint at a time, forth and back at several speeds."""
    choices = SweepChoices(slowest=0.4, speeds=4)
    return velocity_sweep(robot_file, ArmMotionCheck(robot_file, None), choices).motion


def played(robot_file: RobotFile, motion: Motion, celsius: FloatArray, seed: int) -> Recording:
    """What the arm's sensors say of a motion that begins with housings of these temperatures [°C]."""
    plant = Plant(robot_file, seed=seed, position=motion.evaluate(np.zeros(1))[0][:, 0])
    for joint, rise in enumerate(celsius - plant.thermal.housing):
        plant.heat(joint, float(rise))
    return record_plant(robot_file, plant, motion, RATE)
