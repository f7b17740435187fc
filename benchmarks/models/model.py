"""What a user of an identified model waits for: one torque in a control loop, many in a notebook."""

from __future__ import annotations

import numpy as np

import dynid
from benchmarks.timing import medians

COMPARED = """\
model_torque_single_us, model_torque_100k_us: Model.torque of an identified UR5e, checks of its arrays included, for
  one sample (6,), and per sample of 100 000; model_forward_dynamics_single_us: Model.forward_dynamics for one."""

LOOPS = 300
SAMPLES = 100_000


def run(rounds: int = 7) -> dict[str, float]:
    """Microseconds per sample."""
    model = dynid.identify(dynid.simulate("ur5e", duration=10.0, seed=1, rate=100.0)).model
    generator = np.random.default_rng(0)
    q, dq, ddq = (generator.uniform(-1.0, 1.0, (SAMPLES, model.dof)) for _ in range(3))
    one = q[0], dq[0], ddq[0]

    def repeated() -> None:
        for _ in range(LOOPS):
            model.torque(*one)

    def forward() -> None:
        for _ in range(LOOPS):
            model.forward_dynamics(*one)

    seconds = medians({"single": repeated, "many": lambda: model.torque(q, dq, ddq), "forward": forward}, rounds)
    return {
        "model_torque_single_us": 1e6 * seconds["single"] / LOOPS,
        "model_torque_100k_us": 1e6 * seconds["many"] / SAMPLES,
        "model_forward_dynamics_single_us": 1e6 * seconds["forward"] / LOOPS,
    }
