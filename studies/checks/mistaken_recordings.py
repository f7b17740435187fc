"""What is said of a recording after a deliberate mistake (docs/measurements/checks.md).

    python -m studies.checks.mistaken_recordings ../shared/data 40

Public recordings and simulated arms are prepared once; then signs, columns, gains, zeros and gravity are spoilt one
after the other in what was prepared (all of them act linearly on it), the fit is made anew, and its check is read. The
last argument is the number of random arms on which, each followed exactly with moderate noise and once more with
friction and ripple that the model does not know, nothing may be named. It takes some twenty minutes.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
from random_arms import random_arm

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from ident.assessment.mistakes.checks import mistake_checks
from ident.estimators.torque_estimator import reduce_torques
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.regressor import RegressorKernel
from ident.regression.comparison import compare_torques, independent_share, residual_autocorrelation
from ident.regression.least_squares import excited_columns, weighted_least_squares
from ident.regression.observability import experiment_base
from ident.signals.pipeline import PreprocessChoices
from ident.signals.prepared import Prepared, Segment
from ident.verdict.catalogue import MISTAKES
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

EXAMPLES = Path(__file__).parents[2] / "examples"
UR10 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
PANDA = tuple(f"joint_{number}" for number in range(1, 8))
SIMULATED = ("up6",)

Change = Callable[[Segment], Segment]


@dataclass(frozen=True)
class Mistake:
    """A deliberate mistake, and what may be said of it.

    Attributes:
        group: row of the table.
        right: name of the check that names it; empty where nothing is wrong.
        joints: that it has to name.
        change: of every segment.
        turn: rotation (3, 3) of the believed gravity.
    """

    group: str
    right: str
    joints: tuple[int, ...]
    change: Change = lambda segment: segment
    turn: FloatArray | None = None


def arms(folder: Path) -> Iterator[tuple[str, str, Path, IdentifyChoices]]:
    """Name, robot file, recording and choices of each public recording."""
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


def recorded_arms(folder: Path) -> Iterator[tuple[str, Recording, IdentifyChoices]]:
    """Public recordings, then simulated ones of 20 s."""
    for name, text, path, choices in arms(folder):
        yield name, import_file(path, parse_robot(text, where=name, folder=folder), ImportChoices()), choices
    for name in SIMULATED:
        robot_file = load_robot(name)
        motion = random_fourier_motion(build_model(robot_file), 10.0, 1, candidates=5)
        yield name, simulate_recording(robot_file, motion, 20.0, 1), IdentifyChoices()


def torque_times(factors: FloatArray) -> Change:
    """Torques (n, N) times factors (n,)."""
    return lambda segment: replace(segment, torque=segment.torque * factors[:, None])


def position_times(factors: FloatArray) -> Change:
    """Positions times factors (n,)."""
    scale = factors[:, None]
    return lambda segment: replace(
        segment,
        position=segment.position * scale,
        velocity=segment.velocity * scale,
        acceleration=segment.acceleration * scale,
    )


def zero_off(joint: int, angle: float) -> Change:
    """An angle [rad] added to a joint's positions."""

    def change(segment: Segment) -> Segment:
        position = segment.position.copy()
        position[joint] += angle
        return replace(segment, position=position)

    return change


def taken(order: Sequence[int], torques: bool, positions: bool) -> Change:
    """Columns in another order."""
    rows = list(order)

    def change(segment: Segment) -> Segment:
        if torques:
            segment = replace(segment, torque=segment.torque[rows])
        if positions:
            motion = (segment.position[rows], segment.velocity[rows], segment.acceleration[rows])
            segment = replace(segment, position=motion[0], velocity=motion[1], acceleration=motion[2])
        return segment

    return change


