"""Mistakes in recordings of random arms, and what `dynid identify` makes of them (docs/measurements/checks.md).

    python -m studies.checks.random_mistakes 12

Serial arms of 3 to 7 joints, one in four with a sliding one, as heavy as arms of their length are; 15 s at 100 Hz of a
random motion. Every other arm has friction, ripple and noise that the model does not know. Each mistake is made at a
joint drawn at random and read from the checks of a whole identification (plain friction, no search of a delay): named
as what it is, named among others that explain the data as well, named as something else, or not named. The number of
arms is the argument; with 12 it takes five minutes.
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
from random_arms import random_arm

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from ident.assessment.arm_mass import arm_length, mass_of_size
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.verdict.check import Check
from sim_drivers.synthetic import data_mistakes as mistakes
from sim_drivers.synthetic.measurement import simulate_recording
from sim_drivers.synthetic.motion import random_fourier_motion
from studies.checks.mistaken_recordings import less_known, turned

PERIOD, DURATION, RATE = 10.0, 15.0, 100.0
CHOICES = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), search_delay=False, presliding=False)
SCALE = ("implausible-load", "implausible-mass", "torque-beyond-limits", "torque-far-below-limits", "implausible-link")
BLAMING = (
    *SCALE[:-1], "gravity-opposite", "gravity-direction", "torques-opposite", "positions-opposite", "torque-sign",
    "position-sign", "joint-sign", "torques-exchanged", "positions-exchanged", "joints-exchanged", "sign-or-column",
    "unsigned-torque", "inconsistent-gain", "inconsistent-length", "joint-zero", "encoder-stuck", "rows-repeated",
    "filled-with-zeros", "residual-bursts", "positions-jitter", "many-outliers", "wrong-time-axis", "clocks-drift",
    "position-unit",
)  # fmt: skip
"""Checks that say what is wrong with a recording."""

Change = Callable[[Recording], Recording]


@dataclass(frozen=True)
class Mistake:
    """A mistake in a recording.

    Attributes:
        name: row of the table.
        right: checks that name it.
        joints: that they name.
        change: of the recording.
        beside: checks that may be raised with it.
        turn: rotation (3, 3) of the believed gravity.
    """

    name: str
    right: tuple[str, ...]
    joints: tuple[int, ...]
    change: Change = lambda run: run
    beside: tuple[str, ...] = ()
    turn: FloatArray | None = None


def arm(seed: int) -> RobotFile:
    """A serial arm of ordinary weight whose torque limits are what its motions need, with something to spare."""
    generator = np.random.default_rng(seed)
    while True:
        number = int(generator.integers(1 << 30))
        found = random_arm(number, joints=3 + seed % 5, trees=False, sliding=0.0)
        content = json.loads(found.text)
        if seed % 4 == 0:
            row, drawn = content["model"]["mdh"][1], content["joints"][1]
            row["type"] = "prismatic"
            drawn |= {"position": [-0.4, 0.4], "velocity": 1.0, "acceleration": 5.0}
        found = parse_robot(json.dumps(content), where="arm", folder=None)
        model = build_model(found)
        size = mass_of_size(model)
        if size is not None and arm_length(model) > 0.6:
            break
    truth = content["truth"]
    total = sum(link["mass"] for link in truth["links"].values())
    scale = size.expected / total * float(np.exp(0.5 * generator.standard_normal()))
    for link in truth["links"].values():
        link["mass"] *= scale
        link["inertia"] = [scale * one for one in link["inertia"]]
    for name, joint in truth["joints"].items():
        for key in joint:
            joint[key] *= scale
        truth["noise"]["torque_std"][name] = 0.1 * scale
    found = parse_robot(json.dumps(content), where="arm", folder=None)
    found = less_known(found, seed) if seed % 2 else found
    content = json.loads(found.text)
    torque = signals(recorded(found, seed))["torque"]
    for limits, peak in zip(content["joints"], np.max(np.abs(torque), axis=0), strict=True):
        limits["torque"] = float(peak / generator.uniform(0.3, 0.8))
    return parse_robot(json.dumps(content), where=f"arm {seed}", folder=None)


def recorded(robot_file: RobotFile, seed: int) -> Recording:
    """Its recording."""
    motion = random_fourier_motion(build_model(robot_file), PERIOD, seed, candidates=5)
    return mistakes.with_velocity(simulate_recording(robot_file, motion, DURATION, seed, rate=RATE))


def signals(run: Recording) -> dict[str, FloatArray]:
    """Recorded values by quantity."""
    return {name: one.values for name, one in run.streams[JOINTS_STREAM].channels.items()}


def with_signals(run: Recording, **values: FloatArray) -> Recording:
    """The recording with other values of some quantities."""
    stream = run.streams[JOINTS_STREAM]
    channels = dict(stream.channels)
    for name, one in values.items():
        channels[name] = replace(channels[name], values=one)
    return replace(run, streams={**run.streams, JOINTS_STREAM: replace(stream, channels=channels)})


def torque_times(factor: float | FloatArray) -> Change:
    """Torques (N, n) times factors (n,)."""
    return lambda run: with_signals(run, torque=signals(run)["torque"] * factor)


def position_times(factor: float | FloatArray) -> Change:
    """Positions and velocities times factors (n,)."""
    return lambda run: with_signals(run, **{name: signals(run)[name] * factor for name in ("position", "velocity")})


def taken(order: Sequence[int], *quantities: str) -> Change:
    """Columns of some quantities in another order."""
    return lambda run: with_signals(run, **{name: signals(run)[name][:, list(order)] for name in quantities})


def all_mistakes(count: int, sliding: Sequence[bool], generator: np.random.Generator) -> list[Mistake]:
    """Each once, at joints drawn at random."""
    turning = [joint for joint in range(count) if not sliding[joint]]
    everyone, one = tuple(range(count)), int(generator.integers(count))
    angle = turning[int(generator.integers(len(turning)))]
    first = int(generator.integers(count - 1))
    order = list(everyone)
    order[first], order[first + 1] = first + 1, first
    pair = (first, first + 1)
    flipped = np.where(np.arange(count) == one, -1.0, 1.0)
    moved = ("position", "velocity")
    shift = np.where(np.arange(count) == angle, np.deg2rad(5.0), 0.0)
    gain = np.where(np.arange(count) == one, 1.0, 0.0)
    degrees = np.where(sliding, 1.0, 180.0 / np.pi)
    seed = int(generator.integers(1 << 30))

    def shifted(run: Recording) -> Recording:
        return with_signals(run, position=signals(run)["position"] + shift)

    def unsigned(run: Recording) -> Recording:
        return with_signals(run, torque=np.abs(signals(run)["torque"]))

    def held(run: Recording) -> Recording:
        return mistakes.repeated_rows(mistakes.sampled(run, 2), 0.3, seed, ("position",))

    def jittering(run: Recording) -> Recording:
        return mistakes.jittering_position(mistakes.sampled(run, 2), 0.015, seed)

    opposite, contact = ("torques-opposite",), ("residual-bursts",)
    found = [
        Mistake("nothing", (), ()),
        Mistake("all torques × −1", opposite, everyone, torque_times(-1.0)),
        Mistake("sign of a torque", ("torque-sign",), (one,), torque_times(flipped)),
        Mistake("sign of a position", ("position-sign",), (one,), position_times(flipped)),
        Mistake("torques exchanged", ("torques-exchanged",), pair, taken(order, "torque")),
        Mistake("positions exchanged", ("positions-exchanged",), pair, taken(order, *moved)),
        Mistake("both exchanged", ("joints-exchanged",), pair, taken(order, "torque", *moved)),
        Mistake("gravity tilted by 15°", ("gravity-direction",), (), turn=turned(15.0, 0)),
        Mistake("gravity tilted by 90°", ("gravity-direction",), (), turn=turned(90.0, 1)),
        Mistake("gravity × −1", ("gravity-opposite",), (), turn=turned(180.0, 0)),
        Mistake("gain × 1.2", ("inconsistent-gain",), (one,), torque_times(1.0 + 0.2 * gain)),
        Mistake("gain left at 1 (× 0.1)", ("inconsistent-gain",), (one,), torque_times(1.0 - 0.9 * gain)),
        Mistake("all gains left at 1 (× 0.1)", SCALE, (), torque_times(0.1)),
        Mistake("all torques × 10", SCALE, (), torque_times(10.0)),
        Mistake("current in mA (× 1000)", SCALE, (), torque_times(1000.0)),
        Mistake("zero off by 5°", ("joint-zero",), (angle,), shifted),
        Mistake("torques without sign", ("unsigned-torque",), (), unsigned),
        Mistake("positions in degrees", ("position-unit",), (), position_times(degrees), SCALE),
        Mistake("contacts in 5 % of the time", contact, (), lambda run: mistakes.contact(run, 0.05, 1.0, seed)),
        Mistake(
            "an encoder stands still for 1 s",
            ("encoder-stuck",),
            (one,),
            lambda run: mistakes.stuck_encoder(run, one, 5.0, 1.0),
        ),
        Mistake("13 % of the rows repeat", ("rows-repeated",), (), lambda run: mistakes.repeated_rows(run, 0.13, seed)),
        Mistake("50 Hz, 30 % of the positions repeat", ("rows-repeated",), (), held),
        Mistake("50 Hz, positions jitter by 15 ms", ("positions-jitter",), (), jittering),
        Mistake(
            "torques 0 in 90 % of the samples",
            ("filled-with-zeros",),
            (),
            lambda run: mistakes.filled_with_zeros(run, 0.9, seed),
            contact,
        ),
    ]
    if any(sliding):
        millimetres = np.where(sliding, 1000.0, 1.0)
        found.append(Mistake("a sliding joint in mm", ("position-unit",), (), position_times(millimetres), SCALE))
    return found


def judged(mistake: Mistake, checks: Sequence[Check], names: Sequence[str]) -> str:
    """Whether a mistake was named, named among others, called something else, or not named."""
    own = {names[joint] for joint in mistake.joints}
    said = [one for one in checks if one.name in (*BLAMING, *mistake.right)]
    right = [
        one for one in said if one.name in mistake.right and own <= {*one.joints, *(own if not one.joints else ())}
    ]
    others = sorted({one.name for one in said} - {*mistake.right, *mistake.beside})
    if right:
        exact = not own or mistake.right == ("torques-opposite",) or len(right[0].joints) <= len(own)
        return ("right" if exact else "among others") + (f" (and {', '.join(others)})" if others else "")
    if "sign-or-column" in others and own <= set(next(c for c in said if c.name == "sign-or-column").joints):
        return "among others"
    wrong = [f"{one.name} {' '.join(one.joints)}".strip() for one in said if one.name not in mistake.beside]
    return f"wrong: {'; '.join(wrong)}" if wrong else "missed"


def outcome(mistake: Mistake, run: Recording, robot_file: RobotFile) -> tuple[str, float]:
    """What is said of a mistake, and the held-out error."""
    believed = robot_file
    if mistake.turn is not None:
        model = robot_file.robot.model
        gravity = tuple(float(one) for one in mistake.turn @ np.array(model.gravity))
        model = model.model_copy(update={"gravity": gravity})
        believed = robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"model": model})})
    try:
        found = identify([mistake.change(run)], [], CHOICES, believed)
    except DynidError as error:
        return f"refused: {error}", float("nan")
    return judged(mistake, found.checks, robot_file.robot.joint_names), found.validation.relative_error


def campaign(seeds: Sequence[int]) -> None:
    """Print, of each mistake, how often it was named, and what it was called instead."""
    rows: dict[str, list[str]] = {}
    for seed in seeds:
        robot_file = arm(seed)
        run = recorded(robot_file, seed)
        model = build_model(robot_file)
        sliding = [model.joints[joint].prismatic for joint in model.active]
        for mistake in all_mistakes(model.dof, sliding, np.random.default_rng(seed)):
            said, error = outcome(mistake, run, robot_file)
            print(
                f"arm {seed} ({model.dof}): {mistake.name} {mistake.joints}: {said} [{100 * error:.3g} %]",
                file=sys.stderr,
                flush=True,
            )
            rows.setdefault(mistake.name, []).append(said.split(":")[0].split(" (")[0])
    kinds = ("right", "among others", "wrong", "missed", "refused")
    print(f"| mistake | {' | '.join(kinds)} |\n|---|{'---|' * len(kinds)}")
    for name, said_of in rows.items():
        counts = Counter(said_of)
        print(f"| {name} | {' | '.join(str(counts[kind] or '') for kind in kinds)} |")


if __name__ == "__main__":
    campaign(range(1, 1 + int(sys.argv[1])) if sys.argv[1].isdigit() else [int(one) for one in sys.argv[1].split(",")])
