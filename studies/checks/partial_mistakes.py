"""Arms of unusual kinds, and mistakes in a part of a recording (docs/measurements/checks.md).

    python -m studies.checks.partial_mistakes all
    python -m studies.checks.partial_mistakes wall,track

A pendulum, a SCARA with a counterweight, arms on a wall and under a ceiling, a light arm with gears of 100:1, an arm on
a track, a small servo arm, a palletiser, a gantry and two arms on one torso; 15 s at 100 Hz of a random motion. Each
mistake is made once, of joints drawn at random: of one joint, from the middle of the recording on, growing over it, or
two together. A cell says the grade for torque prediction, the held-out error, and what is named.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import dynid
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import BoolArray, FloatArray, IntArray
from drivers.core.errors import DynidError
from ident.model.dynamic_model import build_model
from ident.simulation import open_loop, tracking
from ident.verdict.catalogue import MISTAKES
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.checks.mistaken_recordings import turned
from studies.checks.random_mistakes import signals, with_signals
from studies.synthetic import data_mistakes as mistakes

DURATION, RATE, SEED = 15.0, 100.0, 1
ONLY = tuple(one for one in os.environ.get("MISTAKES", "").split(",") if one)
RIGHT = np.pi / 2


@dataclass(frozen=True)
class Kind:
    """An arm of a kind.

    Attributes:
        rows: angle α [rad], lengths d and r [m] of each joint, and whether it slides; a fifth number is its antecedent.
        masses: of the links [kg].
        gravity: [m/s²] in the base's frame.
        friction: Coulomb friction over the root mean square of the other torque.
        rotor: inertia of the motor over that of the link and all beyond it.
        encoder: step [rad or m].
        noise: of the torque, over its root mean square.
        coupling: motor, and another joint that turns it, too, by a factor of 1.
    """

    rows: tuple[tuple[float, ...], ...]
    masses: tuple[float, ...]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    friction: float = 0.1
    rotor: float = 0.3
    encoder: float = 2e-5
    noise: float = 0.02
    coupling: tuple[tuple[int, int], ...] = ()


SIX = ((0, 0, 0.15, 0), (-RIGHT, 0, 0.12, 0), (0, 0.42, 0, 0), (RIGHT, 0.02, 0.38, 0), (-RIGHT, 0, 0, 0),
       (RIGHT, 0, 0.09, 0))  # fmt: skip
KINDS = {
    "pendulum": Kind(((RIGHT, 0, 0, 0), (0, 0.35, 0, 0)), (2.0, 1.2), friction=0.03, rotor=0.02),
    "scara": Kind(((0, 0, 0.3, 0), (0, 0.4, 0, 0), (0, 0.35, 0, 1)), (18.0, 9.0, 3.0), friction=0.15),
    "wall": Kind(SIX, (6.0, 9.0, 5.0, 2.5, 1.8, 0.8), (9.81, 0.0, 0.0), friction=0.5),
    "ceiling": Kind(SIX, (7.0, 8.0, 5.0, 2.0, 1.5, 0.5), (0.0, 0.0, 9.81)),
    "geared": Kind(
        ((0, 0, 0.2, 0), (-RIGHT, 0, 0, 0), (RIGHT, 0, 0.3, 0), (RIGHT, 0.03, 0, 0), (-RIGHT, -0.03, 0.3, 0),
         (RIGHT, 0, 0, 0), (RIGHT, 0.05, 0.08, 0)), (2.5, 2.2, 1.8, 1.5, 1.2, 0.8, 0.3), friction=0.7, rotor=4.0),
    "track": Kind(
        ((RIGHT, 0, 0.2, 1), (-RIGHT, 0, 0.3, 0), *SIX[1:]), (60.0, 20.0, 25.0, 14.0, 6.0, 4.0, 1.5),
        (0.0, 9.81, 0.0), friction=0.15),
    "servo": Kind(
        ((0, 0, 0.05, 0), (-RIGHT, 0, 0.03, 0), (0, 0.11, 0, 0), (0, 0.13, 0, 0), (RIGHT, 0, 0.06, 0)),
        (0.12, 0.16, 0.12, 0.09, 0.08), friction=0.4, rotor=0.8, encoder=1.5e-3, noise=0.05),
    "palletiser": Kind(
        ((0, 0, 0.8, 0), (-RIGHT, 0.3, 0, 0), (0, 1.1, 0, 0), (0, 1.3, 0, 0)), (380.0, 290.0, 240.0, 60.0),
        friction=0.08, rotor=0.5),
    "gantry": Kind(
        ((0, 0, 1.0, 1), (RIGHT, 0, 0.4, 1), (RIGHT, 0, 0.3, 1), (0, 0, 0.2, 0), (RIGHT, 0, 0.1, 0)),
        (40.0, 25.0, 15.0, 4.0, 2.0), (9.81, 0.0, 0.0), friction=0.1),
    "torso": Kind(
        ((0, 0, 0.5, 0), (RIGHT, 0.2, 0.1, 0), (0, 0.25, 0, 0), (0, 0.22, 0, 0), (-RIGHT, 0.2, 0.1, 0, 0),
         (0, 0.25, 0, 0), (0, 0.22, 0, 0)), (20.0, 3.0, 2.0, 1.0, 3.0, 2.0, 1.0)),
    "table": Kind(
        ((0, 0, 0.09, 0), (-RIGHT, 0.02, 0, 0), (0, 0.16, 0, 0), (0, 0.15, 0, 0), (RIGHT, 0, 0.05, 0)),
        (0.9, 0.8, 0.5, 0.25, 0.15), friction=0.35, rotor=0.4, encoder=4e-4, noise=0.03),
    "stacker": Kind(
        ((0, 0, 1.0, 0), (-RIGHT, 0.4, 0, 0), (0, 1.25, 0, 0), (0, 1.4, 0, 0)), (700.0, 420.0, 330.0, 90.0),
        friction=0.12, rotor=0.8, encoder=5e-6, coupling=((2, 1),)),
    "spherical": Kind(
        ((0, 0, 0.4, 0), (-RIGHT, 0, 0.1, 0), (RIGHT, 0, 0, 1), (0, 0, 0.3, 0), (-RIGHT, 0, 0, 0), (RIGHT, 0, 0.1, 0)),
        (12.0, 10.0, 6.0, 2.0, 1.5, 0.6), friction=0.15),
    "wrist": Kind(SIX, (30.0, 45.0, 25.0, 9.0, 6.0, 2.5), friction=0.2, rotor=0.6, coupling=((5, 4),)),
}  # fmt: skip


def arm(name: str) -> RobotFile:
    """An arm of a kind, with torque limits that its motions reach to 30 to 80 %."""
    kind = KINDS[name]
    count = len(kind.rows)
    generator = np.random.default_rng([list(KINDS).index(name), count])
    names = [f"axis{number}" for number in range(1, 1 + count)]
    antecedents = [
        "base" if not n else names[int(row[4])] if len(row) > 4 else names[n - 1] for n, row in enumerate(kind.rows)
    ]
    rows, links, turning = [], {}, {}
    joints: list[dict[str, Any]] = []
    size = sum(float(np.hypot(row[1], row[2])) for row in kind.rows)
    for n, (alpha, d, r, slides, *_) in enumerate(kind.rows):
        rows.append({"joint": names[n], "antecedent": antecedents[n], "alpha": alpha, "d": d, "r": 0.0 if slides else r,
                     "type": "prismatic" if slides else "revolute"})  # fmt: skip
        after = [kind.rows[m] for m in range(n + 1, count) if antecedents[m] == names[n]]
        ahead, out = (float(after[0][1]), float(after[0][2])) if after else (0.0, 0.3 * size / count)
        angle = float(after[0][0]) if after else 0.0
        end = np.array([ahead, -np.sin(angle) * out, np.cos(angle) * out])
        centre = 0.45 * end + 0.03 * size * generator.standard_normal(3)
        mass, width = kind.masses[n], 0.06 * size
        moments = mass * (width**2 * np.eye(3) / 4 + (end @ end * np.eye(3) - np.outer(end, end)) / 12)
        links[names[n]] = {"mass": mass, "com": centre.tolist(), "inertia": moments[np.triu_indices(3)].tolist()}
        beyond = sum(kind.masses[n:])
        inertia = beyond if slides else beyond * (0.25 * size * (count - n) / count + 0.02 * size) ** 2
        turning[names[n]] = {"motor_inertia": kind.rotor * inertia, "viscous": 0.0, "coulomb": 0.0, "offset": 0.0}
        travel = 0.25 * size if slides else 2.4
        speed = float(generator.uniform(0.8, 1.2)) * (0.4 * size if slides else 3.0)
        joints.append({"name": names[n], "position": [-travel, travel], "velocity": speed,
                       "acceleration": 5.0 * speed})  # fmt: skip
    content: dict[str, Any] = {
        "name": name,
        "model": {"mdh": rows, "gravity": list(kind.gravity), "mounting": "free",
                  "coupling": {names[m]: {names[m]: 1.0, names[n]: 1.0} for m, n in kind.coupling}},
        "joints": joints,
        "drives": [{"joint": one, "signal": "torque", "inertia": True} for one in names],
        "truth": {
            "links": links, "joints": turning,
            "noise": {"rate": RATE, "encoder_resolution": kind.encoder, "torque_std": dict.fromkeys(names, 0.0)},
        },
    }  # fmt: skip
    torque = signals(recorded(_parsed(content), 1))["torque"]
    for n, one in enumerate(names):
        level = float(np.sqrt(np.mean(torque[:, n] ** 2)))
        rubbing = kind.friction * level
        turning[one] |= {"coulomb": rubbing, "viscous": 0.5 * rubbing / joints[n]["velocity"],
                         "offset": 0.05 * rubbing}  # fmt: skip
        content["truth"]["noise"]["torque_std"][one] = kind.noise * level
        joints[n]["torque"] = float(np.max(np.abs(torque[:, n]))) * (1 + kind.friction) / generator.uniform(0.3, 0.8)
    return _parsed(content)


def _parsed(content: dict[str, Any]) -> RobotFile:
    return parse_robot(json.dumps(content), where=str(content["name"]), folder=None)


def recorded(robot_file: RobotFile, seed: int, rate: float = RATE) -> Recording:
    """A recording with the velocity that its positions have."""
    motion = random_fourier_motion(build_model(robot_file), 10.0, seed, candidates=5)
    return mistakes.with_velocity(simulate_recording(robot_file, motion, DURATION, seed, rate=rate))


def edited(robot_file: RobotFile, change: Callable[[dict[str, Any]], None]) -> RobotFile:
    """The robot file with its content changed."""
    content = json.loads(robot_file.text)
    change(content)
    return _parsed(content)


@dataclass(frozen=True)
class Spoiling:
    """A sound recording with what mistakes in it are made of.

    Attributes:
        robot_file: the arm's.
        run: its recording.
        generator: of everything that is drawn.
        one, other: two motors, drawn at random.
        angle: a joint that turns.
    """

    robot_file: RobotFile
    run: Recording
    generator: np.random.Generator
    one: int
    other: int
    angle: int

    @property
    def motion(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Stamps (N,), positions, velocities and torques (N, n)."""
        values = signals(self.run)
        return self.run.streams[JOINTS_STREAM].time, values["position"], values["velocity"], values["torque"]

    @property
    def is_one(self) -> BoolArray:
        """(n,) the first motor."""
        return np.equal(np.arange(len(self.robot_file.robot.joints)), self.one)

    @property
    def is_other(self) -> BoolArray:
        """(n,) the second one."""
        return np.equal(np.arange(len(self.robot_file.robot.joints)), self.other)

    def with_values(self, **values: FloatArray) -> tuple[Recording, RobotFile]:
        """The recording with other values, and the arm's file."""
        return with_signals(self.run, **values), self.robot_file

    def with_file(self, change: Callable[[dict[str, Any]], None]) -> tuple[Recording, RobotFile]:
        """The recording, and the file with a change."""
        return self.run, edited(self.robot_file, change)


