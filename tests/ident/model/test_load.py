"""What a load does to the base parameters."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

from daq.robot.loader import load_robot, parse_robot
from drivers.core.errors import UsageError
from ident.model.base_parameters import base_parameters
from ident.model.dynamic_model import build_model
from ident.model.load import KnownLoad, load_columns, load_effect, moved_origin
from ident.model.parameters import INERTIAL, link_parameters
from ident.model.true_parameters import truth_vector
from sim_drivers.plant.altered_arm import with_load

MASS, COM, INERTIA = 2.8, (0.03, -0.02, 0.08), (0.01, 0.001, 0.0, 0.012, 0.0, 0.009)

length = st.floats(-1.0, 1.0)
vector = st.tuples(length, length, length)


@given(mass=st.floats(0.01, 50.0), com=vector, inertia=st.tuples(*[length] * 6), offset=vector)
def test_moving_the_origin_is_what_the_parallel_axis_theorem_says(mass, com, inertia, offset):
    about_tool = link_parameters(mass, com, inertia)
    about_link = link_parameters(mass, np.add(com, offset).tolist(), inertia)
    assert moved_origin(np.array(offset)) @ about_tool == pytest.approx(about_link, abs=1e-9)


@pytest.mark.parametrize("tool", [(0.0, 0.0, 0.0), (0.1, -0.05, 0.2)])
def test_the_effect_is_the_difference_of_the_base_parameters(tool):
    robot_file = load_robot("ur10e")
    workspace = robot_file.robot.workspace.model_copy(update={"tool": tool})
    robot_file = robot_file.model_copy(update={"robot": robot_file.robot.model_copy(update={"workspace": workspace})})
    base = base_parameters(build_model(robot_file))
    loaded = with_load(robot_file, MASS, COM, INERTIA)
    difference = base.projection @ (truth_vector(loaded) - truth_vector(robot_file))
    known = KnownLoad(MASS, COM, INERTIA)
    effect = load_effect(build_model(robot_file), base, robot_file.robot)
    assert effect @ known.values == pytest.approx(difference, abs=1e-9)


def test_six_axes_tell_all_ten_parameters():
    robot_file = load_robot("ur10e")
    model = build_model(robot_file)
    columns = load_columns(load_effect(model, base_parameters(model), robot_file.robot))
    assert columns.names == tuple(f"{symbol}_L" for symbol in INERTIAL)
    assert columns.no_effect == ()


PLANAR = """
name: planar
model:
  gravity: [0, -9.81, 0]
  mdh:
    - {joint: a, alpha: 0, d: 0, r: 0}
    - {joint: b, antecedent: a, alpha: 0, d: 0.5, r: 0}
joints:
  - {name: a, position: [-3, 3], velocity: 3}
  - {name: b, position: [-3, 3], velocity: 3}
"""


def test_a_planar_arm_tells_what_turns_about_its_axis():
    robot_file = parse_robot(PLANAR, where="planar", folder=None)
    model = build_model(robot_file)
    columns = load_columns(load_effect(model, base_parameters(model), robot_file.robot))
    assert columns.names == ("ZZ_L", "MX_L", "MY_L", "M_L")
    assert set(columns.no_effect) == {"XX_L", "XY_L", "XZ_L", "YY_L", "YZ_L", "MZ_L"}


@pytest.mark.parametrize("robot", ["three_joint", "ur10e"])
def test_combinations_have_the_whole_effect(robot, three_joint):
    robot_file = three_joint if robot == "three_joint" else load_robot(robot)
    model = build_model(robot_file)
    effect = load_effect(model, base_parameters(model), robot_file.robot)
    for without in ((), (9,), (6, 7, 8, 9)):
        columns = load_columns(effect, without)
        rest = np.delete(np.arange(10), without)
        assert columns.effect @ columns.projection[:, rest] == pytest.approx(effect[:, rest], abs=1e-6)
        assert np.linalg.matrix_rank(columns.effect) == len(columns.names)


def test_regrouped_combinations_are_marked(three_joint):
    model = build_model(three_joint)
    columns = load_columns(load_effect(model, base_parameters(model), three_joint.robot))
    for name, expression, row in zip(columns.names, columns.expressions, columns.projection, strict=True):
        assert ("R_L" in name) == (np.count_nonzero(row) > 1) == (" " in expression)


@each(
    ("mass", "com", "inertia", "said"),
    [
        (0.0, None, None, "not possible"),
        (float("nan"), None, None, "not possible"),
        (1.0, (0.0, 0.0), None, "3 finite"),
        (1.0, (0.0, 0.0, float("inf")), None, "3 finite"),
        (1.0, None, INERTIA, "--com"),
        (1.0, COM, (0.1, 0.0, 0.0, 0.01, 0.0, 0.01), "principal moments"),
        (1.0, COM, (-0.1, 0.0, 0.0, 0.01, 0.0, 0.01), "principal moments"),
    ],
)
def test_a_load_that_cannot_be_is_refused(mass, com, inertia, said):
    with pytest.raises(UsageError, match=said):
        KnownLoad(mass, com, inertia)
