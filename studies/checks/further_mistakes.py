"""Further mistakes in recordings of arms of several kinds and of public ones (docs/measurements/checks.md).

    python -m studies.checks.further_mistakes ARMS [DATA]

ARMS are kinds of `partial_mistakes`, `built:SEED`, `further:SEED`, `ordinary:SEED` (`random_mistakes`) or public
recordings (`ur10`, `tx40`, `panda`; DATA is their folder), separated by commas. Each mistake is made once, at joints
drawn at random; MISTAKES=NAME,… in the environment chooses some. A cell says the grade for torque prediction, the
held-out error, on simulated arms the delivered model's error on another, sound motion, and what is raised.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
import yaml
from random_arms import built_arm

from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, parse_robot
from drivers.core.arrays import BoolArray, FloatArray
from drivers.core.errors import DynidError
from ident.assessment.instants import Instants, instants
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.regressor import RegressorKernel
from ident.simulation import open_loop, tracking
from ident.verdict.catalogue import MISTAKES
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.checks import random_mistakes
from studies.checks.mistaken_recordings import turned
from studies.checks.partial_mistakes import DURATION, ONLY, RATE, Spoiling, arm, edited, recorded, rows_taken, with_time
from studies.checks.random_mistakes import signals, with_signals
from studies.models.consistency import public
from studies.synthetic.data_mistakes import sampled, with_velocity

PUBLIC = {"ur10": 1, "tx40": 10, "panda": 5}
"""Public recordings, and of how many rows each one is taken."""

Made = tuple[Recording, RobotFile]
Cases = dict[str, Callable[[], Made]]


def robot_of(name: str) -> RobotFile:
    """A simulated arm."""
    kind, _, seed = name.partition(":")
    if kind == "built":
        return parse_robot(json.dumps(yaml.safe_load(built_arm(int(seed)).text)), where=name, folder=None)
    return (
        {"further": random_mistakes.further_arm, "ordinary": random_mistakes.arm}[kind](int(seed))
        if seed
        else arm(kind)
    )


def of_values(s: Spoiling) -> dict[str, dict[str, FloatArray]]:
    """Mistakes in positions, velocities and torques."""
    time, q, dq, tau = s.motion
    one, count, rows = s.is_one, q.shape[1], len(time)
    rate = (rows - 1) / float(time[-1] - time[0])
    angle, sliding = np.arange(count) == s.angle, np.array(build_model(s.robot_file).sliding)
    late = (np.arange(rows) >= rows // 2)[:, None]
    slow = tau.copy()
    kept = np.exp(-4.0 * np.pi / rate)
    for row in range(1, rows):
        slow[row] = kept * slow[row - 1] + (1.0 - kept) * tau[row]
    steps = np.where(sliding, 1.0, 65536 / (2 * np.pi))
    ratio, peak = 100.0 * 30.0 / np.pi, np.max(np.abs(tau), axis=0)
    about = (np.abs(np.arange(rows) - rows // 2) < 1.5 * rate)[:, None]
    drifting = np.stack([np.interp(time + 0.5 * np.arange(rows) / rows, time, column) for column in tau.T], axis=1)
    moved = {"position": q + one * q[:, [s.other]], "velocity": dq + one * dq[:, [s.other]]}
    return {
        "nothing": {},
        "torques drift by 0.5 s against positions": {"torque": drifting},
        "two torques low-passed at 2 Hz": {"torque": np.where(one | s.is_other, slow, tau)},
        "torques clipped at 60 %": {"torque": np.clip(tau, -0.6 * peak, 0.6 * peak)},
        "one torque wraps at half its peak": {"torque": np.where(one, (tau + peak / 2) % peak - peak / 2, tau)},
        "velocities in rpm of the motors": {"velocity": dq * ratio},
        "one velocity in rpm of the motor": {"velocity": np.where(angle, dq * ratio, dq)},
        "positions in counts": {"position": np.floor(q * steps), "velocity": dq * steps},
        "one position in counts, wraps": {"position": np.where(angle, np.floor(q * steps + 32768) % 65536, q)},
        "one position in degrees": {"position": np.where(angle, np.rad2deg(q), q)},
        "one torque frozen in the second half": {"torque": np.where(late & one, tau[rows // 2], tau)},
        "all torques frozen for 3 s": {"torque": np.where(about, tau[rows // 2], tau)},
        "one torque 0 in the second half": {"torque": np.where(late & one, 0.0, tau)},
        "one ratio halved (torque)": {"torque": np.where(one, 0.5 * tau, tau)},
        "one ratio halved (position, torque)": {
            "position": np.where(one, 2 * q, q), "velocity": np.where(one, 2 * dq, dq),
            "torque": np.where(one, 0.5 * tau, tau),
        },
        "one position moves with another": moved,
        "positions and torques of coupled motors": {**moved, "torque": tau - s.is_other * tau[:, [s.one]]},
        "one torque in N·mm": {"torque": np.where(one, 1e3 * tau, tau)},
        "sign of one torque in the second half": {"torque": np.where(late & one, -tau, tau)},
        "signs of all torques in the second half": {"torque": np.where(late, -tau, tau)},
        "one torque without its negative part": {"torque": np.where(one, np.maximum(tau, 0.0), tau)},
        "one torque without its sign": {"torque": np.where(one, np.abs(tau), tau)},
        "one position off by 30°": {"position": np.where(angle, q + np.deg2rad(30), q)},
    }  # fmt: skip


def of_rows(s: Spoiling) -> dict[str, Recording]:
    """Mistakes in stamps and in the order of rows, and columns that are 1 s late."""
    time, q, dq, tau = s.motion
    rows, generator = len(time), s.generator
    rate = (rows - 1) / float(time[-1] - time[0])
    joints = s.run.streams[JOINTS_STREAM]
    channels = {name: one for name, one in joints.channels.items() if name != "velocity"}
    bare = replace(s.run, streams={**s.run.streams, JOINTS_STREAM: replace(joints, channels=channels)})
    blocks, second = np.array_split(np.arange(rows), 10), round(rate)
    mixed = np.concatenate([blocks[n] for n in generator.permutation(10)])

    def late(whose: BoolArray, **values: FloatArray) -> Recording:
        moved = {name: np.where(whose, np.roll(each, second, axis=0), each) for name, each in values.items()}
        left = np.arange(second, rows)
        return rows_taken(with_signals(s.run, **moved), left, time[left])

    twice = np.r_[0:rows, 0:rows]
    return {
        "one torque 1 s late": late(s.is_one, torque=tau),
        "all torques 1 s late": late(np.ones_like(s.is_one), torque=tau),
        "one position 1 s late": late(s.is_one, position=q, velocity=dq),
        "stamps × 1.1, no velocity": with_time(bare, 1.1 * time),
        "stamps in 1/1024 s": with_time(s.run, 1.024 * time),
        "stamps in 1/1024 s, no velocity": with_time(bare, 1.024 * time),
        "blocks in another order": rows_taken(s.run, mixed, time),
        "sorted by another column": rows_taken(s.run, np.argsort(q[:, s.one], kind="stable"), time),
        "appended to itself": rows_taken(s.run, twice, time[0] + np.arange(2 * rows) / rate),
        "in reverse order": rows_taken(bare, np.arange(rows)[::-1], time),
    }


def of_bodies(s: Spoiling, again: Callable[[RobotFile], Recording]) -> dict[str, FloatArray]:
    """Torques (N, n) of a load, without gravity, and beyond those of a model; `again` records on the same motion."""
    time, _, _, tau = s.motion

    def torque(change: Callable[[dict[str, Any]], None]) -> FloatArray:
        return signals(again(edited(s.robot_file, change)))["torque"]

    def loaded(content: dict[str, Any]) -> None:
        links = content["truth"]["links"]
        link = links[s.robot_file.robot.joint_names[-1]]
        link["mass"] += 0.1 * sum(each["mass"] for each in links.values())
        link["com"] = [each + 0.02 for each in link["com"]]

    def modelled(content: dict[str, Any]) -> None:
        factors = iter(np.random.default_rng(1).uniform(0.8, 1.1, 100).tolist())
        for link in content["truth"]["links"].values():
            factor = next(factors)
            link |= {"mass": factor * link["mass"], "inertia": [factor * each for each in link["inertia"]]}
        for joint in content["truth"]["joints"].values():
            joint |= {name: next(factors) * joint[name] for name in joint if name in ("viscous", "coulomb")}
        content["truth"]["noise"]["torque_std"] = dict.fromkeys(content["truth"]["noise"]["torque_std"], 0.0)

    return {
        "payload picked up half way": np.where((time > time.mean())[:, None], torque(loaded), tau),
        "torques without gravity": torque(lambda content: content["model"].update(gravity=[0, 0, 0], mounting="free")),
        "torques less a model's": tau - torque(modelled),
    }


def tilted(robot_file: RobotFile) -> RobotFile:
    """The robot file with gravity turned by 5°."""
    model = robot_file.robot.model
    gravity = np.array(model.gravity)
    turned_by = turned(5.0, int(np.argmin(np.abs(gravity)))) @ gravity
    model = model.model_copy(update={"gravity": tuple(turned_by.tolist())})
    return robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"model": model})})


def cases(robot_file: RobotFile, run: Recording, again: Callable[[RobotFile], Recording] | None, seed: int) -> Cases:
    """All mistakes, at joints drawn at random; `again` records a simulated arm on the same motion."""
    generator = np.random.default_rng([seed, 17])
    sliding = build_model(robot_file).sliding
    one, other = (int(joint) for joint in generator.choice(len(sliding), 2, replace=False))
    angle = int(generator.choice([joint for joint, slides in enumerate(sliding) if not slides]))
    s = Spoiling(robot_file, run, generator, one, other, angle)
    found: Cases = {name: partial(s.with_values, **values) for name, values in of_values(s).items()}
    found |= {name: partial(_believed, recording, robot_file) for name, recording in of_rows(s).items()}
    found["base tilted by 5°"] = lambda: (run, tilted(robot_file))
    if again is not None:
        found |= {name: partial(s.with_values, torque=torque) for name, torque in of_bodies(s, again).items()}
    return found


def _believed(run: Recording, robot_file: RobotFile) -> Made:
    return run, robot_file


def said(case: Callable[[], Made], choices: IdentifyChoices, truth: Instants | None) -> str:
    """The grade for torque prediction, the errors, and what is raised."""
    try:
        run, believed = case()
        found = identify([run], [], choices, believed)
        verdict = found.result.verdict
    except DynidError as refusal:
        return f"refused: {str(refusal).removeprefix('recording in memory: ').split(' (')[0]}"
    named = [
        f"`{one.name}`" + (f" {', '.join(one.joints)}" if one.joints else "")
        for one in verdict.checks
        if one.name in MISTAKES
    ]
    error = f"{100 * found.validation.relative_error:.2g} %"
    if truth is not None:
        error += f" ({100 * true_error(found, truth):.2g} %)"
    return f"{verdict.purposes['torque_prediction'].grade}, {error} {'; '.join(dict.fromkeys(named))}".strip()


def true_error(found: Identification, sound: Instants) -> float:
    """Relative error of the delivered model's torque along a sound recording."""
    kernel = RegressorKernel(found.model, found.base.columns)
    parameters = found.solution.parameters if found.consistent is None else found.consistent.parameters.base
    rest = sound.torque - np.einsum("nbN,b->nN", sound.regressor(kernel), parameters)
    weight = np.where(sound.counted, 1.0, 0.0)
    return float(np.sqrt(np.sum(weight * rest**2) / np.sum(weight * sound.torque**2)))


