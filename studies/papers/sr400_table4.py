"""Table 4 of the SR400 paper, from a simulated SR400, free and loaded.

    python -m studies.papers.sr400_table4 [seed [moves]]

Quintic point-to-point motions through random points, every joint moving, 1 kHz, encoder steps and current noise of the
built-in robot file. The truth is Table 4's X̂ where it prints a value; the rest was chosen (see the file's sources). The
simulated drives' gains are drawn around Table 2's by its uncertainties; the identification knows Table 2 only. The load
is Table 3's. About half a minute. Printed:

1. The gains drawn.
2. A row for each parameter that the paper prints: truth; X̂ of the free arm with its 95 % interval, the gains'
   uncertainty included; Z_L = X̂ + load by the regrouping; X̂_L of the loaded arm likewise; X̂_L − Z_L in standard
   deviations of both; the paper's own X̂, Z_L and X̂_L. "(pruned)" marks what is not in the essential model.
3. The essential parameters' number, the errors on the data and on another motion (cross-validation), and how many
   intervals hold.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from drivers.core.arrays import FloatArray
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.model.parameters import INERTIAL, link_parameters
from ident.model.true_parameters import truth_vector
from ident.regression.hypothesis_tests import WITHIN_95_PERCENT
from ident.regression.systematic_errors import gain_sensitivity, relative_gain_std
from sim_drivers.plant.altered_arm import with_load
from sim_drivers.synthetic.measurement import simulate_recording
from studies.synthetic.altered_arms import with_gains
from studies.synthetic.random_points import random_points_motion

LOAD = np.array([0.454, -0.02, -0.09, 0.445, -0.115, 0.065, 0.48, 0.6, 2.0, 10.9])
"""Table 3, in the frame of link 6: XX XY XZ YY YZ ZZ [kg·m²], MX MY MZ [kg·m], M [kg]."""

PAPER = {
    "ZZR1": (50, 54, 57), "XXR2": (-22, -26, -26), "ZZR2": (42, 47, 47), "MXR2": (37, 44.3, 44.3),
    "XXR3": (5, 12, 10), "XYR3": (-2.6, -4.4, -4.4), "ZZR3": (30, 37, 37), "MXR3": (7.5, 9, 9), "MYR3": (12, 20.6, 20),
    "Ia4": (0.3, None, 0.3), "XXR5": (0, 0.44, 0.42), "ZZR5": (0, 0.44, 0.42), "MYR5": (0.04, 2, 2),
    "Ia5": (0.27, None, 0.27), "XZ6": (0, -0.09, -0.07), "YZ6": (0, -0.11, -0.15), "ZZ6": (0, 0.06, 0.08),
    "MX6": (0, 0.47, 0.47), "MY6": (0, 0.6, 0.6), "Ia6": (0.27, None, 0.27), "Fv1": (8, None, 10),
    "Fs1": (30, None, 30), "Fv2": (55, None, 57), "Fs2": (38, None, 36), "Fs4": (2, None, 3), "Fv5": (0.11, None, None),
    "Fs5": (1.3, None, None), "Fv6": (0.034, None, None), "Fs6": (-0.4, None, None), "Fvm6": (0.14, None, None),
    "Fsm6": (0.92, None, None),
}  # fmt: skip
"""Table 4 as printed: X̂, Z_L, X̂_L."""


@dataclass(frozen=True)
class Table:
    """The experiment's outcome; arrays (b,) in the order of the base parameters.

    Attributes:
        free, loaded: identifications of the arm without and with the load.
        truth, loaded_truth: true base parameters.
        predicted: Z_L.
        std, loaded_std: standard deviations with the gains' share.
        apart: X̂_L − Z_L over the standard deviation of this difference, the gains' share included.
    """

    free: Identification
    loaded: Identification
    truth: FloatArray
    loaded_truth: FloatArray
    predicted: FloatArray
    std: FloatArray
    loaded_std: FloatArray
    apart: FloatArray


def recorded(robot_file: RobotFile, seed: int, moves: int) -> Recording:
    played = random_points_motion(robot_file.robot, seed, moves)
    return simulate_recording(robot_file, played, played.duration, seed)


def identified(robot_file: RobotFile, seed: int, moves: int) -> Identification:
    run, held_out = recorded(robot_file, seed, moves), recorded(robot_file, seed + 1, moves // 2)
    return identify(
        [run],
        [held_out],
        IdentifyChoices(method="wls", model=ModelChoices(friction="coulomb-viscous"), reversals=0.0, presliding=False),
    )


def drawn_gains(robot_file: RobotFile, seed: int) -> dict[str, float]:
    """True gain over the file's of every joint, drawn by the file's standard deviations."""
    names = robot_file.robot.joint_names
    relative = relative_gain_std(robot_file.robot, names)
    factors = 1.0 + relative * np.random.default_rng([seed, 4]).standard_normal(len(names))
    return dict(zip(names, factors.tolist(), strict=True))


def with_paper_load(arm: RobotFile) -> RobotFile:
    """The arm with Table 3's load."""
    mass, com = LOAD[9], LOAD[6:9] / LOAD[9]
    return with_load(arm, mass, com, (LOAD[:6] - link_parameters(mass, com, [0.0] * 6)[:6]).tolist())


