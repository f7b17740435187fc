"""The arm of three joints with every friction term, and true values of all of them."""

from __future__ import annotations

from daq.robot.loader import RobotFile, parse_robot
from tests.ident.conftest import THREE_JOINT

TERMS = """
friction:
  exponent: 0.6
  stribeck: true
  stribeck_velocity: 0.2
  load: quadratic
  temperature: full
  joints: {j3: {load: linear, temperature: linear, exponent: 1.0}}
"""
TRUTH = (
    ("j1: {viscous: 3,", "j1: {alpha: 0.6, stribeck: 1.5, load: 0.002, temperature: [40, -0.12, 9.0e+6], viscous: 3,"),
    ("j2: {viscous: 4,", "j2: {alpha: 0.8, stribeck: 2.0, load: 0.003, temperature: [30, -0.09, 0], viscous: 4,"),
    ("j3: {viscous: 1,", "j3: {stribeck: 0.5, load: 0.001, temperature: [12, -0.03, 0], viscous: 1,"),
)


def arm_file(terms: str = TERMS) -> RobotFile:
    """The arm with this section `friction`."""
    text = THREE_JOINT
    for plain, rich in TRUTH:
        assert plain in text
        text = text.replace(plain, rich)
    return parse_robot(text + terms, where="three_joint", folder=None)
