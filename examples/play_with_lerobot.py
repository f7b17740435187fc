"""Play a motion of `dynid excite so101 --for servo --csv motion.csv` with LeRobot, and log it to run.csv.

Lead the arm slowly to the first row before. Not tried on an arm.
"""

import csv
import math
import time

from lerobot.robots.so101_follower import SO101Follower, SO101FollowerConfig

LOW, HIGH = -0.174533, 1.74533  # of the jaw [rad], which LeRobot has in percent


def to_lerobot(name, q):
    return 100 * (q - LOW) / (HIGH - LOW) if name == "gripper" else math.degrees(q)


def from_lerobot(name, value):
    return LOW + value * (HIGH - LOW) / 100 if name == "gripper" else math.radians(value)


arm = SO101Follower(SO101FollowerConfig(port="/dev/ttyACM0", use_degrees=True))
arm.connect()
with open("motion.csv", newline="") as file:
    rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
names, begin = [name for name in rows[0] if name != "time"], time.perf_counter()
with open("run.csv", "w", newline="") as file:
    log = csv.writer(file)
    log.writerow(["time", *(f"position_{name}" for name in names), *(f"target_{name}" for name in names)])
    for row in rows:
        time.sleep(max(0.0, begin + row["time"] - time.perf_counter()))
        seen, stamp = arm.get_observation(), time.perf_counter() - begin
        arm.send_action({f"{name}.pos": to_lerobot(name, row[name]) for name in names})
        log.writerow([stamp, *(from_lerobot(n, seen[f"{n}.pos"]) for n in names), *(row[n] for n in names)])
