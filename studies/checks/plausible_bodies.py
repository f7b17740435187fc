"""Are the default bodies plausible, and do they simulate? Public recordings, and random arms with light wrists.

For each arm: held-out error of the unconstrained and the consistent model, mass of the links, mass that the torques
show over the true one and over the payload (below 0.67 and beyond 60 it is named), least inertia that a joint has over
random poses with all others free (the motor's included), how many times 1 ms friction needs to stop it from its
greatest velocity, and the worst joint's error of the simulated motion: with a soft controller, and without one over 1 s
windows as a multiple of constant velocity's. The last column are the checks of bodies that are raised. No check of
bodies may be raised for any of them. About 20 s per arm.

    python -m studies.checks.plausible_bodies [ARMS [DATA]]

ARMS random arms of each kind (motor side, link side with a wrist of a tenth of its mass, the same on the motor side
behind a lift); DATA is the folder of the public recordings (`DYNID_DATA`).
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).parents[2] / "tests" / "support"))

import numpy as np
import yaml
from random_arms import built_arm, recorded

from daq.recording.recording import Recording
from daq.robot.loader import parse_robot
from dynid import simulate
from ident.estimators.feasible.problem import friction_rates
from ident.identify.identification import IdentifyChoices
from ident.identify.identify import identify
from ident.model.base_parameters import random_states
from ident.result.models.model import Model
from studies.checks.random_mistakes import slide
from studies.models.consistency import public

PAYLOADS = {"ur10": 10.0, "panda": 3.0}
"""[kg] of the public recordings' arms, whose robot files are made here; the TX40's is not among them."""

BUILT_IN = ("ur5e", "ur10e", "panda", "aubo_i5")

OF_BODIES = ("implausible-mass", "implausible-link", "implausible-centre", "known-contradicts-data")


def line(name: str, recording: Recording, choices: IdentifyChoices) -> str:
    """One row of the table."""
    found = identify([recording], [], choices)
    result = found.result
    if found.consistent is None or result.consistent is None:
        return f"| {name} | none found | | | | | | | | |"
    model, consistent = Model(result), found.consistent.parameters
    matrices = model.mass_matrix(random_states(found.model, 200)[0].T) + np.diag(model.armature)
    least = np.min(1.0 / np.diagonal(np.linalg.inv(matrices), axis1=1, axis2=2), axis=0)
    rates = friction_rates(found.model, range(len(consistent.values)), consistent.values)
    run = result.delivered.runs[0]
    tracked = "–" if run.simulation is None else f"{1e3 * max(run.simulation.position_rmse):.1f}"
    driven = "–" if run.open_loop is None else f"{max(r for r in run.open_loop.joint_ratio if r is not None):.2f}"
    raised = ", ".join(check.name for check in found.checks if check.name in OF_BODIES) or "none"
    mass = sum(link.mass for link in result.standard_parameters or [])
    payload = found.robot_file.robot.payload or PAYLOADS.get(name.split(",")[0])
    shown = consistent.apparent_mass
    carried = "–" if payload is None or shown is None else f"{shown / payload:.2g}"
    coasting = 1e3 * np.min(np.divide(least, rates, out=np.full_like(least, np.inf), where=rates > 0))
    truth = sum(link.mass for link in found.robot_file.robot.truth.links.values())
    of_true = "–" if not truth or shown is None else f"{shown / truth:.2f}"
    return (
        f"| {name} | {100 * found.validation.relative_error:.2f} / "
        f"{100 * found.consistent.validation.relative_error:.2f} | {mass:.3g} | {of_true} | {carried} | "
        f"{least.min():.2g} | {coasting:.0f} | {tracked} | {driven} | {raised} |"
    )


def main() -> None:
    """Print the table."""
    arms = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    data = Path(sys.argv[2] if len(sys.argv) > 2 else os.environ.get("DYNID_DATA", "../shared/data"))
    print(
        "| arm | error, unconstrained / consistent [%] | mass [kg] | apparent mass over the true one | "
        "over the payload | least inertia [kg·m²] | coasting [ms] | soft "
        "controller [mrad] | open loop over constant velocity | checks of bodies |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    if data.is_dir():
        for name in ("ur10", "panda", "tx40"):
            print(line(f"{name}, public recording", *public(data, name)), flush=True)
    for built_in in BUILT_IN:
        simulated = simulate(built_in, duration=15.0, seed=1, rate=200.0)
        print(line(f"{built_in}, simulated", simulated, IdentifyChoices()), flush=True)
    for seed in range(arms):
        print(line(f"random {seed}", recorded(built_arm(seed), seed), IdentifyChoices()), flush=True)
        arm = built_arm(seed, link_side=True, wrist=0.1)
        print(line(f"random {seed}, link side, light wrist", recorded(arm, seed), IdentifyChoices()), flush=True)
        content = yaml.safe_load(built_arm(seed, wrist=0.1).text)
        slide(content, 0, np.random.default_rng([seed, 8]))
        arm = parse_robot(json.dumps(content), where=f"lift {seed}", folder=None)
        print(line(f"random {seed}, light wrist, behind a lift", recorded(arm, seed), IdentifyChoices()), flush=True)


if __name__ == "__main__":
    main()
