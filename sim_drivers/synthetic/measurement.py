"""Recordings of a simulated arm: exact inverse dynamics, then the effects of sensors and drives.

A motion for them is the best of many random Fourier series inside the limits.
"""

from __future__ import annotations

from datetime import UTC, datetime
from numbers import Integral, Real
from pathlib import Path

import numpy as np

from daq.motion.trajectories import FourierSeries, Motion
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile, load_robot
from daq.robot.loops import coupling_matrix
from drivers.core.arrays import FloatArray
from drivers.core.errors import UsageError
from drivers.core.numerics import numerical_settings
from drivers.core.software import software_versions
from drivers.core.units import ZERO_CELSIUS
from drivers.streams import UNITS
from ident.linear_algebra.triangular import scaled_condition
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel, model_torque, motion_factor
from ident.model.true_parameters import true_model, truth_vector

CANDIDATES = 30
HARMONICS = 5
LIMIT_SHARE = 0.9
_POINTS_PER_PERIOD = 400


def simulate_recording(
    robot_file: RobotFile,
    motion: Motion,
    duration: float,
    seed: int,
    rate: float | None = None,
    celsius: FloatArray | None = None,
) -> Recording:
    """Record `duration` seconds of a motion that the arm follows exactly.

    Friction has the terms that the file's `friction` names, with the values and shapes of its truth. Where it depends
    on the temperature, that is `celsius` (N, n) [°C], or the truth's ambient one, and is recorded too. Positions are
    quantised by the encoder; torques carry white noise and a ripple that depends on the position (`truth.noise` of the
    robot file). Where the drive's gain is known the raw signal is recorded, else the torque.

    Raises:
        RobotFileError: the robot file has no truth.
    """
    robot = robot_file.robot
    noise = robot.truth.noise
    model = true_model(robot_file)
    truth = truth_vector(robot_file, model)
    generator = np.random.default_rng(seed)
    frequency = noise.rate if rate is None else rate
    time = np.arange(round(duration * frequency)) / frequency
    position, velocity, acceleration = motion.evaluate(time)
    if celsius is None:
        celsius = np.full(position.T.shape, robot.truth.thermal.ambient)
    torque = model_torque(model, None, truth, position, velocity, acceleration, celsius.T + ZERO_CELSIUS)
    for joint, name in enumerate(robot.joint_names):
        ripple = noise.ripple_amplitude.get(name, 0.0)
        phase = generator.uniform(0.0, 2.0 * np.pi)
        torque[joint] += ripple * np.sin(noise.ripple_per_revolution * position[joint] + phase)
        torque[joint] += noise.torque_std.get(name, 0.0) * generator.standard_normal(len(time))
    if noise.encoder_resolution > 0:
        position = np.round(position / noise.encoder_resolution) * noise.encoder_resolution
    unit = robot.column_unit(UNITS["position"], robot.joint_names)
    channels = {"position": Channel("position", position.T, unit, robot.joint_names, "simulated encoder")}
    channels |= _drive_channels(robot_file, torque)
    if model.needs_temperature:
        unit = UNITS["temperature"]
        channels["temperature"] = Channel("temperature", celsius, unit, robot.joint_names, "simulated sensor")
    return Recording(
        robot_text=robot_file.text,
        urdf_text=robot_file.urdf_text or "",
        streams={JOINTS_STREAM: Stream(JOINTS_STREAM, time, time, channels)},
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=software_versions(),
        comment=f"simulated, seed {seed}",
    )


def _drive_channels(robot_file: RobotFile, torque: FloatArray) -> dict[str, Channel]:
    robot = robot_file.robot
    gains = [robot.drive(name).gain for name in robot.joint_names]
    signals = {robot.drive(name).signal for name in robot.joint_names}
    if signals in ({"current"}, {"voltage"}) and all(gain is not None for gain in gains):
        signal = signals.pop()
        values = torque / np.array(gains, dtype=np.float64)[:, None]
        return {signal: Channel(signal, values.T, UNITS[signal], robot.joint_names, f"simulated motor {signal}")}
    if robot.model.coupling:  # what a recording calls torque is the joints'
        torque = coupling_matrix(robot.model.coupling, robot.joint_names).T @ torque
    unit = robot.column_unit(UNITS["torque"], robot.joint_names)
    return {"torque": Channel("torque", torque.T, unit, robot.joint_names, "simulated joint torque")}