def experiment(seed: int, moves: int, gains: dict[str, float]) -> Table:
    """Free and loaded arm identified, and the loaded one predicted from the free one."""
    robot_file = load_robot("sr400")
    free_arm = with_gains(robot_file, gains)
    loaded_arm = with_paper_load(free_arm)
    free, loaded = identified(free_arm, seed, moves), identified(loaded_arm, seed + 10, moves)
    base = free.base
    names = [parameter.name for parameter in build_model(free_arm).parameters]
    load = base.projection[:, [names.index(f"{symbol}6") for symbol in INERTIAL]] @ LOAD
    predicted = free.solution.parameters + load
    relative = relative_gain_std(robot_file.robot, robot_file.robot.joint_names)
    # Wrong gains move X̂ and X̂_L alike but for the load's share.
    moved = [relative * gain_sensitivity(fit.reduction, fit.solution) for fit in (free, loaded)]
    std, loaded_std = (
        np.hypot(fit.std, np.linalg.norm(table, axis=1)) for fit, table in zip((free, loaded), moved, strict=True)
    )
    noise = np.hypot(free.std, loaded.std)
    difference = np.hypot(noise, np.linalg.norm(moved[1] - moved[0], axis=1))
    return Table(
        free=free,
        loaded=loaded,
        truth=base.projection @ truth_vector(free_arm),
        loaded_truth=base.projection @ truth_vector(loaded_arm),
        predicted=predicted,
        std=std,
        loaded_std=loaded_std,
        apart=(loaded.solution.parameters - predicted) / difference,
    )


def print_table(table: Table) -> None:
    """Parts 2 and 3."""
    free, loaded = table.free, table.loaded
    print("| | truth | X̂ ± 95 % | Z_L | X̂_L ± 95 % | difference | paper: X̂ | Z_L | X̂_L |")
    print("|---" * 9 + "|")
    for i, name in enumerate(free.base.names):
        if name not in PAPER:
            continue
        values = [f"{table.truth[i]:.3f}"]
        for fit, std, column in ((free, table.std, None), (loaded, table.loaded_std, table.predicted)):
            values += [] if column is None else [f"{column[i]:.3f}"]
            pruned = "" if i in fit.pruned.solution.active else " (pruned)"
            values.append(f"{fit.solution.parameters[i]:.3f} ± {WITHIN_95_PERCENT * std[i]:.3f}{pruned}")
        values.append(f"{table.apart[i]:.2f}")
        values += ["" if value is None else f"{value:g}" for value in PAPER[name]]
        print(f"| {name} | {' | '.join(values)} |".replace(" -", " −"))
    print()
    for label, fit in (("free", free), ("loaded", loaded)):
        assert fit.validation is not None
        assert fit.essential.validation is not None
        print(
            f"{label}: {len(fit.pruned.solution.active)} of {fit.base.count} parameters essential; relative error "
            f"{100 * fit.fit.relative_error:.2f} %, on another motion {100 * fit.validation.relative_error:.2f} %, "
            f"essential model {100 * fit.essential.validation.relative_error:.2f} %"
        )
    for label, fit, truth, std in (
        ("free", free, table.truth, table.std), ("loaded", loaded, table.loaded_truth, table.loaded_std),
    ):  # fmt: skip
        error = np.abs(fit.solution.parameters - truth)
        held, by_noise = (np.sum(error < WITHIN_95_PERCENT * deviations) for deviations in (std, fit.std))
        print(
            f"{label}: 95 % intervals hold the truth in {held} of {len(truth)} parameters ({by_noise} by noise alone)"
        )
    near = np.sum(np.abs(table.apart) < WITHIN_95_PERCENT)
    print(
        f"Z_L and X_L: {near} of {len(table.apart)} within {WITHIN_95_PERCENT:g} standard deviations of each other, at "
        f"most {np.abs(table.apart).max():.1f} apart"
    )


def main(seed: int = 1, moves: int = 40) -> Table:
    """Print everything."""
    robot = load_robot("sr400").robot
    gains = drawn_gains(load_robot("sr400"), seed)
    print("true over presumed gains: " + ", ".join(f"{name} {gains[name]:.4f}" for name in robot.joint_names))
    table = experiment(seed, moves, gains)
    print_table(table)
    return table


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
