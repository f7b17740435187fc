"""The section `workspace` of a robot file: what it means, and what is refused in which words."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
import yaml
from each import each
from hypothesis import given
from hypothesis import strategies as st

from daq.robot.loader import parse_robot
from daq.robot.workspace import DEFAULT_LINK_RADIUS
from drivers.core.errors import RobotFileError

ARM = """
name: arm
model: {mdh: [{joint: j1, alpha: 0, d: 0, r: 0.3}, {joint: j2, antecedent: j1, alpha: pi/2, d: 0.1, r: 0}]}
joints: [{name: j1, position: [-3, 3], velocity: 2}, {name: j2, position: [-3, 3], velocity: 2}]
"""


def workspace_of(section):
    return parse_robot(ARM + f"workspace: {section}\n", where="arm.yaml", folder=None).robot.workspace


def test_everything_is_read():
    workspace = workspace_of(
        "{tool: [0, 0, 0.1], radius: [0.1, 1.2], height: [-0.1, 1.5], link_radius: {j1: 0.08}, "
        "ignore_pairs: [[j1, base]], keep_out: [{half_space: {normal: [0, 0, 2], offset: -0.1}}, "
        "{box: {lower: [0, 0, 0], upper: [1, 1, 1]}}]}"
    )
    assert workspace.tool == (0.0, 0.0, 0.1)
    assert workspace.radius == (0.1, 1.2)
    assert workspace.height == (-0.1, 1.5)
    assert (workspace.radius_of("j1"), workspace.radius_of("j2")) == (0.08, DEFAULT_LINK_RADIUS)
    assert workspace.ignore_pairs == (("j1", "base"),)
    half_space, box = workspace.keep_out
    assert half_space.half_space is not None
    assert half_space.half_space.offset == -0.1
    assert box.box is not None
    assert box.box.upper == (1.0, 1.0, 1.0)


def test_nothing_is_asked_where_the_section_is_missing():
    workspace = parse_robot(ARM, where="arm.yaml", folder=None).robot.workspace
    assert workspace.tool == (0.0, 0.0, 0.0)
    assert workspace.radius is workspace.height is None
    assert workspace.keep_out == workspace.ignore_pairs == ()
    assert workspace.radius_of("base") == DEFAULT_LINK_RADIUS


def test_one_radius_is_that_of_all_links():
    workspace = workspace_of("{link_radius: 0.06}")
    assert {workspace.radius_of(name) for name in ("base", "j1", "j2")} == {0.06}


def test_the_example_of_the_documentation_is_valid():
    page = (Path(__file__).parents[3] / "docs" / "robot-file.md").read_text(encoding="utf-8")
    example = page.split("## Workspace")[1].split("```yaml\n")[1].split("```")[0]
    workspace = parse_robot(ARM + example, where="arm.yaml", folder=None).robot.workspace
    assert len(workspace.model_fields_set) == len(type(workspace).model_fields)


HALF_SPACE, BOX = "{normal: [0, 0, 1], offset: 0}", "{lower: [0, 0, 0], upper: [1, 1, 1]}"

# section, where (behind the file's name), words of the message
REFUSED: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "no mapping": ("7", "workspace", ("found 7",)),
    "unknown key": ("{radious: [0, 1]}", "workspace.radious", ("unknown key", "did you mean 'radius'?")),
    "negative clearance": ("{clearance: -0.1}", "workspace.clearance", ("found -0.1", "greater than or equal to 0")),
    "floor in millimetres": ("{floor: -800}", "workspace", ("lengths are in m",)),
    "two of one name": (
        f"{{keep_out: [{{name: a, box: {BOX}}}, {{name: a, half_space: {HALF_SPACE}}}]}}",
        "workspace",
        ("'keep_out' names two obstacles 'a'",),
    ),
    "radius upside down": ("{radius: [1.2, 0.1]}", "workspace", ("radius [1.2, 0.1] is not in ascending order",)),
    "radius of one number": ("{radius: 1.2}", "workspace.radius", ("found 1.2",)),
    "negative radius": ("{radius: [-0.1, 1]}", "workspace.radius[0]", ("found -0.1", "greater than or equal to 0")),
    "radius not a number": ("{radius: [.nan, 1]}", "workspace.radius[0]", ("found nan",)),
    "infinite radius": ("{radius: [0, .inf]}", "workspace.radius[1]", ("found inf", "finite")),
    "radius in millimetres": ("{radius: [100, 1200]}", "workspace", ("goes beyond 100 m; lengths are in m",)),
    "height equal": ("{height: [0.5, 0.5]}", "workspace", ("height [0.5, 0.5] is not in ascending order",)),
    "height not a number": ("{height: [0, high]}", "workspace.height[1]", ("found 'high'",)),
    "height of three": ("{height: [0, 1, 2]}", "workspace.height", ("found [0, 1, 2]",)),
    "tool of two": ("{tool: [0, 1]}", "workspace.tool[2]", ("this entry of the list is missing",)),
    "tool in millimetres": ("{tool: [0, 0, 150]}", "workspace", ("tool [0.0, 0.0, 150.0] goes beyond 100 m",)),
    "truth value in the tool": ("{tool: [0, 0, yes]}", "workspace.tool[2]", ("found true",)),
    "keep_out not a list": ("{keep_out: {}}", "workspace.keep_out", ("found {}",)),
    "keep_out empty": ("{keep_out: [{}]}", "workspace.keep_out[0]", ("exactly one of 'half_space' and 'box'",)),
    "keep_out of both": (
        f"{{keep_out: [{{half_space: {HALF_SPACE}, box: {BOX}}}]}}",
        "workspace.keep_out[0]",
        ("exactly one of 'half_space' and 'box'",),
    ),
    "unknown kind": ("{keep_out: [{sphere: 1}]}", "workspace.keep_out[0].sphere", ("unknown key", "half_space, box")),
    "no direction": (
        "{keep_out: [{half_space: {normal: [0, 0, 0], offset: 0}}]}",
        "workspace.keep_out[0].half_space",
        ("has no direction",),
    ),
    "no offset": (
        "{keep_out: [{half_space: {normal: [0, 0, 1]}}]}",
        "workspace.keep_out[0].half_space.offset",
        ("this key is missing",),
    ),
    "offset in millimetres": (
        "{keep_out: [{half_space: {normal: [0, 0, 1], offset: -500}}]}",
        "workspace.keep_out[0].half_space",
        ("lengths are in m",),
    ),
    "box upside down": (
        "{keep_out: [{box: {lower: [0, 1, 0], upper: [1, 0, 1]}}]}",
        "workspace.keep_out[0].box",
        ("y: lower 1 is not below upper 0",),
    ),
    "box not a number": (
        "{keep_out: [{box: {lower: [0, .nan, 0], upper: [1, 1, 1]}}]}",
        "workspace.keep_out[0].box.lower[1]",
        ("found nan",),
    ),
    "link radius zero": ("{link_radius: 0}", "workspace.link_radius", ("the radius is 0", "above 0")),
    "link radius text": ("{link_radius: thick}", "workspace.link_radius", ("the radius is 'thick'",)),
    "link radius true": ("{link_radius: yes}", "workspace.link_radius", ("the radius is True",)),
    "link radius in millimetres": ("{link_radius: 60}", "workspace.link_radius", ("at most 1 [m]",)),
    "link radius of a joint": (
        "{link_radius: {j1: -0.1}}",
        "workspace.link_radius",
        ("the radius of joint 'j1' is -0.1", "above 0"),
    ),
    "link radius nan": ("{link_radius: {j1: .nan}}", "workspace.link_radius", ("the radius of joint 'j1' is nan",)),
    "link radius of a number": ("{link_radius: {1: 0.1}}", "workspace.link_radius", ("found the key 1",)),
    "link radius of nobody": (
        "{link_radius: {j3: 0.1}}",
        "",
        ("'workspace.link_radius' names 'j3', but there are only: base, j1, j2",),
    ),
    "pair of nobody": ("{ignore_pairs: [[j1, j9]]}", "", ("'workspace.ignore_pairs' names 'j9'",)),
    "pair of one": ("{ignore_pairs: [[j1]]}", "workspace.ignore_pairs[0][1]", ("entry of the list is missing",)),
    "pair of itself": ("{ignore_pairs: [[j1, j1]]}", "workspace", ("pairs 'j1' with itself",)),
}


@each("case", REFUSED)
def test_wrong_values_are_refused_in_one_line(case):
    section, where, words = REFUSED[case]
    with pytest.raises(RobotFileError) as caught:
        workspace_of(section)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)
    assert caught.value.where == ("arm.yaml: " + where if where else "arm.yaml")
    for word in words:
        assert word in str(caught.value)


junk = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
KEYS = ("tool", "radius", "height", "keep_out", "link_radius", "ignore_pairs")


@given(st.dictionaries(st.sampled_from(KEYS), junk, max_size=3))
def test_whatever_stands_there_is_read_or_refused(section):
    content = yaml.safe_load(ARM) | {"workspace": section}
    # Anything but a robot or a RobotFileError would pass through.
    with contextlib.suppress(RobotFileError):
        workspace = parse_robot(yaml.safe_dump(content), where="arm.yaml", folder=None).robot.workspace
        assert 0 < workspace.radius_of("j1") <= 1
