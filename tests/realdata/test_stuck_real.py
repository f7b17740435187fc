"""Real arms are told nothing of: no channel of the public recordings hangs, however coarse and sticky it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.session.stuck_channels import JointSpeed, StuckChannel
from daq.session.supervisor import stale_after

pytestmark = pytest.mark.realdata
LAG = 3
"""Samples by which an arm without recorded commands follows them."""


@pytest.mark.parametrize(
    "name", ["tx40_t1", "ur10_unisa1", "panda_gaz1", "so101/single_joint_elbow", "so101/chirp_sweep", "so101/multisine"]
)
def test_no_channel_of_a_real_recording_hangs(data_dir: Path, name: str) -> None:
    file = np.load(data_dir / f"{name}.npz")
    if "command" in file:
        time, position = file["time"], file["position"]
        sent = np.searchsorted(file["command_time"], time, side="right") - 1
        command = file["command"][np.clip(sent, 0, None)]
        values = {"position": position, "velocity": file["velocity"], "current": file["current_magnitude"]}
    else:
        time, position = file["t"][:-LAG], file["q"][:-LAG]
        command, values = file["q"][LAG:], {"position": position, "torque": file["torque"][:-LAG]}
    rate = 1.0 / float(np.median(np.diff(time)))
    together = max(1, round(0.01 * rate))
    joints = JointSpeed(position.shape[1])
    channels = {quantity: StuckChannel(quantity, position.shape[1], stale_after(rate)) for quantity in values}
    for last in range(together - 1, len(time), together):
        rows = slice(last + 1 - together, last + 1)
        joints.add(time[last], position[last])
        for quantity, channel in channels.items():
            way = command[last] if quantity == "position" else position[last]
            hung = channel.add(time[last], values[quantity][rows], way, joints.speed)
            assert not len(hung), (quantity, hung, time[last])
