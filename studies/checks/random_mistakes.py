"""Mistakes in recordings of random arms, and what `dynid identify` makes of them (docs/measurements/checks.md).

    python -m studies.checks.random_mistakes ARMS [FURTHER]
    python -m studies.checks.random_mistakes delay 6

Serial arms of 3 to 7 joints, one in four with a sliding one, as heavy as arms of their length are; 15 s at 100 Hz of a
random motion. Every other arm has friction, ripple and noise that the model does not know. Each mistake is made at a
joint drawn at random and read from the checks of a whole identification (plain friction, no search of a delay): the
first check that blames something is right, right among others that explain the data as well (*among*), wrong, or none
is raised (*missed*); *beside* are right names beside which another mistake is named. ARMS and FURTHER are numbers of
arms, or seeds separated by commas; an arm takes forty seconds of processor time.

Further ones: arms of 0.1 to 300 kg and 3 to 8 joints, half of them built as arms are and half with random frames, one
in three with a sliding joint (a lift, or the instrument of a surgical arm), torque noise of 1 to 10 % of each joint's
torque, encoder steps of 1e-6 to 1.5e-3 rad, positions with as much noise. `delay`: lifts with an arm of seven joints
and a light wrist, 50 Hz, positions that jitter, torques that are late; the delay as it is estimated.
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
import yaml
from random_arms import built_arm, random_arm

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import FloatArray
from drivers.core.errors import DynidError
from ident.assessment.arm_mass import DENSITY, LENGTHS_PER_REACH, arm_length, mass_of_size
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.simulation import open_loop, tracking
from ident.verdict.catalogue import MISTAKES
from ident.verdict.check import SEVERITIES, Check
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.checks.mistaken_recordings import less_known, turned
from studies.signals.delay import milliseconds
from studies.synthetic import data_mistakes as mistakes

PERIOD, DURATION, RATE = 10.0, 15.0, 100.0
ONLY = tuple(one for one in os.environ.get("MISTAKES", "").split(",") if one)
CHOICES = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), search_delay=False, presliding=False)
SCALE = (
    "implausible-load", "implausible-mass", "torque-beyond-limits", "torque-far-below-limits", "implausible-link",
    "torques-scaled",
)  # fmt: skip
CLAUSES = {
    "joint-zero": "added to the position of {joint}", "gravity-direction": "gravity along",
    "inconsistent-gain": "the drive gain of {joint} ", "wrong-gain": "the drive gain of {joint} ",
}  # fmt: skip
"""What their sentences say of others that explain the data equally well."""

KINDS = {"right": "named", "among others": "among", "missed": "missed", "wrong": "wrong", "refused": "refused",
         "beside": "beside"}  # fmt: skip

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
    return with_limits(found, seed, generator, f"arm {seed}")


def with_limits(robot_file: RobotFile, seed: int, generator: np.random.Generator, name: str) -> RobotFile:
    """The arm with torque limits that its motions reach to 30 to 80 %."""
    content = json.loads(robot_file.text)
    torque = signals(recorded(robot_file, seed))["torque"]
    for limits, peak in zip(content["joints"], np.max(np.abs(torque), axis=0), strict=True):
        limits["torque"] = float(peak / generator.uniform(0.3, 0.8))
    return parse_robot(json.dumps(content), where=name, folder=None)


def further_arm(seed: int) -> RobotFile:
    """An arm of 0.1 to 300 kg with noise and encoder steps of its own."""
    generator = np.random.default_rng([seed, 22])
    mass = 0.1 * 3000.0 ** ((7 * seed % 20 + generator.random()) / 20)
    if seed % 2:
        number = int(generator.integers(1 << 30))
        content = json.loads(random_arm(number, joints=3 + seed % 5, trees=False, sliding=0.0).text)
        resize(content, mass, generator)
    else:
        reach = (mass / DENSITY) ** (1 / 3)
        content = yaml.safe_load(built_arm(seed, sizes=(reach, 1.01 * reach)).text)
    if seed % 3 == 0:
        slide(content, int(generator.choice([0, 2])), generator)
    names = [joint["name"] for joint in content["joints"]]
    noise = content["truth"]["noise"]
    noise["encoder_resolution"] = float(np.exp(generator.uniform(np.log(1e-6), np.log(1.5e-3))))
    noise["torque_std"] = dict.fromkeys(names, 0.0)
    found = parse_robot(json.dumps(content), where="arm", folder=None)
    if seed % 4 < 2:
        found = less_known(found, seed)
        content = json.loads(found.text)
        content["truth"]["noise"]["torque_std"] = dict.fromkeys(names, 0.0)
        found = parse_robot(json.dumps(content), where="arm", folder=None)
    sizes = np.sqrt(np.mean(signals(recorded(found, seed))["torque"] ** 2, axis=0))
    share = float(np.exp(generator.uniform(np.log(0.01), np.log(0.1))))
    content["truth"]["noise"]["torque_std"] = {
        name: share * float(size) for name, size in zip(names, sizes, strict=True)
    }
    found = parse_robot(json.dumps(content), where="arm", folder=None)
    return with_limits(found, seed, generator, f"further arm {seed}")


def resize(content: dict[str, Any], mass: float, generator: np.random.Generator) -> None:
    """Scale an arm to a mass [kg] and to a length within a factor of 1.3 of what such arms have."""
    links = content["truth"]["links"].values()
    factor = mass / sum(link["mass"] for link in links)
    rows = content["model"]["mdh"]
    before = sum(np.hypot(row["d"], row["r"]) for row in rows)
    length = LENGTHS_PER_REACH * (mass / DENSITY) ** (1 / 3) * float(np.exp(generator.uniform(-0.26, 0.26)))
    for row in rows:
        row["d"], row["r"] = (row[key] * length / before if before > 0.0 else 0.0 for key in ("d", "r"))
    size = length / 1.5  # the bodies are those of an arm 1.5 m long
    for link in links:
        link["mass"] *= factor
        link["com"] = [size * one for one in link["com"]]
        link["inertia"] = [factor * size**2 * one for one in link["inertia"]]
    for truth in content["truth"]["joints"].values():
        for key in truth:
            truth[key] *= factor * (size**2 if key == "motor_inertia" else size)


def slide(content: dict[str, Any], index: int, generator: np.random.Generator) -> None:
    """Make a joint slide, or put a lift under the arm: index 0."""
    names = [joint["name"] for joint in content["joints"]]
    links = content["truth"]["links"]
    size = LENGTHS_PER_REACH * (sum(link["mass"] for link in links.values()) / DENSITY) ** (1 / 3)
    limits = {"position": [-0.2 * size, 0.2 * size], "velocity": 0.4 * size, "acceleration": 2.0 * size}
    if index:
        content["model"]["mdh"][index]["type"] = "prismatic"
        content["joints"][index] |= limits
        for key in ("viscous", "coulomb", "offset", "motor_inertia"):
            content["truth"]["joints"][names[index]][key] = content["truth"]["joints"][names[index]].get(
                key, 0.0
            ) / size ** (2 if key == "motor_inertia" else 1)
        return
    mass = 0.5 * sum(link["mass"] for link in links.values())
    content["model"]["mdh"][0]["antecedent"] = "lift"
    row = {"joint": "lift", "antecedent": "base", "type": "prismatic", "alpha": 0.0, "d": 0.0, "r": 0.3 * size}
    content["model"]["mdh"].insert(0, row)
    content["joints"].insert(0, {"name": "lift", **limits})
    content["drives"].insert(0, {"joint": "lift", "signal": "torque", "gain": 1, "inertia": True})
    width = mass * (0.2 * size) ** 2 / 6
    links["lift"] = {"mass": mass, "com": [0, 0, 0.1 * size], "inertia": [width, 0, 0, width, 0, width]}
    force = 9.81 * 3.0 * mass
    content["truth"]["joints"] = {
        "lift": {
            "motor_inertia": mass * float(generator.uniform(0.2, 2.0)),
            "viscous": 0.05 * force / limits["velocity"],
            "coulomb": 0.05 * force,
            "offset": 0.0,
        },
        **content["truth"]["joints"],
    }


def noisy_positions(run: Recording, seed: int) -> Recording:
    """The recording with noise of half a step of its encoders."""
    step = run.robot().robot.truth.noise.encoder_resolution
    generator = np.random.default_rng([seed, 5])
    position = signals(run)["position"]
    return with_signals(run, position=position + 0.5 * step * generator.standard_normal(position.shape))


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
    turning = [joint for joint in range(count) if not sliding[joint]] or list(range(count))
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

    def biased(run: Recording) -> Recording:
        torque = signals(run)["torque"]
        return with_signals(run, torque=torque + 0.5 * gain * np.max(np.abs(torque), axis=0))

    def percent(run: Recording) -> Recording:
        torque = signals(run)["torque"]
        return with_signals(run, torque=100.0 * torque / np.max(np.abs(torque), axis=0))

    def unsigned(run: Recording) -> Recording:
        return with_signals(run, torque=np.abs(signals(run)["torque"]))

    def held(run: Recording) -> Recording:
        return mistakes.repeated_rows(mistakes.sampled(run, 2), 0.3, seed, ("position",))

    def jittering(run: Recording) -> Recording:
        return mistakes.jittering_position(mistakes.sampled(run, 2), 0.015, seed)

    def late(run: Recording) -> Recording:
        values = signals(run)
        moved_late = {name: np.where(gain > 0.0, np.roll(values[name], 6, axis=0), values[name]) for name in moved}
        return with_signals(run, **moved_late)

    def coupled(run: Recording) -> Recording:
        values = signals(run)
        changed = {name: values[name] - (np.eye(count)[first] * values[name][:, [first + 1]]) for name in moved}
        added = np.eye(count)[first + 1] * values["torque"][:, [first]]
        return with_signals(run, **changed, torque=values["torque"] + added)

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
        Mistake("gravity × −1", ("gravity-opposite",), (), turn=-np.eye(3)),
        Mistake("gain × 1.2", ("inconsistent-gain",), (one,), torque_times(1.0 + 0.2 * gain)),
        Mistake("gain left at 1 (× 0.1)", ("wrong-gain", "inconsistent-gain"), (one,), torque_times(1.0 - 0.9 * gain)),
        Mistake("all gains left at 1 (× 0.1)", SCALE, (), torque_times(0.1)),
        Mistake("all torques × 10", SCALE, (), torque_times(10.0)),
        Mistake("current in mA (× 1000)", SCALE, (), torque_times(1000.0)),
        Mistake("torques in percent of each joint's peak", ("wrong-gain",), (), percent, SCALE),
        Mistake("half of its peak added to a torque", ("torque-biased",), (one,), biased),
        Mistake("a position 60 ms late", ("position-late",), (one,), late),
        Mistake("coupled motors not declared", ("motors-coupled",), pair, coupled),
        Mistake("zero off by 5°", ("joint-zero",), (angle,), shifted),
        Mistake("torques without sign", ("unsigned-signal", "unsigned-torque"), (), unsigned),
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
    """Whether the first check that blames something is right, right among others, or wrong, or whether none is raised.

    What else is blamed beside the right name follows in brackets.
    """
    own = {names[joint] for joint in mistake.joints}
    said = sorted(
        (one for one in checks if one.name in (*MISTAKES, *mistake.right) and one.name not in mistake.beside),
        key=lambda one: -SEVERITIES.index(one.severity),
    )
    right = [
        one for one in said if one.name in mistake.right and own <= {*one.joints, *(own if not one.joints else ())}
    ]
    several = [one for one in said if one.name == "sign-or-column" and own and own <= set(one.joints)]
    if not said:
        return "missed"
    clauses = [
        clause.format(joint=joint) for joint in own or {""} for name, clause in CLAUSES.items() if name in mistake.right
    ]
    if said[0] not in right and "equally well with" in said[0].text and any(one in said[0].text for one in clauses):
        return "among others"
    if said[0] not in (*right, *several):
        return "wrong: " + "; ".join(" ".join((one.name, *one.joints)) for one in said)
    exact = said[0] in right and (not own or mistake.right == ("torques-opposite",) or len(said[0].joints) <= len(own))
    others = sorted({one.name for one in said} - {*mistake.right, *(one.name for one in several)})
    return ("right" if exact else "among others") + (f" (and {', '.join(others)})" if others else "")


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


def campaign(arms: Iterable[tuple[str, int, RobotFile, Recording]]) -> dict[str, list[str]]:
    """Return what was said of each mistake on each arm."""
    rows: dict[str, list[str]] = {}
    for label, seed, robot_file, run in arms:
        model = build_model(robot_file)
        for mistake in all_mistakes(model.dof, model.sliding, np.random.default_rng(seed)):
            if ONLY and not any(one in mistake.name for one in ONLY):
                continue
            said, error = outcome(mistake, run, robot_file)
            print(
                f"{label} ({model.dof}): {mistake.name} {mistake.joints}: {said} [{100 * error:.3g} %]",
                file=sys.stderr,
                flush=True,
            )
            rows.setdefault(mistake.name, []).append(said)
    return rows


def cell(name: str, said_of: Sequence[str]) -> str:
    """How often a mistake was named, and what else happened."""
    if not said_of:
        return "–"
    counts = Counter(said.split(":")[0].split(" (")[0] for said in said_of)
    counts["beside"] = sum(" (and " in said for said in said_of)
    good = "missed" if name == "nothing" else "right"
    others = [f"{counts[kind]} {word}" for kind, word in KINDS.items() if kind != good and counts[kind]]
    silent = " silent" if name == "nothing" else ""
    return ", ".join([f"{counts[good]} of {len(said_of)}{silent}", *others])


def first_arms(seeds: Iterable[int]) -> Iterator[tuple[str, int, RobotFile, Recording]]:
    """Arms of ordinary weight."""
    for seed in seeds:
        robot_file = arm(seed)
        yield f"arm {seed}", seed, robot_file, recorded(robot_file, seed)


def further_arms(seeds: Iterable[int]) -> Iterator[tuple[str, int, RobotFile, Recording]]:
    """Arms of all sizes with noisy positions."""
    for seed in seeds:
        robot_file = further_arm(seed)
        motion = random_fourier_motion(build_model(robot_file), PERIOD, seed, candidates=5)
        run = noisy_positions(simulate_recording(robot_file, motion, DURATION, seed, rate=RATE), seed)
        yield f"further arm {seed}", seed, robot_file, mistakes.with_velocity(run)


def delays(count: int) -> None:
    """Print, of lifts that carry an arm with a light wrist, what is found of a torque that is 0 and 4 ms late."""
    print("| arm | jitter [ms] | late by [ms] | found [ms] | used [ms] | held-out error [%] | checks |")
    print("|---|---|---|---|---|---|---|")
    fine = 10
    for seed in range(1, 1 + count):
        generator = np.random.default_rng([seed, 8])
        content = yaml.safe_load(built_arm(seed, wrist=0.3, sizes=(0.8, 0.9)).text)
        slide(content, 0, generator)
        content["truth"]["noise"] |= {"encoder_resolution": 1e-4}
        robot_file = parse_robot(json.dumps(content), where=f"lift {seed}", folder=None)
        motion = random_fourier_motion(build_model(robot_file), 15.0, seed, candidates=5)
        run = simulate_recording(robot_file, motion, 30.0, seed, rate=50.0 * fine)
        torque = signals(run)["torque"]
        for jitter in (0.0, 0.004):
            for late in (0.0, 0.004):
                shift = round(late * 50.0 * fine)
                moved = with_signals(run, torque=np.roll(torque, shift, axis=0))
                moved = mistakes.jittering_position(mistakes.sampled(moved, fine), jitter, seed)
                found = identify([moved], [], replace(CHOICES, search_delay=True))
                search = found.delay
                said = "–" if search is None else milliseconds(search)
                used = "–" if search is None else f"{1e3 * search.used:.2f}"
                raised = ", ".join(c.name for c in found.checks if c.name in MISTAKES) or "none"
                error = 100 * found.validation.relative_error
                print(
                    f"| {seed} ({found.model.dof}) | {1e3 * jitter:g} | {1e3 * late:g} | {said} | {used} | {error:.2f} "
                    f"| {raised} |",
                    flush=True,
                )


if __name__ == "__main__":
    tracking.LONGEST, open_loop.WINDOWS = 0.2, 1  # no check that is read here follows from a simulation
    if sys.argv[1] == "delay":
        delays(int(sys.argv[2]))
        sys.exit()
    chosen = [
        range(1, 1 + int(numbers)) if numbers.isdigit() else [int(one) for one in numbers.split(",") if one]
        for numbers in (sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "0")
    ]
    columns = campaign(first_arms(chosen[0])), campaign(further_arms(chosen[1]))
    print(f"| mistake | {len(chosen[0])} arms | {len(chosen[1])} further arms |\n|---|---|---|")
    for name in dict.fromkeys([*columns[0], *columns[1]]):
        print(f"| {name} | {' | '.join(cell(name, column.get(name, [])) for column in columns)} |")
