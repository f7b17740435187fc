"""What an arm keeps clear of: the mounting surface follows from mounting and gravity, and the workspace replaces it."""

from __future__ import annotations

import pytest
from each import each

from daq.robot.loader import parse_robot
from daq.robot.obstacles import obstacles_of
from daq.robot.workspace import DEFAULT_CLEARANCE, HalfSpace
from drivers.core.errors import RobotFileError

ARM = """
name: arm
model:
  mdh: [{{joint: j1, alpha: 0, d: 0, r: 0.3}}]
  {model}
joints: [{{name: j1, position: [-3, 3], velocity: 2}}]
workspace: {workspace}
"""


def obstacles(model="", workspace="{}"):
    return obstacles_of(parse_robot(ARM.format(model=model, workspace=workspace), where="arm.yaml", folder=None).robot)


@each(
    ("model", "name"),
    [
        ("", "the table"),
        ("gravity: [0, 0, 9.81]", "the ceiling"),
        ("gravity: [-5, 0, -8]", "the table"),
        ("mounting: table", "the table"),
        ("{gravity: [9.81, 0, 0], mounting: wall}", "the wall"),
        ("{gravity: [0, 0, 1.6], mounting: ceiling}", "the ceiling"),
    ],
)
def test_the_arm_is_above_its_mounting_surface(model, name):
    lines = model.strip("{}").replace(", mounting", "\n  mounting")
    (surface,) = obstacles(lines)
    assert (surface.name, surface.clearance, surface.mounting) == (name, DEFAULT_CLEARANCE, True)
    assert surface.shape == HalfSpace(normal=(0.0, 0.0, 1.0), offset=0.0)


@each("model", ["mounting: free", "gravity: [9.81, 0, 0]", "gravity: [0, 0, 0]"])
def test_where_the_surface_is_not_known_there_is_none(model):
    assert obstacles(model) == ()
    (floor,) = obstacles(model, "{floor: -0.7, clearance: 0.1}")
    assert (floor.name, floor.clearance) == ("the floor", 0.1)
    assert floor.shape == HalfSpace(normal=(0.0, 0.0, 1.0), offset=-0.7)


@each(
    ("workspace", "names"),
    [
        ("{height: [-0.5, 2]}", []),
        ("{height: [-0.5, 2], floor: 0}", ["the table"]),
        ("{keep_out: [{half_space: {normal: [0, 1, 2], offset: -1}, name: slope}]}", ["slope"]),
        ("{keep_out: [{half_space: {normal: [0, 1, 0], offset: -1}}]}", ["the table", "half-space keep_out[0]"]),
        ("{keep_out: [{box: {lower: [1, 1, 0], upper: [2, 2, 1]}, name: door}]}", ["the table", "door"]),
    ],
)
def test_the_workspace_replaces_what_it_says_itself(workspace, names):
    assert [obstacle.name for obstacle in obstacles(workspace=workspace)] == names


def test_each_obstacle_may_have_its_own_clearance():
    box = "box: {lower: [1, 1, 0], upper: [2, 2, 1]}"
    found = obstacles(workspace=f"{{clearance: 0.04, keep_out: [{{{box}, clearance: 0}}, {{{box}}}]}}")
    assert [obstacle.clearance for obstacle in found] == [0.04, 0.0, 0.04]


@each(
    ("mounting", "gravity"),
    [("table", "[0, 0, 9.81]"), ("ceiling", "[0, 0, -9.81]"), ("wall", "[0, 0, -9.81]"), ("table", "[0, 9.81, 0]")],
)
def test_a_mounting_that_does_not_fit_gravity_is_refused(mounting, gravity):
    with pytest.raises(RobotFileError, match=f"mounting '{mounting}' does not fit gravity") as caught:
        obstacles(f"gravity: {gravity}\n  mounting: {mounting}")
    assert caught.value.where == "arm.yaml: model"


def test_a_mounting_that_there_is_not_is_refused():
    with pytest.raises(RobotFileError, match="mounting"):
        obstacles("mounting: desk")