def simulate(
    robot: str | Path | RobotFile, duration: float = 60.0, seed: int = 0, rate: float | None = None
) -> Recording:
    """Record a simulated arm on a random excitation trajectory, with the noise that its robot file states.

    Seeds give other motions and other noise of the same arm, so that one recording can validate another.

    Args:
        robot: built-in name, robot file with a `truth`, or the result of `load_robot`.
        duration: of the recording and of the motion's period [s].
        seed: of the motion and the noise.
        rate: of the recording [Hz]; the robot file's where absent.

    Raises:
        RobotFileError: no such robot, or its file has no true parameters.
        UsageError: a duration or a rate that is not positive.

    Example:
        >>> import dynid
        >>> run = dynid.simulate("ur5e", duration=2.0, seed=1, rate=100.0)
        >>> run.streams["joints"].channels["position"].values.shape
        (200, 6)
    """
    for name, value in (("duration", duration), ("rate", rate)):
        if value is None and name == "rate":
            continue
        if not isinstance(value, Real) or not 0 < value < float("inf"):
            raise UsageError(f"{name} {value!r} is not a positive number")
    if not isinstance(seed, Integral) or seed < 0:
        raise UsageError(f"seed {seed!r} is not a natural number")
    robot_file = load_robot(robot)
    with numerical_settings():
        motion = random_fourier_motion(build_model(robot_file), duration, seed)
        return simulate_recording(robot_file, motion, duration, seed, rate)


def random_fourier_motion(model: DynamicModel, period: float, seed: int, candidates: int = CANDIDATES) -> FourierSeries:
    """The Fourier series with the lowest condition among `candidates` random ones, within 90 % of every limit.

    The limits hold on a grid of 400 points per period; with 5 harmonics the extremes lie within 0.1 % of it.
    """
    generator = np.random.default_rng(seed)
    columns = base_parameters(model).columns
    kernel = RegressorKernel(model, columns)
    time = np.linspace(0.0, period, _POINTS_PER_PERIOD, endpoint=False)
    best: tuple[float, FourierSeries] | None = None
    for _ in range(candidates):
        motion = _inside_limits(model, _random_series(model, period, generator), time)
        condition = scaled_condition(motion_factor(kernel, *motion.evaluate(time)))
        if best is None or condition < best[0]:
            best = (condition, motion)
    if best is None:
        raise ValueError("candidates must be at least 1")
    return best[1]


def _random_series(model: DynamicModel, period: float, generator: np.random.Generator) -> FourierSeries:
    shape = (model.dof, HARMONICS)
    return FourierSeries(
        period=period,
        offset=np.zeros(model.dof),
        sine=generator.standard_normal(shape),
        cosine=generator.standard_normal(shape),
    )


def _inside_limits(model: DynamicModel, motion: FourierSeries, time: FloatArray) -> FourierSeries:
    """Scaled so that every joint uses at most `LIMIT_SHARE` of each limit, centred in its range."""
    position, velocity, acceleration = motion.evaluate(time)
    factors, offsets = [], []
    for joint, limits in enumerate(model.limits):
        low, high = limits.position
        swing = np.ptp(position[joint])
        factor = LIMIT_SHARE * min(
            (high - low) / swing,
            limits.velocity / np.max(np.abs(velocity[joint])),
            limits.acceleration / np.max(np.abs(acceleration[joint])),
            2.0 * np.pi / swing,  # more than a turn shows nothing new
        )
        middle = factor * 0.5 * (np.max(position[joint]) + np.min(position[joint]))
        factors.append(factor)
        offsets.append(0.5 * (low + high) - middle)
    scale = np.array(factors)[:, None]
    return FourierSeries(motion.period, np.array(offsets), motion.sine * scale, motion.cosine * scale)
