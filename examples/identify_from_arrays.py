"""From arrays to a validated model, without the command line.

Here the arrays come from a simulated arm; put your own in their place: time (N,) [s], position (N, n) [rad],
torque (N, n) [N·m], in the order of the robot file's joints.
"""

from __future__ import annotations

from daq.recording import JOINTS_STREAM, Channel, Recording, Stream
from daq.robot import load_robot
from ident.identify.identification import Identification, IdentifyChoices
from ident.identify.identify import identify
from ident.model.dynamics import build_model
from sim_drivers.measurement import simulate_recording
from sim_drivers.motion import random_fourier_motion


def main(duration: float = 30.0) -> Identification:
    """Identify a UR5e, print how well the model predicts the last 30 % of the recording."""
    robot_file = load_robot("ur5e")
    motion = random_fourier_motion(build_model(robot_file), period=duration, seed=0)
    simulated = simulate_recording(robot_file, motion, duration, seed=0).streams[JOINTS_STREAM]
    time = simulated.time
    position = simulated.channels["position"].values
    current = simulated.channels["current"].values

    names = robot_file.robot.joint_names
    channels = {
        "position": Channel("position", position, "rad", names),
        "current": Channel("current", current, "A", names),
    }
    recording = Recording(
        robot_text=robot_file.text, streams={JOINTS_STREAM: Stream(JOINTS_STREAM, time, time, channels)}
    )
    found = identify([recording], [], IdentifyChoices(method="wls"))

    print(f"held-out relative error {found.validation.relative_error:.2%}")
    for name, expression, value, std in zip(
        found.base.names, found.base.expressions, found.solution.parameters, found.std, strict=True
    ):
        print(f"{name:6} {value:10.4f} ± {2 * std:.4f}   {expression}")
    return found


if __name__ == "__main__":
    main()
