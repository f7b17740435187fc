"""A recording of a simulated arm that its controller moves: friction, heat and tracking errors included."""

from __future__ import annotations

import numpy as np

from daq.motion.trajectories import Motion
from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile
from drivers.streams import UNITS
from sim_drivers.plant.plant import Plant
from sim_drivers.plant.sensors import Measurement

INSTANT_TOLERANCE = 1e-9
"""By which sums of periods may differ from the instant of a sample [s]."""

SIGNAL_UNITS = {"current": "A", "voltage": "V", "torque": "N*m"}


def record_plant(robot_file: RobotFile, plant: Plant, motion: Motion, rate: float) -> Recording:
    """Play a motion on a plant and record positions, their targets, the drives' signal and temperatures.

    The reference is that of the instant at which a control period begins, whatever the recording's rate is. One that
    came between two periods would lag by a time that changes from period to period; samples at a rate that is no
    divisor of the control rate would see some of these lags only, and in the torque a friction that is not there.
    The plant keeps its heat from one call to the next: an arm that warms up is the same plant again.

    Args:
        robot_file: of the plant; its drives have one kind of signal.
        plant: at or near the motion's start.
        motion: played from its beginning to its end.
        rate: of the recording [Hz].
    """
    names = robot_file.robot.joint_names
    (signal,) = {robot_file.robot.drive(name).signal for name in names}
    period = plant.settings.control_steps * plant.settings.step
    samples: list[Measurement] = []
    count = round(motion.duration * rate)
    ticks = period * np.arange(int(np.ceil(round(count / (rate * period), 9))), dtype=np.float64)
    reached = 0.0
    for tick, *reference in zip(ticks, *(values.T for values in motion.evaluate(ticks)), strict=True):
        plant.set_target(*reference)
        while len(samples) < count and (due := (len(samples) + 1) / rate) <= tick + period + INSTANT_TOLERANCE:
            plant.advance(max(due - reached, 0.0))
            reached = due
            samples.append(plant.measure())
        plant.advance(max(tick + period - reached, 0.0))
        reached = max(reached, tick + period)
    stamps = np.array([sample.time for sample in samples])
    values = {
        "position": ([sample.position for sample in samples], "rad"),
        "target_position": ([sample.target_position for sample in samples], UNITS["target_position"]),
        signal: ([sample.current for sample in samples], SIGNAL_UNITS[signal]),
        "temperature": ([sample.temperature for sample in samples], UNITS["temperature"]),
    }
    channels = {name: Channel(name, np.array(rows), unit, names) for name, (rows, unit) in values.items()}
    return Recording(robot_file.text, {JOINTS_STREAM: Stream(JOINTS_STREAM, stamps, stamps, channels)})
