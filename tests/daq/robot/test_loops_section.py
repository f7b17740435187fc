"""Sections `loops`, `coupling` and `lengths` of a robot file: what is taken, and what is refused in which words."""

from __future__ import annotations

import contextlib
import functools

import numpy as np
import pytest
import yaml
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.robot.loader import load_robot, parse_robot
from daq.robot.loops import coupling_matrix
from drivers.core.errors import RobotFileError

SR400 = load_robot("sr400").text
COUPLED = "    j6: {j6: 1, j5: 1}"
PARALLELOGRAM = "parallelogram: [j2, j3, j7, j8]"
CLOSING = "        - {antecedent: j8, d: d3}\n        - {antecedent: j3, gamma: pi/2, d: -d8}\n"


def replaced(old: str, new: str) -> str:
    assert SR400.count(old) == 1, old
    return SR400.replace(old, new)


REFUSED = {
    "drive of a passive joint": (
        replaced("drives:\n", "drives:\n  - {joint: j3, gain: 1}\n"),
        "",
        "'drives' names joint 'j3', but by 'model.loops' it is passive: it has no motor",
    ),
    "motor of a passive joint": (
        replaced(COUPLED, "    j3: {j5: 1}"),
        "",
        "'model.coupling' names joint 'j3', but it is passive: it has no motor",
    ),
    "motor that a passive joint moves": (replaced(COUPLED, "    j6: {j6: 1, j8: 1}"), "", "'j8', but it is passive"),
    "singular coupling": (
        replaced(COUPLED, "    j6: {j5: 1}"),
        "",
        "'model.coupling' is singular: some motion of the joints moves no motor (rank 5 of 6)",
    ),
    "empty row of the coupling": (replaced(COUPLED, "    j6: {}"), "", "singular"),
    "coupling with an unknown joint": (replaced(COUPLED, "    j6: {j6: 1, j9: 1}"), "", "'joints' has only: j1, j2"),
    "coupling with infinity": (replaced(COUPLED, "    j6: {j6: .inf}"), ": model.coupling.j6.j6", "finite number"),
    "three passive": (
        SR400.replace("  - {name: j7,", "  - {name: jx,").replace("joint: j7, gain", "joint: jx, gain"),
        "",
        "two joints of the parallelogram j2, j3, j7, j8 must be passive",
    ),
    "equation of a joint with a motor": (
        replaced(f"    - {PARALLELOGRAM}\n      closing:", "    - joint: j2\n      equation: {j7: 1}\n      closing:"),
        "",
        "'joints' names 'j2', but by 'model.loops' it is passive",
    ),
    "both kinds": (replaced(PARALLELOGRAM, f"{PARALLELOGRAM}\n      joint: j3"), ": model.loops[0]", "either 'joint'"),
    "equation without terms": (
        replaced(f"    - {PARALLELOGRAM}\n      closing:", "    - joint: j3\n      closing:"),
        ": model.loops[0]",
        "needs its 'equation'",
    ),
    "equation of itself": (
        replaced(f"    - {PARALLELOGRAM}\n      closing:", "    - joint: j3\n      equation: {j3: 1}\n      closing:"),
        ": model.loops[0]",
        "names that joint itself",
    ),
    "three corners": (replaced("j7, j8]", "j7]"), ": model.loops[0].parallelogram[3]", "missing"),
    "a corner twice": (replaced("j7, j8]", "j7, j7]"), ": model.loops[0]", "four different joints"),
    "no closing": (
        SR400.replace(CLOSING, "").replace("closing:  # frames", "#"),
        ": model.loops[0]",
        "needs 'closing'",
    ),
    "offset of a parallelogram": (
        replaced(PARALLELOGRAM, f"{PARALLELOGRAM}\n      offset: 1"),
        ": model.loops[0]",
        "equations are derived",
    ),
    "passive joint without a row": (
        replaced("  loops:  # ", "  loops:\n    - {joint: j9, equation: {j2: 1}}\n    # "),
        "",
        "'model.loops' names joint 'j9', but 'model.mdh' has no such row",
    ),
    "pair of an uncoupled motor": (
        replaced("gain: 94, gain_std: 1,", "gain: 94, pair_inertia: true,"),
        "",
        "'j1' is not in 'model.coupling'",
    ),
    "following without closing": (
        replaced(PARALLELOGRAM, "passive: {j3: 0.5, j8: 1.3}").replace(CLOSING, "").replace("closing:  # frames", "#"),
        ": model.loops[0]",
        "a loop with 'passive' joints needs 'closing'",
    ),
    "nothing follows": (replaced(PARALLELOGRAM, "passive: {}"), ": model.loops[0]", "'passive' names no joint"),
    "a motor follows": (
        replaced(PARALLELOGRAM, "passive: {j2: 0.5, j8: 1.3}"),
        "",
        "'joints' names 'j2', but by 'model.loops' it is passive",
    ),
    "a start of a joint that follows": (
        replaced(PARALLELOGRAM, "passive: {j3: 0.5, j8: 1.3}\n      at: {j3: 1}"),
        "",
        "'at' of a loop names joint 'j3', but that one has no motor",
    ),
    "a start of a parallelogram": (
        replaced(PARALLELOGRAM, f"{PARALLELOGRAM}\n      at: {{j2: 1}}"),
        ": model.loops[0]",
        "'at' and 'opened' are for loops with 'passive' joints",
    ),
    "a joint that nobody opens": (
        replaced(PARALLELOGRAM, "passive: {j3: 0.5, j8: 1.3}\n      opened: welded"),
        ": model.loops[0].opened",
        "spherical",
    ),
    "a start without a number": (
        replaced(PARALLELOGRAM, "passive: {j3: .nan, j8: 1.3}"),
        ": model.loops[0].passive.j3",
        "finite number",
    ),
    "closing on one link": (
        replaced(PARALLELOGRAM, "passive: {j3: 0.5, j8: 1.3}").replace(
            "antecedent: j3, gamma", "antecedent: j8, gamma"
        ),
        ": model.loops[0]",
        "the closing frames lie on one link",
    ),
    "parallelogram on the base": (
        replaced("{antecedent: j8, d: d3}", "{antecedent: base, d: d3}"),
        "",
        "'model.loops' names joint 'base'",
    ),
    "unknown length": (replaced("{antecedent: j8, d: d3}", "{antecedent: j8, d: d7}"), ": model", "'d: d7' refers"),
}


