"""Checks of real recordings after a deliberate mistake: the table of docs/checks.md.

    python studies/mistaken_recordings.py ../shared/data

Columns exchanged, signs changed, gains scaled, currents in mA, gravity along another axis; and the recordings as they
are. It takes about two minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.importers import ImportChoices, import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.streams import FloatArray
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.signals.pipeline import PreprocessChoices

EXAMPLES = Path(__file__).parents[1] / "examples"
UR10 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
PANDA = tuple(f"joint_{number}" for number in range(1, 8))
WATCHED = (
    "torque-beyond-limits",
    "torque-far-below-limits",
    "implausible-load",
    "idle-joints",
    "gravity-opposite",
    "gravity-direction",
    "torques-opposite",
    "positions-opposite",
    "torque-sign",
    "position-sign",
    "joint-sign",
    "torques-exchanged",
    "positions-exchanged",
    "joints-exchanged",
    "sign-or-column",
    "inconsistent-gain",
    "inconsistent-length",
    "joint-zero",
)


def arms(folder: Path) -> Iterator[tuple[str, str, Path, IdentifyChoices]]:
    """Name, robot file, recording and choices of each."""
    tx40 = (EXAMPLES / "tx40.yaml").read_text(encoding="utf-8")
    yield "TX40", tx40, folder / "tx40_t1.npz", IdentifyChoices(preprocess=PreprocessChoices(stop=7.45))
    yield "UR10", described("ur10", UR10, (330, 330, 150, 56, 56, 56)), folder / "ur10_unisa1.npz", IdentifyChoices()
    link_side = IdentifyChoices(model=ModelChoices(motor_inertia=False))
    yield "Panda", described("panda", PANDA, (87, 87, 87, 87, 12, 12, 12)), folder / "panda_gaz1.npz", link_side


def described(name: str, joints: tuple[str, ...], torques: tuple[int, ...]) -> str:
    """A robot file around a URDF."""
    limits = "".join(
        f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6, torque: {torque}}}\n"
        for joint, torque in zip(joints, torques, strict=True)
    )
    return f"name: {name}\nmodel:\n  urdf: {name}.urdf\n  gravity: [0, 0, -9.81]\njoints:\n{limits}"


def exchanged(one: int, other: int) -> Callable[[FloatArray], FloatArray]:
    """Two columns exchanged."""

    def change(torque: FloatArray) -> FloatArray:
        order = np.arange(torque.shape[1])
        order[[one, other]] = other, one
        return torque[:, order]

    return change


def scaled(joint: int, factor: float) -> Callable[[FloatArray], FloatArray]:
    """One column times a factor."""

    def change(torque: FloatArray) -> FloatArray:
        factors = np.ones(torque.shape[1])
        factors[joint] = factor
        return torque * factors

    return change


MISTAKES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "as published": lambda torque: torque,
    "torques 2 and 3 exchanged": exchanged(1, 2),
    "torques 5 and 6 exchanged": exchanged(4, 5),
    "sign of joint 1": scaled(0, -1.0),
    "sign of joint 2": scaled(1, -1.0),
    "sign of joint 4": scaled(3, -1.0),
    "sign of joint 6": scaled(5, -1.0),
    "gain of joint 2 × 1.4": scaled(1, 1.4),
    "gain of joint 3 × 0.7": scaled(2, 0.7),
    "gain of joint 4 × 1.5": scaled(3, 1.5),
    "mA taken as A": lambda torque: 1e3 * torque,
}
GRAVITIES = ("[9.81, 0, 0]", "[0, -9.81, 0]", "[0, 0, 9.81]")


def changed(recording: Recording, change: Callable[[FloatArray], FloatArray]) -> Recording:
    """The recording with another torque."""
    stream = recording.streams[JOINTS_STREAM]
    torque = stream.channels["torque"]
    channels = {**stream.channels, "torque": replace(torque, values=change(torque.values))}
    return replace(recording, streams={JOINTS_STREAM: replace(stream, channels=channels)})


def said(checks: Identification) -> str:
    """Errors, and the checks that are about mistakes."""
    named = [f"`{one.name}` {', '.join(one.joints)}".strip() for one in checks.checks if one.name in WATCHED]
    errors = f"{100 * checks.fit.relative_error:.1f} | {100 * checks.validation.relative_error:.1f}"
    return f"{errors} | {'; '.join(named) or '–'}"


def main(folder: Path) -> None:
    """Print the table."""
    print("| arm | mistake | fit [%] | held out [%] | checks |\n|---|---|---|---|---|")
    for name, text, path, choices in arms(folder):

        def arm(text: str, name: str = name) -> RobotFile:
            return parse_robot(text, where=name, folder=folder)

        recording = import_file(path, arm(text), ImportChoices())
        for mistake, change in MISTAKES.items():
            print(f"| {name} | {mistake} | {said(identify([changed(recording, change)], [], choices))} |", flush=True)
        for gravity in GRAVITIES:
            mistaken = arm(text.replace("gravity: [0, 0, -9.81]", f"gravity: {gravity}"))
            print(f"| {name} | gravity {gravity} | {said(identify([recording], [], choices, mistaken))} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