Cases = dict[str, Callable[[], tuple[Recording, RobotFile]]]
"""Mistakes by name: each makes the recording and the robot file that is believed."""


def of_torques(s: Spoiling) -> Cases:
    """Mistakes in torques."""
    time, q, dq, tau = s.motion
    one, other, peak = s.is_one, s.is_other, np.max(np.abs(tau), axis=0)
    swapped = np.arange(tau.shape[1])
    swapped[[s.one, s.other]] = s.other, s.one
    late, growing = (time > time.mean())[:, None], np.linspace(0.0, 1.0, len(time))[:, None]
    level = np.sqrt(np.mean(tau**2, axis=0))
    noise = np.round(s.generator.standard_normal(tau.shape))
    spikes = s.generator.random(tau.shape) < 0.2
    torques = {
        "nothing": tau,
        "torques exchanged": tau[:, swapped],
        "one current in mA": tau * np.where(one, 1e3, 1.0),
        "gear ratio of one joint forgotten": tau * np.where(one, 0.02, 1.0),
        "all torques × 0.1": 0.1 * tau,
        "one gain × 1.3 from the middle on": tau * np.where(late & one, 1.3, 1.0),
        "all gains grow by 20 %": tau * (1.0 + 0.2 * growing),
        "one gain grows by 20 %": tau * (1.0 + 0.2 * growing * one),
        "one torque's sign from the middle on": tau * np.where(late & one, -1.0, 1.0),
        "two torques exchanged from the middle on": np.where(late, tau[:, swapped], tau),
        "positions as torques": q,
        "velocities as torques": dq,
        "temperatures as torques": 30.0 + 8.0 * growing + 0.3 * noise,
        "one torque is another's": np.where(one, tau[:, [s.other]], tau),
        "one torque is constant": np.where(one, tau.mean(axis=0), tau),
        "torques of 12 bits": np.round(tau / peak * 2048) / 2048 * peak,
        "torques of 6 bits": np.round(tau / peak * 32) / 32 * peak,
        "torques saturated at 60 %": np.clip(tau, -0.6 * peak, 0.6 * peak),
        "one torque saturated at 60 %": np.where(one, np.clip(tau, -0.6 * peak, 0.6 * peak), tau),
        "one torque 60 ms late": np.where(one, np.roll(tau, round(0.06 * RATE), axis=0), tau),
        "all torques 60 ms late": np.roll(tau, round(0.06 * RATE), axis=0),
        "torques averaged over 0.3 s": np.stack([np.convolve(c, np.ones(30) / 30, "same") for c in tau.T], axis=1),
        "sign of one torque, gain × 2 of another": tau * np.where(one, -1.0, np.where(other, 2.0, 1.0)),
        "two torques' signs, and × 0.1 all": 0.1 * tau * np.where(one | other, -1.0, 1.0),
        "20 % of the samples are spikes": tau + 5.0 * level * spikes,
    }
    return {name: partial(s.with_values, torque=values) for name, values in torques.items()}