def rows_of(name: str, data: Path) -> dict[str, str]:
    """Return what is said of each mistake on an arm."""
    choices = IdentifyChoices(model=ModelChoices(friction="coulomb-viscous"), presliding=False)
    truth: Instants | None = None
    again: Callable[[RobotFile], Recording] | None = None
    if name in PUBLIC:
        run, own = public(data, name)
        run = with_velocity(sampled(run, PUBLIC[name]))
        robot_file = run.robot()
        choices = replace(choices, preprocess=own.preprocess)
        seed = len(name)
    else:
        robot_file = robot_of(name)
        seed = sum(map(ord, name))
        motion = random_fourier_motion(build_model(robot_file), 10.0, seed, candidates=5)

        def again(file: RobotFile) -> Recording:
            return with_velocity(simulate_recording(file, motion, DURATION, seed, rate=RATE))

        run = again(robot_file)
        other = identify([recorded(robot_file, seed + 1)], [], choices, robot_file)
        truth = instants(RegressorKernel(other.model, other.base.columns), [one.prepared for one in other.runs])
    rows = {}
    for mistake, case in cases(robot_file, run, again, seed).items():
        if not ONLY or any(one in mistake for one in ONLY):
            rows[mistake] = said(case, choices, truth)
            print(f"{name} | {mistake} | {rows[mistake]}", file=sys.stderr, flush=True)
    return rows


if __name__ == "__main__":
    tracking.LONGEST, open_loop.WINDOWS = 0.2, 1  # no check that is read here follows from a simulation
    arms = sys.argv[1].split(",")
    columns = [rows_of(name, Path(sys.argv[2] if len(sys.argv) > 2 else "../shared/data")) for name in arms]
    print(f"| mistake | {' | '.join(arms)} |\n|---|{'---|' * len(arms)}")
    for mistake in columns[0]:
        print(f"| {mistake} | {' | '.join(column.get(mistake, '–') for column in columns)} |")
