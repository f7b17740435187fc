"""A recording of a simulated arm in one call: for examples, trials and tests."""

from __future__ import annotations

from pathlib import Path

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.errors import UsageError
from ident.model.dynamic_model import build_model
from sim_drivers.synthetic.measurement import simulate_recording
from sim_drivers.synthetic.motion import random_fourier_motion


def simulate(
    robot: str | Path | RobotFile, duration: float = 20.0, seed: int = 0, rate: float | None = None
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
        if value is not None and not 0 < value < float("inf"):
            raise UsageError(f"{name} {value:g} is not a positive number")
    robot_file = load_robot(robot)
    motion = random_fourier_motion(build_model(robot_file), duration, seed)
    return simulate_recording(robot_file, motion, duration, seed, rate)
