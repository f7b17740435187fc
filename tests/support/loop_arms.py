"""Robot files of arms with closed loops, for tests."""

from __future__ import annotations

from pathlib import Path

from daq.robot.loader import RobotFile, parse_robot

FOUR_BAR = (Path(__file__).parents[2] / "examples" / "four_bar.yaml").read_text(encoding="utf-8")
"""A revolute column with a planar four-bar linkage: the crank moves the rocker, which carries a wrist."""

SPATIAL = """\
name: spatial_loop
model:
  mdh:
    - {joint: lift, type: prismatic, alpha: 0.3, d: 0.1, r: 0.2}
    - {joint: crank, antecedent: lift, alpha: 0.4, d: 0.1, r: 0}
    - {joint: bow, antecedent: crank, alpha: pi/2, d: 0.15, r: 0.02}
    - {joint: rod, antecedent: bow, alpha: pi/2, d: 0, r: 0}
    - {joint: rocker, antecedent: lift, alpha: 1.1, d: 0.4, theta0: 0.2, r: 0.1}
    - {joint: hand, antecedent: rocker, alpha: 0.7, d: 0.2, r: 0.1}
  loops:
    - passive: {bow: 0.3, rod: 0.2, rocker: 0.3}
      opened: spherical
      closing:
        - {antecedent: rod, d: 0.45, r: 0.03}
        - {antecedent: rocker, d: 0.3}
joints:
  - {name: lift, position: [-0.3, 0.3], velocity: 0.5}
  - {name: crank, position: [-1.2, 1.2], velocity: 2}
  - {name: hand, position: [-2, 2], velocity: 2}
"""
"""A crank and a rocker about skew axes, a rod between them in a universal and a spherical joint."""


SPHERICAL = """\
name: spherical_loop
model:
  mdh:
    - {joint: column, alpha: 0.2, d: 0.1, r: 0.3}
    - {joint: crank, antecedent: column, alpha: 0.4, d: 0, r: 0}
    - {joint: coupler, antecedent: crank, alpha: 0.5, d: 0, r: 0}
    - {joint: rocker, antecedent: column, alpha: 1.4, d: 0, r: 0}
  loops:
    - passive: {coupler: 0.9, rocker: 1.3}
      closing:
        - {antecedent: coupler, alpha: 1.0, d: 0, r: 0.3}
        - {antecedent: rocker, alpha: 0.8, d: 0, r: 0.3}
joints:
  - {name: column, position: [-2, 2], velocity: 2}
  - {name: crank, position: [-1, 1], velocity: 2}
"""
"""A four-bar linkage all of whose axes meet in one point: of five closing equations two are independent."""


def four_bar_arm(**replacements: str) -> RobotFile:
    """`FOUR_BAR` with text replaced."""
    return _parsed(FOUR_BAR, replacements)


def spatial_arm(**replacements: str) -> RobotFile:
    """`SPATIAL` with text replaced."""
    return _parsed(SPATIAL, replacements)


def spherical_arm() -> RobotFile:
    """`SPHERICAL`."""
    return _parsed(SPHERICAL, {})


def _parsed(text: str, replacements: dict[str, str]) -> RobotFile:
    for old, new in replacements.items():
        if text.count(old) != 1:
            raise ValueError(f"{text.count(old)} times '{old}'")
        text = text.replace(old, new)
    return parse_robot(text, where="arm.yaml", folder=None)