@each(("text", "where", "words"), REFUSED.values())
def test_refused_in_its_own_words(text: str, where: str, words: str) -> None:
    with pytest.raises(RobotFileError) as caught:
        parse_robot(text, where="arm.yaml", folder=None)
    assert words in str(caught.value), str(caught.value)
    assert caught.value.where == f"arm.yaml{where}"
    assert "\n" not in str(caught.value)


def test_joints_with_and_without_a_motor_are_told_apart() -> None:
    robot = load_robot("sr400").robot
    assert robot.joint_names == ("j1", "j2", "j4", "j5", "j6", "j7")
    assert robot.passive_names == ("j3", "j8")
    assert robot.dof == 6
    matrix = coupling_matrix(robot.model.coupling, robot.joint_names)
    np.testing.assert_array_equal(matrix - np.eye(6), np.outer(np.eye(6)[4], np.eye(6)[3]))


def test_lengths_are_put_in_where_frames_refer_to_them() -> None:
    model = load_robot("sr400").robot.model
    assert model.mdh is not None
    assert (model.mdh[3].d, model.mdh[3].r) == (0.14, 0.79)
    closing = model.loops[0].closing
    assert closing is not None
    assert [frame.d for frame in closing] == [0.67, -0.25]


leaves = (
    st.none() | st.booleans() | st.floats() | st.integers() | st.sampled_from(["j2", "j3", "d3", "-d3", "pi/2", ""])
)
anything = st.recursive(
    leaves,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                [
                    "joint",
                    "equation",
                    "parallelogram",
                    "passive",
                    "at",
                    "opened",
                    "closing",
                    "antecedent",
                    "d",
                    "j2",
                    "j3",
                ]
            ),
            inner,
        )
    ),
    max_leaves=8,
)


@functools.cache
def text_with_a_hole(section: str) -> str:
    """What the sections need of the robot file, with HOLE where one of them stands: YAML is slow to read and write."""
    robot = yaml.safe_load(SR400)
    robot["model"][section] = "HOLE"
    return yaml.safe_dump({key: robot[key] for key in ("name", "model", "joints")})


@settings(max_examples=30)
@given(section=st.sampled_from(["loops", "coupling", "lengths"]), content=anything, as_list=st.booleans())
def test_whatever_stands_there_is_taken_or_refused_in_words(section: str, content: object, as_list: bool) -> None:
    text = yaml.safe_dump([content] if as_list else content, default_flow_style=True, width=1e9)
    text = text.removesuffix("...\n").strip()
    with contextlib.suppress(RobotFileError):
        parse_robot(text_with_a_hole(section).replace("HOLE", text), where="arm.yaml", folder=None)
