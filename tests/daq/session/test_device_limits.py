"""Limits of the robot file that are looser than the controller's own are named, and no others."""

from __future__ import annotations

import numpy as np
from kinematic_arm import ROBOT_FILE

from daq.session.device_limits import before_a_motion, looser_limits
from daq.session.sources import Sources
from drivers.base import DeviceLimits

ROBOT = ROBOT_FILE.robot
NAN = np.full(2, np.nan)
SOURCES = {"position": "0x607D", "velocity": "0x607F", "torque": "0x6072", "stopping": "0x6085", "acceleration": "here"}
SOURCES["following_error"] = "0x6065"


def own(**changed: list[float]) -> DeviceLimits:
    arrays = {name: np.array(values) for name, values in changed.items()}
    return DeviceLimits(**({"lowest": NAN, "highest": NAN, "velocity": NAN, "torque": NAN} | arrays), sources=SOURCES)


def test_what_is_unknown_equal_or_stricter_is_not_named() -> None:
    joints = ROBOT.joints
    lowest, highest = np.array([joint.position for joint in joints]).T.tolist()
    assert looser_limits(ROBOT, own()) == []
    velocity, acceleration = ([getattr(joint, name) for joint in joints] for name in ("velocity", "acceleration"))
    same = own(lowest=lowest, highest=highest, velocity=velocity, acceleration=acceleration, stopping=acceleration)
    assert looser_limits(ROBOT, same) == []


def test_looser_limits_are_named_by_quantity_joint_and_object() -> None:
    said = looser_limits(ROBOT, own(lowest=[-9, -1], highest=[9, 9], velocity=[9, 1.5], torque=[20, np.nan]))
    assert said == [
        "position limits wider than the controller's own (0x607D): elbow -2 to 2 rad, own -1 to 9",
        "velocity limits above the controller's own (0x607F): elbow 2 rad/s, own 1.5",
        "torque limits above the controller's own (0x6072): shoulder 50 N·m, own 20",
    ]
    (line,) = looser_limits(ROBOT, own(following_error=[0.05, 0.3]))
    assert line == "following error limits above the controller's own (0x6065): shoulder 0.2 rad, own 0.05"
    (line,) = looser_limits(ROBOT, own(stopping=[0.5, 100]))
    assert line.startswith("a stop decelerates less than the acceleration limits allow (0x6085): shoulder ")


class Arm:
    def device_limits(self) -> DeviceLimits:
        return own(velocity=[1.0, 9.0])

    def cautions(self) -> list[str]:
        return ["it is old"]


def test_limits_and_cautions_are_those_of_the_arm_alone() -> None:
    arm = Arm()
    (limit, caution) = before_a_motion(ROBOT, Sources("arm", arm, {"beside": Arm()}))  # type: ignore[arg-type, dict-item]
    assert limit.startswith("velocity limits above")
    assert caution == "it is old"
    assert before_a_motion(ROBOT, object()) == []  # type: ignore[arg-type]
