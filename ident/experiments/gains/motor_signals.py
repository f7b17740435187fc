"""Motor currents or voltages for the identification of drive gains, times presumed gains."""

from __future__ import annotations

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.schema import Robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DataError
from ident.experiments.run_pair import Motion
from ident.signals.joint_signals import JointSignals, read_joint_signals


def signal_of(robot: Robot) -> str:
    """Motor signal of an arm's drives: "current" or "voltage".

    Raises:
        DataError: they differ, or give torque.
    """
    signals = {robot.drive(name).signal for name in robot.joint_names}
    if len(signals) > 1:
        raise DataError(
            f"the drives give different signals: {', '.join(sorted(signals))}",
            where=f"{robot.name}: drives",
            hint="all of them must give current, or all voltage",
        )
    signal = signals.pop()
    if signal in ("torque", "magnitude"):
        what = "torque" if signal == "torque" else "a magnitude without its sign"
        raise DataError(
            f"the drives give {what}, which has no gain to be identified",
            where=f"{robot.name}: drives",
            hint="record motor currents and say 'signal: current'",
        )
    return signal


def torques_by(gains: FloatArray) -> Motion:
    """Reads positions and motor signals times gains (n,) from a recording.

    The returned function raises DataError where the recording has no such signal.
    """

    def motion(recording: Recording, robot: Robot) -> JointSignals:
        signal = signal_of(robot)
        stream = recording.streams.get(JOINTS_STREAM)
        if stream is not None and signal not in stream.channels:
            quantities = ", ".join(sorted(stream.channels)) or "nothing"
            raise DataError(
                f"records no motor {signal}, without which there is no gain to identify; it has {quantities}",
                where=recording.label,
                hint=f"record the motors' {signal}; a recorded torque already contains a gain",
            )
        drives = tuple(
            robot.drive(name).model_copy(update={"gain": float(gain)})
            for name, gain in zip(robot.joint_names, gains, strict=True)
        )
        return read_joint_signals(recording, robot.model_copy(update={"drives": drives}))

    return motion
