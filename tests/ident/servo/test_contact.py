"""A surface that an arm touches is found at its height, and not where there is none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dynid
from daq.robot.loader import load_robot
from ident.servo.arm_rollout import touched_paths
from ident.servo.contact import ServoContact, find_contact, in_contact, lowest_points, tool_point
from ident.servo.identify import read_motions
from ident.servo.links import servo_links
from ident.servo.motion import known_load, lanes_with_touch, measured_load
from ident.servo.terms import INDEX, start_values

STEP = 1.5e-3


@pytest.fixture(scope="module")
def motions():
    robot = load_robot("so101")
    return read_motions(dynid.simulate_servo(robot, duration=20.0, seed=4), robot)


@pytest.mark.parametrize("raised", [0.02, None])
def test_a_surface_is_found_where_it_is_and_only_then(raised, motions):
    robot = load_robot("so101")
    links, tool = servo_links(robot), tool_point(robot, servo_links(robot))
    values = start_values(6)
    values[:, INDEX["delay"]] = 0.0

    def pieces(surface):
        played = [
            dataclasses.replace(motion, position=np.round(path / STEP) * STEP)
            for motion, (path, _) in zip(motions, touched_paths(motions, links, values, surface), strict=True)
        ]
        return lanes_with_touch(
            played, links, [known_load(measured_load(links, motion, np.zeros(6)), motion) for motion in played], tool[0]
        )

    free = pieces(None)
    if raised is None:
        assert find_contact(free, values, *tool, STEP) is None
        return
    height = float(lowest_points(free, tool[1]).min()) + raised
    true = ServoContact(link=tool[0], point=tool[1].tolist(), height=height, stiffness=1500.0)
    lanes = pieces(true)
    found = find_contact(lanes, values, *tool, STEP)
    assert found.height == pytest.approx(height, abs=3e-3)
    assert 700.0 < found.stiffness < 4000.0
    share = in_contact(lanes, values, found)[np.isfinite(lanes.measured)].mean()
    assert 0.02 < share < 0.7


def test_what_touches_is_the_tool_point_of_the_file_or_the_farthest_frame_of_the_urdf():
    robot = load_robot("so101")
    link, point = tool_point(robot, servo_links(robot))
    assert link == "wrist_roll"
    assert point == pytest.approx([-0.0079, -0.000218, -0.0981274], abs=1e-6)
