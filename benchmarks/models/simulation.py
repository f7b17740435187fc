"""Forward simulation beside loops that a user of MuJoCo or of Pinocchio would write in Python."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.agreement import check
from benchmarks.timing import medians
from daq.robot.loader import load_robot
from drivers.core.arrays import FloatArray
from ident.export.arm import ExportedArm, pinocchio_arm
from ident.export.mjcf import mjcf
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.simulation.forward_arm import ForwardArm
from ident.simulation.time_stepping import integrate

COMPARED = """\
simulate_ARM_seconds: `integrate`, which Model.simulate calls, of the simulated arms with their true parameters and dry
  friction, 10 s in steps of 1 ms; a PD controller in Python leads it along a sine. simulate_vs_mj_step_loop_ARM: the
  same arm exported to MJCF, same controller and steps, mj_step from Python, over ours; simulate_vs_pin_aba_loop_ARM:
  pinocchio.aba and semi-implicit Euler. Both regularise dry friction. All end within 1 % of the same position."""

DURATION = 10.0
STEP = 1e-3
SWING, PACE = 0.2, 2.0
"""Amplitude [rad] and angular frequency [rad/s] of the sine."""

STIFFNESS, DAMPING = 400.0, 40.0
"""Stiffness and damping of the controller, times each joint's inertia [1/s², 1/s]."""

SHARP = 0.01
"""[rad/s] of the loop's tanh in place of the sign of a velocity."""

FOUR_BAR = Path(__file__).parents[2] / "examples" / "four_bar.yaml"

Controller = Callable[[float, FloatArray, FloatArray], FloatArray]


def run(duration: float = DURATION, rounds: int = 3) -> dict[str, float]:
    """Seconds and ratios."""
    results: dict[str, float] = {}
    for name, robot in (("ur5e", "ur5e"), ("sr400", "sr400"), ("four_bar", str(FOUR_BAR))):
        arm = true_arm(robot)
        forward = ForwardArm(arm.dynamics)
        start, controller = arm.home, _controller(forward, arm.home)
        steps = round(duration / STEP)
        still = np.zeros(forward.dof)
        ends: dict[str, FloatArray] = {}

        def ours(
            forward: ForwardArm = forward,
            start: FloatArray = start,
            controller: Controller = controller,
            ends: dict[str, FloatArray] = ends,
            still: FloatArray = still,
            steps: int = steps,
        ) -> None:
            ends["ours"] = integrate(forward, start, still, controller, duration, steps).position[-1]

        sides: dict[str, Callable[[], object]] = {"ours": ours}
        if (mujoco := _mujoco_loop(arm, controller, steps, ends)) is not None:
            sides["mj_step"] = mujoco
        if arm.model.transmission.direct:
            sides["pin_aba"] = _pinocchio_loop(arm, start, controller, steps, ends)
        seconds = medians(sides, rounds, warm_up=False)
        results[f"simulate_{name}_seconds"] = seconds["ours"]
        for side in sides:
            if side != "ours":
                check(f"{name}, {side}", ends[side], ends["ours"], 0.01)
                results[f"simulate_vs_{side}_loop_{name}"] = seconds[side] / seconds["ours"]
    return results


def true_arm(robot: str) -> ExportedArm:
    """A simulated arm with its true parameters."""
    robot_file = load_robot(robot)
    model = build_model(robot_file)
    base, truth = base_parameters(model), truth_vector(robot_file)
    return ExportedArm(robot_file, model, truth, InverseDynamics(model, base, base.projection @ truth))


def _controller(forward: ForwardArm, start: FloatArray) -> Controller:
    holding, inertia = forward.bias(start, np.zeros(forward.dof)), np.diagonal(forward.inertia(start)).copy()
    stiffness, damping = STIFFNESS * inertia, DAMPING * inertia

    def controller(time: float, position: FloatArray, velocity: FloatArray) -> FloatArray:
        goal, rate = start + SWING * np.sin(PACE * time), SWING * PACE * np.cos(PACE * time)
        return np.asarray(holding + stiffness * (goal - position) + damping * (rate - velocity))

    return controller


def _mujoco_loop(
    arm: ExportedArm, controller: Controller, steps: int, ends: dict[str, FloatArray]
) -> Callable[[], None] | None:
    try:
        import mujoco
    except ImportError:
        print("simulation: no MuJoCo, left out", file=sys.stderr)
        return None
    model = mujoco.MjModel.from_xml_string(mjcf(arm))
    model.opt.timestep = STEP
    joints = [model.joint(name) for name in arm.model.joint_names]
    places = [int(joint.qposadr[0]) for joint in joints]
    speeds = [int(joint.dofadr[0]) for joint in joints]
    to_motors = np.linalg.inv(arm.coupling).T

    def loop() -> None:
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(steps):
            data.ctrl[:] = to_motors @ controller(data.time, data.qpos[places], data.qvel[speeds])
            mujoco.mj_step(model, data)
        ends["mj_step"] = data.qpos[places].copy()

    return loop


def _pinocchio_loop(
    arm: ExportedArm, start: FloatArray, controller: Controller, steps: int, ends: dict[str, FloatArray]
) -> Callable[[], None]:
    import pinocchio as pin

    model = pinocchio_arm(arm)
    data = model.createData()
    motors = arm.motors

    def loop() -> None:
        position, velocity = start.copy(), np.zeros(len(start))
        for index in range(steps):
            torque = controller(index * STEP, position, velocity) - motors.offset
            torque -= motors.viscous * velocity + motors.coulomb * np.tanh(velocity / SHARP)
            velocity = velocity + STEP * pin.aba(model, data, position, velocity, torque)
            position = position + STEP * velocity
        ends["pin_aba"] = position

    return loop
