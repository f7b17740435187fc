"""A simulated arm that its own controller moves, and its sensor values."""

from __future__ import annotations

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile
from ident.model.dynamic_model import build_model
from sim_drivers.plant.plant import Plant, PlantSettings
from sim_drivers.synthetic.measurement import random_fourier_motion

PERIOD = 10.0
"""[s] of the motion."""
CANDIDATES = 10
FOLLOWED = 0.02
"""How closely [rad] the arm must follow."""
SIGNAL_UNITS = {"current": "A", "voltage": "V"}


def follow(
    robot_file: RobotFile, seed: int, duration: float, *, rate: float = 500.0, period: float = PERIOD
) -> Recording:
    """The best of random Fourier motions, recorded once it is at speed, with the signal that the file's drives name.

    The controller's period is the recording's, 1/rate [Hz].
    """
    motion = random_fourier_motion(build_model(robot_file), period, seed, CANDIDATES)
    time = np.arange(round(duration * rate)) / rate
    position, velocity, acceleration = (values.T for values in motion.evaluate(time))
    # The motion begins at speed: for two seconds its own time speeds up from a standstill, φ = t²/4 − 1.
    up = np.arange(round(2.0 * rate)) / rate
    before = [values.T for values in motion.evaluate(up**2 / 4.0 - 1.0)]
    pace = (up / 2.0)[:, None]
    plant = Plant(robot_file, PlantSettings(step=0.5 / rate), seed=seed, position=before[0][0])
    for q, v, a in zip(before[0], before[1] * pace, before[2] * pace**2 + before[1] * 0.5, strict=True):
        plant.set_target(q, v, a)
        plant.advance(1.0 / rate)
    samples = []
    for sample in range(len(time)):
        plant.set_target(position[sample], velocity[sample], acceleration[sample])
        plant.advance(1.0 / rate)
        samples.append(plant.measure())
        assert np.max(np.abs(samples[-1].position - position[sample])) < FOLLOWED
    names = robot_file.robot.joint_names
    (signal,) = {robot_file.robot.drive(name).signal for name in names}
    stamps = np.array([sample.time for sample in samples])
    channels = {
        "position": Channel("position", np.array([sample.position for sample in samples]), "rad", names),
        signal: Channel(signal, np.array([sample.current for sample in samples]), SIGNAL_UNITS[signal], names),
    }
    return Recording(
        robot_text=robot_file.text, streams={JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, stamps, channels)}
    )
