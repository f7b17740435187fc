"""How often do 95 % intervals hold the truth? Simulated arms, many seeds; about a minute per method with 10 seeds.

Every seed is another arm: the bodies and the friction of a built-in one, each scaled at random. It plays a periodic
motion of 20 s, or goes through 24 random points. Lowest and highest of the arms' shares of true values inside ±1.96
standard deviations, over all seeds: of the base parameters (corrected and classical deviations), of those that the
essential model keeps (`essential_std`, and the submodel's own deviations, which know nothing of the selection), and of
the torque along another motion (`torque_std` of the full and of the essential model); the median of `essential_std`
over `std`.

python -m studies.coverage.coverage [seeds [methods, as wls,irls:weights=huber [motions, as periodic,points]]]
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml

from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.arrays import FloatArray
from ident.identify.identification import IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.identify.summary import Identified
from ident.model.dynamic_model import build_model
from ident.model.regressor import model_torque
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.result.models.model import Model
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording
from studies.coverage.seeds import of_cases
from studies.synthetic.random_points import random_points_motion

Play = Literal["periodic", "points"]

ROBOTS = ("ur5e", "rocr6", "aubo_i5", "panda")
METHODS: tuple[str, ...] = ("wls", "ols", "irls", "energy", "power")
DURATION = 20.0
HELD_OUT = 8.6
MOVES = 24
INSTANTS = 200
SPREAD = 0.5
"""Standard deviation of the logarithm of what masses and friction are scaled by; of lengths, half of it."""

COLUMNS = ("full", "classical", "kept", "submodel", "torque", "torque kept")
TABLES = (
    (("parameters, jackknife", "parameters, classical", "torque"), (0, 1, 4)),
    (
        ("parameters kept", "the same, refit's own deviations", "torque", "`essential_std` / `std`, median"),
        (2, 3, 5, 6),
    ),
)
"""Headings, and which of `COLUMNS` and the ratio are below them."""


def another_arm(name: str, seed: int) -> RobotFile:
    """A built-in arm with bodies and friction scaled at random."""
    known = load_robot(name)
    generator = np.random.default_rng([seed, len(name)])
    robot = yaml.safe_load(known.text)
    for body in robot["truth"]["links"].values():
        mass, length = np.exp(SPREAD * np.array([1.0, 0.5]) * generator.standard_normal(2)).tolist()
        body["mass"] *= mass
        body["com"] = [length * value for value in body["com"]]
        body["inertia"] = [mass * length**2 * value for value in body["inertia"]]
    for joint in robot["truth"]["joints"].values():
        for key in {"viscous", "coulomb", "motor_inertia", "offset"} & joint.keys():
            joint[key] *= float(np.exp(SPREAD * generator.standard_normal()))
    return parse_robot(yaml.safe_dump(robot), where=name, folder=None, urdf_text=known.urdf_text)


def identified(arm: RobotFile, method: str, play: Play, seed: int) -> Identified:
    """The arm's model with the friction that it has, from the first part of the motion."""
    choices = IdentifyChoices(method, model=ModelChoices(friction="coulomb-viscous"))
    if play == "points":
        motion = random_points_motion(arm.robot, seed, MOVES)
        recording = simulate_recording(arm, motion, motion.duration, seed)
        return identify([recording], [], choices)
    periodic = random_fourier_motion(build_model(arm), DURATION, seed=seed, candidates=10)
    recording = simulate_recording(arm, periodic, DURATION + HELD_OUT, seed=seed)
    return identify([recording], [], replace(choices, split=DURATION))


def deviations(robot: str, method: str, play: Play, seed: int) -> tuple[list[FloatArray], float]:
    """Errors over standard deviations, an array for each of `COLUMNS`, and the ratio `wide`."""
    arm = another_arm(robot, seed)
    found = identified(arm, method, play, seed)
    result = found.result
    truth = dict(zip(found.base.names, found.base.projection @ truth_vector(arm), strict=True))
    table = [
        (entry.value, entry.std, entry.classical_std, truth[entry.name])
        for entry in result.base_parameters
        if entry.value is not None
    ]
    value, std, classical, true = np.array(table, dtype=np.float64).T
    kept = list(found.pruned.solution.active)
    entries = {entry.name: entry for entry in result.base_parameters}
    of_kept = [entries[found.base.names[i]] for i in kept]
    essential_std = np.array([entry.essential_std for entry in of_kept], dtype=np.float64)
    error = found.pruned.solution.parameters[kept] - np.array([truth[entry.name] for entry in of_kept])
    inflation = found.std[kept] / found.solution.std[kept]
    motion = random_points_motion(arm.robot, 1000 + seed, 8)
    samples = [signal.T for signal in motion.evaluate(np.linspace(0.0, motion.duration, INSTANTS + 2)[1:-1])]
    torque = model_torque(found.model, None, truth_vector(arm), samples[0].T, samples[1].T, samples[2].T).T
    models = [Model(result, kind) for kind in ("full", "essential")]
    figures = [
        (value - true) / std,
        (value - true) / classical,
        error / essential_std,
        error / (found.pruned.solution.std[kept] * inflation),
        *((model.torque(*samples) - torque) / model.torque_std(*samples) for model in models),
    ]
    return [figure.ravel() for figure in figures], float(np.median(essential_std / found.std[kept]))


def shares(robot: str, seeds: int, method: str, play: Play) -> list[float]:
    """Return for one arm the shares [%] of `COLUMNS` inside, and the median ratio `wide`."""
    found = list(of_cases(deviations, [(robot, method, play, seed) for seed in range(seeds)]))
    columns = zip(*(figures for figures, _ in found), strict=True)
    inside = [100.0 * float(np.mean(np.abs(np.concatenate(column)) <= WITHIN_95_PERCENT)) for column in columns]
    return [*inside, float(np.median([ratio for _, ratio in found]))]


def spans(of_arms: Sequence[float], unit: str) -> str:
    """Lowest and highest figure."""
    digits = 1 if unit else 2
    low, high = (f"{figure:.{digits}f}" for figure in (min(of_arms), max(of_arms)))
    return (low if low == high else f"{low} to {high}") + unit


def main(
    robots: Sequence[str] = ROBOTS,
    seeds: int = 10,
    methods: Sequence[str] = METHODS,
    plays: Sequence[Play] = ("periodic", "points"),
) -> None:
    """Print a table for the base parameters, and one for the essential ones."""
    rows: dict[str, list[list[float]]] = {}
    for play in plays:
        for method in methods:
            of_arms = [shares(robot, seeds, method, play) for robot in robots]
            rows[f"`{method}`, {play}"] = [list(figures) for figures in zip(*of_arms, strict=True)]
            print(f"# {method}, {play}: {np.round(of_arms, 1).tolist()}", file=sys.stderr, flush=True)
    for heads, columns in TABLES:
        print(f"\n| method, motion | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}")
        for label, figures in rows.items():
            cells = [spans(figures[column], " %" if column < len(COLUMNS) else "") for column in columns]
            print(f"| {label} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main(
        seeds=int(sys.argv[1]) if len(sys.argv) > 1 else 10,
        methods=sys.argv[2].split(",") if len(sys.argv) > 2 else METHODS,
        plays=sys.argv[3].split(",") if len(sys.argv) > 3 else ("periodic", "points"),  # type: ignore[arg-type]
    )
