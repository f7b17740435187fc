"""What physical consistency costs: held-out errors of the unconstrained and the consistent model, and its CPU time.

*Least* is the smallest eigenvalue of a link's pseudo-inertia relative to its prior's, which the margin holds above
0.001; *p* the p-value of the F-test on the constraint. Friction is `coulomb-viscous`, without presliding.

    python -m studies.models.consistency [DATA]

DATA is the folder of the public recordings (`DYNID_DATA`); the simulated arms need none.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from ident.estimators.feasible.consistent import consistent_parameters
from ident.estimators.feasible.prior import link_priors
from ident.estimators.feasible.pseudo_inertia import pseudo_inertia
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.dynamic_model import build_model
from ident.signals.options import PreprocessChoices
from sim_drivers.synthetic.measurement import random_fourier_motion, simulate_recording

UR10 = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
PANDA = tuple(f"joint_{k}" for k in range(1, 8))
TX40_MOVES = 7.45
"""[s] from which on the TX40 stands still."""


def public(data: Path, name: str) -> tuple[Recording, IdentifyChoices]:
    """One of the public recordings, and the choices that it needs."""
    if name == "tx40":
        text = (Path(__file__).parents[2] / "examples" / "tx40.yaml").read_text(encoding="utf-8")
        robot_file = parse_robot(text, where=name, folder=data)
        choices = IdentifyChoices(preprocess=PreprocessChoices(stop=TX40_MOVES))
        return import_file(data / "tx40_t1.npz", robot_file, ImportChoices()), choices
    joints, file = (UR10, "ur10_unisa1.npz") if name == "ur10" else (PANDA, "panda_gaz1.npz")
    limits = "\n".join(f"  - {{name: {joint}, position: [-6.2832, 6.2832], velocity: 6}}" for joint in joints)
    sensors = "\n".join(f"  - {{joint: {joint}, signal: torque, inertia: false}}" for joint in joints)
    drives = f"drives:\n{sensors}\n" if name == "panda" else ""
    text = f"name: {name}\nmodel: {{urdf: {name}.urdf, mounting: free}}\njoints:\n{limits}\n{drives}"
    robot_file = parse_robot(text, where=name, folder=data)
    return import_file(data / file, robot_file, ImportChoices()), IdentifyChoices()


def simulated(name: str) -> tuple[Recording, IdentifyChoices]:
    """A minute of a built-in arm on a random motion."""
    robot_file: RobotFile = load_robot(name)
    motion = random_fourier_motion(build_model(robot_file), 15.0, seed=1)
    return simulate_recording(robot_file, motion, 60.0, seed=1), IdentifyChoices()


def line(name: str, recording: Recording, choices: IdentifyChoices) -> str:
    """One row of the table."""
    plain = replace(choices, presliding=False, model=ModelChoices(friction="coulomb-viscous"))
    identified = identify([recording], [], plain)
    start = time.process_time()
    consistent_parameters(identified.model, identified.base, identified.estimate, identified.robot_file)
    milliseconds = 1e3 * (time.process_time() - start)
    consistent = identified.consistent
    if consistent is None:
        return f"| {name} | {100 * identified.validation.relative_error:.2f} | none found | | | | |"
    p_value = identified.result.consistent.p_value  # type: ignore[union-attr]
    links = ", ".join(identified.model.link_names[link] for link in consistent.parameters.boundary) or "none"
    return (
        f"| {name} | {100 * identified.validation.relative_error:.2f} | "
        f"{100 * consistent.validation.relative_error:.2f} | {p_value:.2g} | {_least(identified):.2g} | {links} | "
        f"{milliseconds:.0f} |"
    )


def _least(identified: Identification) -> float:
    """The smallest eigenvalue of a link's pseudo-inertia relative to its prior's."""
    model, estimate = identified.model, identified.estimate
    system = estimate.root @ estimate.combinations(identified.base.projection)
    priors = pseudo_inertia(link_priors(model, identified.robot_file, system, estimate.root @ estimate.values).links)
    values = identified.consistent.parameters.values  # type: ignore[union-attr]
    links = pseudo_inertia(values[: 10 * len(model.joints)].reshape(-1, 10))
    return float(np.linalg.eigvals(np.linalg.solve(priors, links)).real.min())


def main() -> None:
    """Print the table."""
    data = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("DYNID_DATA", "../shared/data"))
    print("| arm | unconstrained [%] | consistent [%] | p | least | links at the boundary | CPU [ms] |")
    print("|---|---|---|---|---|---|---|")
    if data.is_dir():
        for name in ("ur10", "panda", "tx40"):
            print(line(f"{name}, public recording", *public(data, name)), flush=True)
    for name in ("ur5e", "panda", "rocr6", "sr400"):
        print(line(f"{name}, simulated", *simulated(name)), flush=True)


if __name__ == "__main__":
    main()
