"""An arm whose first joint lifts the second one."""

from __future__ import annotations

from daq.robot.loader import parse_robot

LIFT = parse_robot(
    """
name: lift
model:
  mounting: free
  mdh:
    - {joint: lift, type: prismatic, alpha: 0, d: 0, r: 0.3}
    - {joint: arm, antecedent: lift, alpha: pi/2, d: 0, r: 0}
joints:
  - {name: lift, position: [-0.4, 0.4], velocity: 1, acceleration: 5, torque: 900}
  - {name: arm, position: [-3, 3], velocity: 3, acceleration: 10, torque: 100}
drives:
  - {joint: lift, gain: 1, signal: torque}
  - {joint: arm, gain: 1, signal: torque}
truth:
  links:
    lift: {mass: 24, com: [0.01, -0.02, -0.05], inertia: [0.2, 0.001, 0, 0.2, 0, 0.3]}
    arm: {mass: 10, com: [0.2, 0.01, 0.05], inertia: [0.05, 0, 0.002, 0.09, 0, 0.09]}
  joints:
    lift: {viscous: 30, coulomb: 20, offset: 5, motor_inertia: 4.0}
    arm: {viscous: 4, coulomb: 3, offset: -0.4, motor_inertia: 0.8}
  noise: {rate: 200, encoder_resolution: 1.0e-5, torque_std: {lift: 2, arm: 0.3}}
prior:
  links:
    lift: {mass: 23, com: [0, 0, 0]}
    arm: {mass: 10.5, com: [0.2, 0, 0]}
""",
    where="lift",
    folder=None,
)
