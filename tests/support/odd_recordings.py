"""Recordings that no identification was designed for: an arm that hardly moves, stops, is cut short or damaged.

Each has the exact torque of its motion (friction included), so that nothing but the motion or the damage is odd.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from daq.recording.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot.loader import RobotFile
from drivers.core.arrays import FloatArray
from ident.model.regressor import model_torque
from ident.model.true_parameters import true_model, truth_vector

Motion = Callable[[FloatArray, int], FloatArray]
"""Velocity (n, N) of n joints at times (N,)."""


def bump(time: FloatArray, start: float, duration: float) -> FloatArray:
    """A smooth pulse (N,) of unit height."""
    phase = np.clip((time - start) / duration, 0.0, 1.0)
    return np.asarray(np.sin(np.pi * phase) ** 2)


def one_joint_once(joint: int, duration: float) -> Motion:
    """One joint moves once, for `duration` seconds."""

    def velocity(time: FloatArray, dof: int) -> FloatArray:
        return np.eye(dof)[joint % dof][:, None] * bump(time, 2.0, duration)

    return velocity


def forth_and_back(joint: int, duration: float) -> Motion:
    """One joint moves forth and back, for `duration` seconds."""

    def velocity(time: FloatArray, dof: int) -> FloatArray:
        moving = (time >= 2.0) & (time < 2.0 + duration)
        return np.eye(dof)[joint % dof][:, None] * np.where(moving, np.sin(2 * np.pi * (time - 2.0) / duration), 0.0)

    return velocity


def one_after_the_other(time: FloatArray, dof: int) -> FloatArray:
    """Each joint moves alone."""
    share = time[-1] / dof
    turns = [bump(time, joint * share, 0.45 * share) - bump(time, (joint + 0.5) * share, 0.45 * share)
             for joint in range(dof)]  # fmt: skip
    return np.array(turns)


def together(time: FloatArray, dof: int) -> FloatArray:
    """All joints move all the time."""
    return np.array([0.8 * np.sin((0.9 + 0.7 * joint) * time + joint) for joint in range(dof)])


def partly_at_rest(time: FloatArray, dof: int) -> FloatArray:
    """All joints move in the first fifth only."""
    return together(time, dof) * (time < 0.2 * time[-1])


def steady(time: FloatArray, dof: int) -> FloatArray:
    """The first joint turns at a constant speed, all others rest."""
    return np.eye(dof)[0][:, None] * np.full(len(time), 0.1)


def nothing(time: FloatArray, dof: int) -> FloatArray:
    """No joint moves."""
    return np.zeros((dof, len(time)))


def tiny(time: FloatArray, dof: int) -> FloatArray:
    """All joints move by less than a millionth of a radian."""
    return 1e-7 * together(time, dof)


MOTIONS: Mapping[str, Motion] = {
    "together": together,
    "one joint once for 1 s": one_joint_once(0, 1.0),
    "last joint once for 1 s": one_joint_once(-1, 1.0),
    "second joint forth and back in 1 s": forth_and_back(1, 1.0),
    "last joint forth and back in 4 s": forth_and_back(-1, 4.0),
    "a joint moves for 30 ms": one_joint_once(1, 0.03),
    "one after the other": one_after_the_other,
    "partly at rest": partly_at_rest,
    "steady": steady,
    "nothing": nothing,
    "tiny": tiny,
}

Damage = Callable[[dict[str, FloatArray], np.random.Generator], None]
"""Changes `time` (N,), `position`, `torque`, `temperature` (N, n) of a dictionary; what is removed is not recorded."""


def _cut(count: int) -> Damage:
    def cut(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        for name in signals:
            signals[name] = signals[name][:count]

    return cut


def _keep(chosen: Callable[[FloatArray], np.ndarray]) -> Damage:
    def keep(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        kept = chosen(signals["time"])
        for name in signals:
            signals[name] = signals[name][kept]

    return keep


def _set(name: str, value: float | str) -> Damage:
    def change(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        signals[name] = signals[name].copy()
        signals[name][:] = signals[name][0] if value == "held" else value

    return change


def _without(*names: str) -> Damage:
    def remove(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        for name in names:
            del signals[name]

    return remove


def _stretch(name: str, value: float) -> Damage:
    def change(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        signals[name] = signals[name].copy()
        count = len(signals[name])
        signals[name][count // 3 : count // 2, 0] = value

    return change


def _column(name: str, column: int, value: float) -> Damage:
    def change(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        signals[name] = signals[name].copy()
        signals[name][:, column] = value

    return change


def _scaled(name: str, factor: float) -> Damage:
    def change(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
        signals[name] = signals[name] * factor

    return change


def _jitter(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
    signals["position"] = signals["position"] + 0.02 * generator.standard_normal(signals["position"].shape)


def _repeat(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
    shown = np.arange(len(signals["time"])) // 3 * 3
    for name in signals.keys() - {"time"}:
        signals[name] = signals[name][shown]


def _toggle(signals: dict[str, FloatArray], generator: np.random.Generator) -> None:
    signals["position"] = np.round(signals["position"] / 0.05) * 0.05


DAMAGES: Mapping[str, Damage | None] = {
    "none": None,
    "two samples": _cut(2),
    "one sample": _cut(1),
    "no samples": _cut(0),
    "20 samples": _cut(20),
    "60 samples": _cut(60),
    "segments of one sample": _keep(lambda time: np.arange(len(time)) % 20 == 0),
    "segments of 17 samples": _keep(lambda time: np.arange(len(time)) % 40 < 17),
    "one long gap": _keep(lambda time: (time < 3.1) | (time > 9.0)),
    "torque held": _set("torque", "held"),
    "torque zero": _set("torque", 0.0),
    "a torque zero": _column("torque", 1, 0.0),
    "a position zero": _column("position", 1, 0.0),
    "positions not a number for a while": _stretch("position", float("nan")),
    "torque infinite for a while": _stretch("torque", float("inf")),
    "torque absurd for a while": _stretch("torque", 1e200),
    "torque tiny": _scaled("torque", 1e-300),
    "torque huge": _scaled("torque", 1e5),
    "no torque": _without("torque"),
    "temperature only": _without("position", "torque"),
    "positions jitter": _jitter,
    "rows repeated": _repeat,
    "coarse encoder": _toggle,
}


def odd_recording(
    robot_file: RobotFile, motion: str, damage: str, seconds: float = 15.0, rate: float = 100.0, noise: float = 0.01
) -> Recording:
    """A recording of `MOTIONS[motion]` with `DAMAGES[damage]`."""
    model = true_model(robot_file)
    time = np.arange(round(seconds * rate)) / rate
    velocity = MOTIONS[motion](time, model.dof)
    position = np.cumsum(velocity, axis=1) / rate
    acceleration = np.gradient(velocity, 1.0 / rate, axis=1)
    generator = np.random.default_rng(3)
    torque = model_torque(model, None, truth_vector(robot_file, model), position, velocity, acceleration)
    torque = torque + noise * generator.standard_normal(torque.shape)
    signals = {
        "time": time,
        "position": np.round(position.T, 6),
        "torque": torque.T,
        "temperature": np.full(position.T.shape, 25.0),
    }
    change = DAMAGES[damage]
    if change is not None:
        change(signals, generator)
    names = robot_file.robot.joint_names
    units = {"position": "rad", "torque": "N*m", "temperature": "degC"}
    channels = {name: Channel(name, signals[name], unit, names) for name, unit in units.items() if name in signals}
    stream = Stream(JOINTS_STREAM, signals["time"], signals["time"], channels)
    return Recording(robot_file.text, {JOINTS_STREAM: stream}, comment=f"{motion}, {damage}")
