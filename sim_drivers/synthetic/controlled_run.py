"""A recording of a simulated arm that its controller moves: friction, heat and tracking errors included."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import Motion
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile
from drivers.streams import UNITS
from sim_drivers.plant.plant import Plant

SIGNAL_UNITS = {"current": "A", "voltage": "V", "torque": "N*m"}


def record_plant(robot_file: RobotFile, plant: Plant, motion: Motion, rate: float) -> Recording:
    """Play a motion on a plant and record positions, their targets, the drives' signal and temperatures.

    The reference is new in every control period, however slow the recording is. The plant keeps its heat from one call
    to the next: an arm that warms up is the same plant again.

    Args:
        robot_file: of the plant; its drives have one kind of signal.
        plant: at or near the motion's start.
        motion: played from its beginning to its end.
        rate: of the recording [Hz].
    """
    names = robot_file.robot.joint_names
    (signal,) = {robot_file.robot.drive(name).signal for name in names}
    period = plant.settings.control_steps * plant.settings.step
    # A reference held over several control periods makes the torque a sawtooth, of which samples see one phase.
    targets = max(1, int(np.ceil(round(1.0 / (rate * period), 9))))
    time = np.arange(round(motion.duration * rate) * targets) / (rate * targets)
    samples = []
    for index, (q, v, a) in enumerate(zip(*(values.T for values in motion.evaluate(time)), strict=True), start=1):
        plant.set_target(q, v, a)
        plant.advance(1.0 / (rate * targets))
        if index % targets == 0:
            samples.append(plant.measure())
    stamps = np.array([sample.time for sample in samples])
    values = {
        "position": ([sample.position for sample in samples], "rad"),
        "target_position": ([sample.target_position for sample in samples], UNITS["target_position"]),
        signal: ([sample.current for sample in samples], SIGNAL_UNITS[signal]),
        "temperature": ([sample.temperature for sample in samples], UNITS["temperature"]),
    }
    channels = {name: Channel(name, np.array(rows), unit, names) for name, (rows, unit) in values.items()}
    return Recording(robot_file.text, {JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, stamps, channels)})