def turned(degrees: float, axis: int) -> FloatArray:
    """A rotation (3, 3) about an axis of the base."""
    angle, one, other = np.deg2rad(degrees), (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[one, one] = matrix[other, other] = np.cos(angle)
    matrix[one, other], matrix[other, one] = -np.sin(angle), np.sin(angle)
    return matrix


def mistakes(count: int) -> Iterator[Mistake]:
    """All of them, for an arm of n joints."""
    one = np.ones(count)
    everyone = tuple(range(count))
    yield Mistake("nothing", "", ())
    yield Mistake("all torques × −1", "torques-opposite", everyone, torque_times(-one))
    for joint in everyone:
        flipped = np.where(np.arange(count) == joint, -1.0, 1.0)
        yield Mistake("sign of a torque", "torque-sign", (joint,), torque_times(flipped))
        yield Mistake("sign of a position", "position-sign", (joint,), position_times(flipped))
    for pair in pairwise(everyone):
        order = list(everyone)
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        yield Mistake("torques exchanged", "torques-exchanged", pair, taken(order, True, False))
        yield Mistake("positions exchanged", "positions-exchanged", pair, taken(order, False, True))
        yield Mistake("both exchanged", "joints-exchanged", pair, taken(order, True, True))
    for degrees, name in ((15.0, "gravity tilted by 15°"), (90.0, "gravity tilted by 90°")):
        for axis in (0, 1):
            yield Mistake(name, "gravity-direction", (), turn=turned(degrees, axis))
    yield Mistake("gravity × −1", "gravity-opposite", (), turn=turned(180.0, 0))
    for factor, name in ((1.2, "gain × 1.2"), (0.02, "gain left at 1 (× 0.02)")):
        for joint in everyone:
            scale = np.where(np.arange(count) == joint, factor, 1.0)
            yield Mistake(name, "inconsistent-gain", (joint,), torque_times(scale))
    for joint in everyone:
        yield Mistake("zero off by 5°", "joint-zero", (joint,), zero_off(joint, float(np.deg2rad(5.0))))
    yield Mistake("torques without sign", "unsigned-torque", (), lambda s: replace(s, torque=np.abs(s.torque)))


def named(found: Identification, model: DynamicModel, runs: Sequence[Prepared]) -> list[tuple[str, tuple[str, ...]]]:
    """Name and joints of the check that is raised for other data or another gravity."""
    experiment = found.experiment
    base = found.base if model is found.model else experiment_base(model, [experiment])
    kernel = RegressorKernel(model, base.columns)
    reduction = reduce_torques(kernel, runs, experiment.torques)
    solution = weighted_least_squares(reduction, excited_columns(reduction))
    series = [
        one
        for run in runs
        for one in compare_torques(model, base.columns, solution.parameters, run.segments, run.parallel_filter)
    ]
    share = independent_share(residual_autocorrelation(series)[list(experiment.torques)])
    checks = mistake_checks(model, experiment, base, runs, solution, share * solution.rows)
    return [(check.name, check.joints) for check in checks]


def judged(mistake: Mistake, said: list[tuple[str, tuple[str, ...]]], names: Sequence[str]) -> str:
    """Whether a mistake was named, named among others, or something else was."""
    if not said:
        return "silent"
    name, joints = said[0]
    own = {names[joint] for joint in mistake.joints}
    if name == mistake.right and (own <= set(joints) or not mistake.joints):
        return "right" if not own or len(joints) <= len(own) else "among others"
    return "among others" if name == "sign-or-column" and own <= set(joints) else f"wrong: {name} {' '.join(joints)}"


def table(folder: Path) -> None:
    """Print how often each mistake is named, by arm."""
    lines: dict[str, list[str]] = {}
    head = []
    for arm, recording, choices in recorded_arms(folder):
        found = identify([recording], [], choices)
        runs = [run.prepared for run in found.runs]
        counts: dict[str, dict[str, int]] = {}
        for mistake in mistakes(found.model.dof):
            spoilt = [replace(run, segments=tuple(mistake.change(one) for one in run.segments)) for run in runs]
            model = found.model
            if mistake.turn is not None:
                model = replace(model, gravity=mistake.turn @ model.gravity)
            outcome = judged(mistake, named(found, model, spoilt), model.joint_names)
            print(f"{arm}: {mistake.group} {mistake.joints}: {outcome}", file=sys.stderr, flush=True)
            of_group = counts.setdefault(mistake.group, {})
            of_group[outcome] = of_group.get(outcome, 0) + 1
        head.append(f"{arm} ({100 * found.validation.relative_error:.1f} %)")
        for group, outcomes in counts.items():
            lines.setdefault(group, []).append(", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()))
    print(f"| mistake | {' | '.join(head)} |\n|---|{'---|' * len(head)}")
    for group, cells in lines.items():
        print(f"| {group} | {' | '.join(cells)} |")


def less_known(robot_file: RobotFile, seed: int) -> RobotFile:
    """The arm with friction of other shapes, ripple and noise of half its Coulomb friction."""
    generator = np.random.default_rng(seed)
    content = json.loads(robot_file.text)
    noise = content["truth"]["noise"]
    noise["ripple_amplitude"] = {}
    for name, joint in content["truth"]["joints"].items():
        joint["stribeck"] = joint["coulomb"] * float(generator.uniform(0.2, 0.8))
        joint["stribeck_velocity"] = float(generator.uniform(0.05, 0.3))
        joint["alpha"] = float(generator.uniform(0.6, 1.0))
        noise["torque_std"][name] = 0.3 + 0.5 * joint["coulomb"]
        noise["ripple_amplitude"][name] = 0.3 * joint["coulomb"]
    content["friction"] = {"stribeck": True, "exponent": 0.8}
    return parse_robot(json.dumps(content), where=robot_file.where, folder=None)


def false_alarms(count: int) -> None:
    """Print on how many random arms, which are right, something is named."""
    alarms = {"exact": 0, "less known": 0}
    for seed in range(count):
        robot_file = random_arm(seed, trees=seed % 4 == 0)
        motion = random_fourier_motion(build_model(robot_file), 10.0, seed, candidates=5)
        for kind, plant in (("exact", robot_file), ("less known", less_known(robot_file, seed))):
            recording = simulate_recording(plant, motion, 20.0, seed, rate=100)
            checks = identify([recording], [], IdentifyChoices(search_delay=False), robot_file).checks
            wrong = [check.name for check in checks if check.name in MISTAKES]
            alarms[kind] += bool(wrong)
            print(f"random arm {seed}, {kind}: {wrong or 'nothing'}", file=sys.stderr, flush=True)
    print("\n| random arms | recordings on which something is named |\n|---|---|")
    print(f"| exact | {alarms['exact']} of {count} |")
    print(f"| friction, ripple and noise that the model does not know | {alarms['less known']} of {count} |")


if __name__ == "__main__":
    table(Path(sys.argv[1]))
    if len(sys.argv) > 2:
        false_alarms(int(sys.argv[2]))