def of_bodies(s: Spoiling) -> Cases:
    """A load that is picked up, and gravity taken off the torques."""
    time, _, _, tau = s.motion
    last = s.robot_file.robot.joint_names[-1]
    added = 0.1 * sum(KINDS[s.robot_file.robot.name].masses)

    def loaded(content: dict[str, Any]) -> None:
        link = content["truth"]["links"][last]
        link |= {"mass": link["mass"] + added, "com": [one + 0.02 for one in link["com"]]}

    def picked_up() -> tuple[Recording, RobotFile]:
        other = signals(recorded(edited(s.robot_file, loaded), SEED))["torque"]
        return s.with_values(torque=np.where((time > time.mean())[:, None], other, tau))

    def weightless() -> tuple[Recording, RobotFile]:
        bare = edited(s.robot_file, lambda content: content["model"].update(gravity=[0, 0, 0]))
        return s.with_values(torque=signals(recorded(bare, SEED))["torque"])

    return {"10 % of the mass picked up in the middle": picked_up, "gravity compensated in the torques": weightless}


def of_positions(s: Spoiling) -> Cases:
    """Mistakes in positions."""
    time, q, dq, tau = s.motion
    one, turned_one = s.is_one, np.arange(q.shape[1]) == s.angle
    coupled = {name: values - np.where(one, values[:, [s.other]], 0.0) for name, values in (("q", q), ("dq", dq))}
    late = np.where((time > time.mean())[:, None] & turned_one, 0.17, 0.0)
    rolled = {
        "position": np.where(one, np.roll(q, 6, axis=0), q),
        "velocity": np.where(one, np.roll(dq, 6, axis=0), dq),
    }
    motor = tau + np.where(s.is_other, tau[:, [s.one]], 0.0)
    return {
        "one zero lost by 10° in the middle": partial(s.with_values, position=q + late),
        "position and velocity exchanged": partial(s.with_values, position=dq, velocity=q),
        "position and velocity of one joint exchanged": partial(
            s.with_values, position=np.where(one, dq, q), velocity=np.where(one, q, dq)
        ),
        "one position in degrees": partial(s.with_values, position=q * np.where(turned_one, 180 / np.pi, 1.0)),
        "one position 60 ms late": partial(s.with_values, **rolled),
        "coupled motors not declared": partial(
            s.with_values, torque=motor, position=coupled["q"], velocity=coupled["dq"]
        ),
    }


