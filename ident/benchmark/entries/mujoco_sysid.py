"""mujoco.sysid: least squares on roll-outs of the bodies with position actuators (MuJoCo 4, Google DeepMind 2026)."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import numpy as np

from daq.recording.commanded_motion import TARGET, CommandedMotion, commanded_motion
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from ident.benchmark.entry import ServoPredictor, Training
from ident.benchmark.judge import SETTLING

TIME_STEP = 0.01
"""[s] of the roll-outs."""

DECIMATION = 2
"""Every second sample is compared."""

ITERATIONS = 10
"""Gauss-Newton iterations, each with a roll-out of every motion per parameter."""

TERMS = {
    "stiffness": (20.0, 1.0, 500.0),
    "damping": (0.5, 0.0, 10.0),
    "frictionloss": (0.05, 0.0, 2.0),
    "armature": (0.03, 1e-4, 1.0),
}
"""Start, least and largest value of each joint's terms [N·m/rad, N·m·s/rad, N·m, kg·m²]: of a small servo."""

DELAY = (0.02, 0.0, 0.2)
"""The same of the delay that all joints share [s]."""


def mujoco_sysid(training: Training) -> ServoPredictor:
    """Stiffness, damping, friction loss and armature of each joint and one delay; bodies as the URDF states them.

    Raises:
        UsageError: mujoco.sysid is not installed, or the arm has no URDF.
    """
    try:
        import mujoco
        from mujoco import sysid

        optimize = sysid.optimize
    except (ImportError, AttributeError) as error:
        raise UsageError("mujoco.sysid is not installed", hint="pip install 'mujoco[sysid]>=4'") from error
    names = training.robot.robot.joint_names
    spec = _servo_arm(training.robot.urdf_text, names, TERMS["stiffness"][0])
    model = spec.compile()
    order = [int(model.joint(name).qposadr[0]) for name in names]
    parameters = sysid.ParameterDict()
    for name in names:
        for term, bounds in TERMS.items():
            change = _change(name, term)
            parameters.add(sysid.Parameter(f"{name} {term}", *bounds, modifier=change))
    parameters.add(sysid.Parameter("delay", *DELAY))
    motions = [commanded_motion(recording, training.robot.robot) for recording in training.recordings]

    def difference(of: Any, predicted: Any, measured: Any, *_: Any, **__: Any) -> tuple[FloatArray, Any, Any]:
        delay = float(of["delay"].value[0])
        delayed = sysid.apply_resample_and_delay(predicted, measured.times, delay)
        return sysid.weighted_diff(delayed.data, measured.data), delayed, measured

    sequences = sysid.ModelSequences(
        "arm",
        spec,
        [f"motion {number}" for number in range(len(motions))],
        [sysid.create_initial_state(model, _placed(model, order, motion.position[0])) for motion in motions],
        [sysid.TimeSeries.from_control_names(*_commands(motion), model) for motion in motions],
        [sysid.TimeSeries.from_names(*_positions(motion), model) for motion in motions],
    )
    residuals = sysid.build_residual_fn(models_sequences=[sequences], modify_residual=difference, n_threads=1)
    with redirect_stdout(StringIO()):  # standard output belongs to --json
        found, _ = optimize(parameters, residuals, verbose=False, max_iters=ITERATIONS)
    fitted, delay = sysid.apply_param_modifiers(found, spec), float(found["delay"].value[0])

    def roll_out(time: FloatArray, command: FloatArray, start: FloatArray) -> FloatArray:
        stamps = np.arange(0.0, time[-1] - time[0] + TIME_STEP, TIME_STEP)
        controls = np.stack([np.interp(stamps - delay, time - time[0], column) for column in command.T], axis=1)
        data = mujoco.MjData(fitted)
        data.qpos[order] = start
        path = np.empty((len(stamps), len(order)))
        for row, control in enumerate(controls):
            path[row] = data.qpos[order]
            data.ctrl[:] = control
            mujoco.mj_step(fitted, data)
        return np.stack([np.interp(time - time[0], stamps, column) for column in path.T], axis=1)

    return ServoPredictor(roll_out)


def _servo_arm(urdf: str | None, names: tuple[str, ...], stiffness: float) -> Any:
    """MuJoCo's spec of the URDF's bodies with a position actuator and a sensor for each joint."""
    import mujoco

    if not urdf:
        raise UsageError("mujoco.sysid needs bodies, and the robot file has no URDF")
    spec = mujoco.MjSpec.from_string(urdf)
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for geom in list(spec.geoms):
        geom.contype = geom.conaffinity = 0
    for name in names:
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=stiffness)
        spec.add_sensor(
            name=name, type=mujoco.mjtSensor.mjSENS_JOINTPOS, objname=name, objtype=mujoco.mjtObj.mjOBJ_JOINT
        )
    return spec


def _change(name: str, term: str) -> Any:
    """Return what writes a parameter into the spec."""

    def change(spec: Any, parameter: Any) -> None:
        value = float(parameter.value[0])
        if term == "stiffness":
            spec.actuator(name).set_to_position(kp=value)
        elif term == "damping":
            spec.joint(name).damping = [value, 0.0, 0.0]  # coefficients of the velocity's powers
        else:
            setattr(spec.joint(name), term, value)

    return change


def _placed(model: Any, order: list[int], position: FloatArray) -> FloatArray:
    placed = np.array(model.qpos0, dtype=np.float64)
    placed[order] = position
    return placed


def _commands(motion: CommandedMotion) -> tuple[FloatArray, FloatArray]:
    """Stamps from the first sample on, and commands at them."""
    stamps = np.arange(0.0, motion.time[-1] - motion.time[0], TIME_STEP)
    since = motion.command_time - motion.time[0]
    return stamps, np.stack([np.interp(stamps, since, column) for column in motion.commands[TARGET].T], axis=1)


def _positions(motion: CommandedMotion) -> tuple[FloatArray, FloatArray]:
    """Stamps and positions of what counts: the first second's state is unknown."""
    since = motion.time - motion.time[0]
    counted = (since >= SETTLING) & (since < since[-1] - 2 * TIME_STEP)
    return since[counted][::DECIMATION], motion.position[counted][::DECIMATION]


mujoco_sysid.kind = "servo"  # type: ignore[attr-defined]
