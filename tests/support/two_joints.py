"""A small robot file."""

TWO_JOINTS = """\
name: arm
model:
  mdh:
    - {joint: j1, alpha: 0, d: 0, r: 0.3}
    - {joint: j2, antecedent: j1, alpha: -pi/2, d: 0.1, theta0: pi/2, r: 0}
joints:
  - {name: j1, position: [-3, 3], velocity: 2}
  - {name: j2, position: [-1.5, 1.5], velocity: 2, torque: 40}
drives:
  - {joint: j1, gain: -10.5, gain_std: 0.5}
"""