def of_the_file(s: Spoiling) -> Cases:
    """Mistakes in the robot file."""
    count = len(s.robot_file.robot.joints)

    def gravity(matrix: FloatArray) -> tuple[Recording, RobotFile]:
        other = (matrix @ np.array(s.robot_file.robot.model.gravity)).tolist()
        return s.with_file(lambda content: content["model"].update(gravity=other))

    def lengths(factor: float, first: int) -> tuple[Recording, RobotFile]:
        def change(content: dict[str, Any]) -> None:
            for row in content["model"]["mdh"][first:]:
                row |= {"d": row["d"] * factor, "r": row["r"] * factor}

        return s.with_file(change)

    def axis(content: dict[str, Any]) -> None:
        content["model"]["mdh"][s.one]["alpha"] += np.pi

    across = np.flatnonzero(np.array(s.robot_file.robot.model.gravity) == 0.0)  # about gravity a turn is no mistake
    about = [int(one) for one in s.generator.choice(across, size=2)]
    return {
        "gravity of the file × −1": partial(gravity, -np.eye(3)),
        "gravity of the file 15° off": partial(gravity, turned(15.0, about[0])),
        "base turned by 90°": partial(gravity, turned(90.0, about[1])),
        "lengths of a sibling, × 1.25": partial(lengths, 1.25, 0),
        "last lengths of a sibling, × 1.4": partial(lengths, 1.4, count - 2),
        "one length in cm": partial(lengths, 100.0, count - 1),
        "an axis turned over": partial(s.with_file, axis),
    }


