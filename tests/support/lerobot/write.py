"""Wrote the datasets beside it: v2.1 with lerobot 0.3.3, v3.0 with lerobot 0.4.4 (torch 2.13.0, datasets 4.8.5).

Of `meta/` only `info.json` was kept. Two episodes of 40 and 35 frames of a motion that `state` describes.
Run: python write.py FOLDER
"""

import sys

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # type: ignore[import-not-found]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


def state(time: float) -> np.ndarray:
    """LeRobot's numbers of five joints and the gripper."""
    return np.array([*(30 * np.sin(time + j) + 2 * j for j in range(5)), 50 + 30 * np.sin(time)], dtype=np.float32)


names = [f"{joint}.pos" for joint in JOINTS]
vector = {"dtype": "float32", "shape": (6,), "names": names}
features = {"observation.state": vector, "action": vector}
options = {"fps": 30, "root": sys.argv[1], "robot_type": "so101_follower", "use_videos": False}
dataset = LeRobotDataset.create("dynid/tiny", features=features, **options)
for frames in (range(40), range(40, 75)):
    for frame in frames:
        content = {"observation.state": state(frame / 30 - 0.06), "action": state(frame / 30)}
        try:
            dataset.add_frame({**content, "task": "move"})
        except TypeError:  # 0.3
            dataset.add_frame(content, task="move")
    dataset.save_episode()
if hasattr(dataset, "finalize"):
    dataset.finalize()
