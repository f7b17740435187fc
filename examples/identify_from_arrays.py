"""From arrays to a model that a controller can use.

Put your own arrays in place of the simulated ones: time (N,) [s], position (N, n) [rad] and current (N, n) [A] or
torque (N, n) [N·m], columns in the order of the robot file's joints.
"""

from __future__ import annotations

import sys

import dynid


def main(duration: float = 30.0, folder: str = "ur5e-model") -> dynid.Model:
    """Identify a UR5e, validate it on another motion, save the model and use it."""
    learnt, other = (dynid.simulate("ur5e", duration=duration, seed=seed) for seed in (0, 1))
    joints = learnt.streams["joints"]
    time, position, current = joints.time, joints.channels["position"].values, joints.channels["current"].values

    run = dynid.Recording.from_arrays("ur5e", time=time, position=position, current=current)
    result = dynid.identify(run, validation=other)
    print(result)
    result.save(folder)

    model = dynid.load_model(folder)
    print(model.torque(q=[0.1] * 6, dq=[0.2] * 6, ddq=[0.5] * 6), "N·m")
    return model


if __name__ == "__main__":
    main(folder=sys.argv[1] if len(sys.argv) > 1 else "ur5e-model")