def of_stamps(s: Spoiling) -> Cases:
    """Mistakes in stamps and rows."""
    time, _, dq, _ = s.motion
    left, twice = np.r_[0:600, 900 : len(time)], np.r_[0:800, 600 : len(time)]
    found = {
        "3 s missing, stamps go on": lambda: rows_taken(s.run, left, time[: len(left)]),
        "3 s missing": lambda: rows_taken(s.run, left, time[left]),
        "2 s twice, stamps go on": lambda: rows_taken(s.run, twice, np.arange(len(twice)) / RATE),
        "stamps of 50 ms": lambda: with_time(s.run, np.floor(time / 0.05) * 0.05),
        "stamps of 32 bits wrap": lambda: with_time(s.run, (time + 2**32 * 1e-9 - 8.0) % (2**32 * 1e-9)),
        "stamps in ms": lambda: with_time(s.run, 1e3 * time, velocity=dq),
        "stamps × 1.1": lambda: with_time(s.run, 1.1 * time),
    }
    return {name: partial(_believed, change, s.robot_file) for name, change in found.items()}


def _believed(change: Callable[[], Recording], robot_file: RobotFile) -> tuple[Recording, RobotFile]:
    return change(), robot_file


def with_time(run: Recording, time: FloatArray, **values: FloatArray) -> Recording:
    """The recording with other stamps [s]."""
    stream = replace(with_signals(run, **values).streams[JOINTS_STREAM], time=time, host_time=time)
    return replace(run, streams={**run.streams, JOINTS_STREAM: stream})


