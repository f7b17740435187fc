"""What a simulator feels of a model's torque error (docs/measurements/methods.md). About 20 s.

Each built-in arm is identified from 15 s of simulated data and simulated along another motion; the true parameters are
simulated along the same motion, which shows what noise of the recorded torque and the integration leave of it.
"""

from __future__ import annotations

import numpy as np

import dynid
from ident.identify.revalidate import stored_choices
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.signals.joint_signals import read_joint_signals
from ident.signals.pipeline import prepare
from ident.simulation.tracking import tracking_error

ARMS = ("ur5e", "ur10e", "aubo_i5", "rocr6", "panda", "sr400", "up6")


def main() -> None:
    """Print the table."""
    print("| arm | torque error [%] | motion error, identified [mrad] | of the true parameters [mrad] |")
    print("|---|---|---|---|")
    for name in ARMS:
        run, other = (dynid.simulate(name, duration=15.0, seed=seed) for seed in (1, 2))
        result = dynid.identify(run, validation=other).result
        robot_file = dynid.load_robot(name)
        model = build_model(robot_file)
        base = base_parameters(model)
        true_arm = InverseDynamics(model, base, base.projection @ truth_vector(robot_file))
        prepared = prepare(read_joint_signals(other, robot_file.robot), stored_choices(result))
        truth = tracking_error(true_arm, max(prepared.segments, key=lambda segment: len(segment.time)))
        consistent = result.consistent
        if consistent is None or consistent.simulation is None or consistent.validation is None:
            print(f"| {name} | – | not simulated | – |")
            continue
        found = 1e3 * max(consistent.simulation.position_rmse)
        error = 100.0 * (consistent.validation.relative_error or np.nan)
        print(f"| {name} | {error:.2f} | {found:.2f} | {1e3 * max(truth.position_rmse):.2f} |")


if __name__ == "__main__":
    main()