def rows_taken(run: Recording, rows: IntArray, time: FloatArray) -> Recording:
    """Some rows of the recording, with stamps [s]."""
    stream = run.streams[JOINTS_STREAM]
    channels = {name: replace(one, values=one.values[rows]) for name, one in stream.channels.items()}
    stream = replace(stream, time=time, host_time=time, channels=channels)
    return replace(run, streams={**run.streams, JOINTS_STREAM: stream})


def cases(robot_file: RobotFile) -> Cases:
    """All mistakes, at joints drawn at random."""
    sliding = build_model(robot_file).sliding
    generator = np.random.default_rng([SEED, len(sliding)])
    one, other = (int(joint) for joint in generator.choice(len(sliding), 2, replace=False))
    turning = [joint for joint, slides in enumerate(sliding) if not slides]
    angle = turning[int(generator.integers(len(turning)))]
    spoiling = Spoiling(robot_file, recorded(robot_file, SEED), generator, one, other, angle)
    groups = (of_torques, of_bodies, of_positions, of_the_file, of_stamps)
    return {name: case for group in groups for name, case in group(spoiling).items()}


def said(case: Callable[[], tuple[Recording, RobotFile]]) -> str:
    """The grade for torque prediction, the held-out error, and what is raised."""
    try:
        run, believed = case()
        result = dynid.identify(replace(run, robot_text=believed.text), friction="coulomb-viscous")
    except DynidError as refusal:
        return f"refused: {refusal}"
    named = [
        f"`{one.name}`" + (f" {', '.join(one.joints)}" if one.joints else "")
        for one in result.verdict.checks
        if one.name in MISTAKES
    ]
    error = 100 * result.validation.relative_error if result.validation else float("nan")
    grade = result.verdict.purposes["torque_prediction"].grade
    return f"{grade}, {error:.2g} % {'; '.join(dict.fromkeys(named))}".strip()


def table(kinds: Sequence[str]) -> None:
    """Print what is said, mistake by arm."""
    rows: dict[str, list[str]] = {}
    for kind in kinds:
        for name, case in cases(arm(kind)).items():
            if not ONLY or any(one in name for one in ONLY):
                cell = said(case)
                print(f"{kind} | {name} | {cell}", file=sys.stderr, flush=True)
                rows.setdefault(name, []).append(cell)
    print(f"| mistake | {' | '.join(kinds)} |\n|---|{'---|' * len(kinds)}")
    for name, cells in rows.items():
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    tracking.LONGEST, open_loop.WINDOWS = 0.2, 1  # no check that is read here follows from a simulation
    table(list(KINDS) if sys.argv[1] == "all" else sys.argv[1].split(","))
