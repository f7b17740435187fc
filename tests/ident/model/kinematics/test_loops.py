"""Closed loops and coupled motors: transmission, regressor and its derivatives, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from each import each
from pinocchio_reference import pinocchio_regressor
from regressor_differences import check_gradient

from daq.robot.loader import RobotFile, load_robot, parse_robot
from daq.robot.obstacles import obstacles_of
from drivers.core.errors import RobotFileError
from ident.assessment.excitation import excited_base_columns
from ident.assessment.plausibility import inertia_matrices
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.pinocchio_model import pinocchio_model
from ident.model.kinematics.loops import loop_ends, main_chain, place_tree
from ident.model.kinematics.transmission import LinearTransmission
from ident.model.regressor import model_torque, regressor

FOUR_BAR = """\
name: four_bar
model:
  mdh:
    - {joint: a, alpha: pi/2, d: 0, r: 0.1}
    - {joint: b, antecedent: a, alpha: SIGN, d: 0.5, theta0: 0.3, r: 0.05}
    - {joint: c, alpha: pi/2, d: 0, theta0: -0.4, r: 0.2}
    - {joint: d, antecedent: c, alpha: 0, d: 0.2, r: 0}
  loops:
    - parallelogram: [a, b, c, d]
      closing:
        - {antecedent: d, theta0: 0.7, d: 0.5, r: -0.1}
        - {antecedent: b, gamma: 0.2, alpha: 0, d: 0.2, r: -0.05}
joints:
  - {name: a, position: [-1, 1], velocity: 2}
  - {name: c, position: [1.2, 2], velocity: 2}
"""


def four_bar(*, flipped: bool = False, **replacements: str) -> RobotFile:
    text = FOUR_BAR.replace("SIGN", "pi" if flipped else "0")
    for old, new in replacements.items():
        text = text.replace(old, new)
    return parse_robot(text, where="four_bar.yaml", folder=None)


def random_transmission(model: DynamicModel, seed: int) -> DynamicModel:
    """The tree with two joints made to follow and two motors coupled."""
    generator = np.random.default_rng(seed)
    count = len(model.joints)
    passive = sorted(generator.choice(count, 2, replace=False).tolist())
    active = tuple(number for number in range(count) if number not in passive)
    follow = np.zeros((count, len(active)))
    follow[list(active), range(len(active))] = 1.0
    follow[passive] = generator.integers(-1, 2, (2, len(active)))
    coupling = np.eye(len(active))
    coupling[1, 0], coupling[2, 1] = 1.0, -0.5

    def kept(flags: tuple[bool, ...]) -> tuple[bool, ...]:
        return tuple(flags[number] for number in active)

    transmission = LinearTransmission(
        active=active,
        follow=follow,
        offset=np.where(np.isin(np.arange(count), passive), generator.uniform(-1, 1, count), 0.0),
        coupling=coupling,
        pair_friction=tuple(bool(flag) for flag in np.count_nonzero(coupling, axis=1) > 1),
        pair_inertia=(False, True, *(False,) * (len(active) - 2)),
    )
    return replace(
        model,
        limits=tuple(model.limits[number] for number in active),
        motor_inertia=(True,) * len(active),
        viscous=kept(model.viscous),
        coulomb=kept(model.coulomb),
        offset=kept(model.offset),
        transmission=transmission,
    )


@pytest.mark.parametrize("flipped", [False, True])
def test_a_parallelogram_s_equations_close_it(flipped: bool) -> None:
    robot_file = four_bar(flipped=flipped)
    model = build_model(robot_file)
    ends = loop_ends(robot_file.robot.model.loops[0], {name: i for i, name in enumerate(model.link_names)})
    for position in random_states(model, 30)[0].T:
        frames = place_tree(model.joints, model.tree_position(position))
        one, other = (frames[number][1] + frames[number][0] @ placement[1] for number, placement in ends)
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_placements_are_pinocchio_s(random_tree: Callable[..., DynamicModel]) -> None:
    pin = pytest.importorskip("pinocchio")
    model = random_tree(3, 7)
    arm = pinocchio_model(model)
    data = arm.createData()
    position = np.random.default_rng(0).uniform(-2, 2, 7)
    pin.forwardKinematics(arm, data, position)
    for number, (rotation, translation) in enumerate(place_tree(model.joints, position)):
        np.testing.assert_allclose(rotation, data.oMi[number + 1].rotation, atol=1e-12)
        np.testing.assert_allclose(translation, data.oMi[number + 1].translation, atol=1e-12)


def test_a_loop_that_does_not_close_is_refused_with_its_error() -> None:
    with pytest.raises(RobotFileError, match=r"parallelogram a, b, c, d does not close.* up to 10 mm apart") as caught:
        build_model(four_bar(**{"d: 0.5, r: -0.1": "d: 0.51, r: -0.1"}))
    assert caught.value.where == "four_bar.yaml: model.loops"
    assert caught.value.exit_status == 2


@each(
    ("old", "new", "words"),
    [
        ("antecedent: c, alpha: 0", "antecedent: c, alpha: 0.1", "the axis of d is not parallel"),
        ("antecedent: c, alpha: 0", "antecedent: a, alpha: 0", "must hang on the first"),
        ("{antecedent: b, gamma", "{antecedent: d, gamma", "must have the antecedent b"),
        ("d: 0.2, r: 0}", "d: 0, r: 0}", "the side behind c has no length"),
        ("{joint: d, ", "{joint: d, type: prismatic, ", "must be revolute"),
    ],
)
def test_a_parallelogram_that_is_none_is_refused(old: str, new: str, words: str) -> None:
    with pytest.raises(RobotFileError, match=words):
        build_model(four_bar(**{old: new}))


def test_equations_that_do_not_determine_the_passive_joints_are_refused() -> None:
    loops = "  loops:\n    - {joint: b, equation: {d: 1}}\n    - {joint: d, equation: {b: 1}}\n"
    start, end = FOUR_BAR.index("  loops:"), FOUR_BAR.index("joints:\n")
    text = (FOUR_BAR[:start] + loops + FOUR_BAR[end:]).replace("SIGN", "0")
    with pytest.raises(RobotFileError, match="do not determine the positions of b, d"):
        build_model(parse_robot(text, where="x", folder=None))


def test_equations_and_the_parallelogram_are_the_same_arm() -> None:
    sr400 = load_robot("sr400")
    start, end = sr400.text.index("    - parallelogram"), sr400.text.index("  coupling:")
    equations = (
        "    - {joint: j3, equation: {j2: -1, j7: 1}, offset: pi/2}\n"
        "    - {joint: j8, equation: {j2: 1, j7: -1}, closing: [{antecedent: j8, d: 0.67},"
        " {antecedent: j3, gamma: pi/2, d: -0.25}]}\n"
    )
    written = build_model(
        parse_robot(sr400.text[:start] + equations + sr400.text[end:], where="written", folder=None)
    ).transmission
    derived = build_model(sr400).transmission
    assert isinstance(written, LinearTransmission)
    assert isinstance(derived, LinearTransmission)
    np.testing.assert_array_equal(written.follow, derived.follow)
    np.testing.assert_allclose(written.offset, derived.offset, atol=1e-12)
    wrong = equations.replace("j7: -1}, closing", "j7: -1}, offset: 0.01, closing")
    with pytest.raises(RobotFileError, match="loop of j8 does not close"):
        build_model(parse_robot(sr400.text[:start] + wrong + sr400.text[end:], where="wrong", folder=None))


def test_the_robot_file_of_the_docs_closes() -> None:
    page = (Path(__file__).parents[4] / "docs" / "loops.md").read_text(encoding="utf-8")
    block = page.split("```yaml\n", 1)[1].split("```", 1)[0]
    model = build_model(parse_robot(f"name: docs\n{block}", where="docs", folder=None))
    assert model.joint_names == ("j1", "j2", "j7")
    assert model.link_names[model.tool_link] == "j3"


def test_a_urdf_s_passive_joints_work_too() -> None:
    link = "<link name='l{0}'/>"
    joint = (
        "<joint name='{1}' type='revolute'><origin xyz='{2} 0 0'/><parent link='l{3}'/><child link='l{0}'/>"
        "<axis xyz='0 0 1'/><limit lower='-3' upper='3' effort='1' velocity='1'/></joint>"
    )
    urdf = "<robot name='r'>" + "".join(link.format(i) for i in range(4))
    urdf += joint.format(1, "a", 0, 0) + joint.format(2, "b", 0.5, 1) + joint.format(3, "c", 0.3, 2) + "</robot>"
    text = (
        "name: r\nmodel:\n  urdf: r.urdf\n  loops: [{joint: b, equation: {a: -1, c: 0.5}}]\njoints:\n"
        "  - {name: a, position: [-1, 1], velocity: 1}\n  - {name: c, position: [-1, 1], velocity: 1}\n"
    )
    model = build_model(parse_robot(text, where="r", folder=None, urdf_text=urdf))
    assert model.link_names == ("a", "b", "c")
    assert model.joint_names == ("a", "c")
    np.testing.assert_allclose(model.tree_position(np.array([0.2, 0.6])), [0.2, 0.1, 0.6])


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_those_of_the_tree_taken_to_the_motors(random_tree: Callable[..., DynamicModel], seed: int) -> None:
    tree = random_tree(seed, 7, aligned=seed % 2 == 0)
    model = random_transmission(tree, seed)
    assert isinstance(model.transmission, LinearTransmission)
    motion = random_states(model, 600, seed)
    dense = regressor(model, *motion)
    reference = pinocchio_regressor(model, *motion)
    np.testing.assert_allclose(dense, reference, atol=1e-9 * np.abs(reference).max())
    of_tree = model.tree_motion(*motion)
    inertial = regressor(tree, of_tree.position, of_tree.velocity, of_tree.acceleration)[:, :70]
    at_motors = np.einsum("kn,npN->kpN", model.transmission.tree_to_motor, inertial)
    np.testing.assert_allclose(dense[:, :70], at_motors, atol=1e-9 * np.abs(reference).max())


@each("seed", range(4))
def test_motors_give_the_power_that_the_tree_s_joints_take(random_tree: Callable[..., DynamicModel], seed: int) -> None:
    tree = random_tree(seed, 6)
    model = random_transmission(tree, seed)
    motion = random_states(model, 600, seed)
    parameters = np.random.default_rng(seed).standard_normal(60)
    at_motors = model_torque(model, range(60), parameters, *motion)
    of_tree = model.tree_motion(*motion)
    tree_motion = of_tree.position, of_tree.velocity, of_tree.acceleration
    at_joints = model_torque(tree, range(60), parameters, *tree_motion)
    given = np.einsum("nN,nN->N", at_motors, model.transmission.coupling @ motion[1])
    taken = np.einsum("nN,nN->N", at_joints, tree_motion[1])
    np.testing.assert_allclose(given, taken, atol=1e-9 * np.abs(taken).max())


@each("seed", range(4))
def test_the_gradient_is_that_of_finite_differences(random_tree: Callable[..., DynamicModel], seed: int) -> None:
    model = replace(random_transmission(random_tree(seed, 6), seed), smoothing=0.1)
    motion = np.array(random_states(model, 5, seed))
    check_gradient(model, motion, seed, 3e-6)


def test_the_inertia_matrix_is_the_tree_s_between_the_active_joints() -> None:
    pin = pytest.importorskip("pinocchio")
    from ident.model.true_parameters import truth_vector

    sr400 = load_robot("sr400")
    model, base = build_model(sr400), base_parameters(build_model(sr400))
    assert isinstance(model.transmission, LinearTransmission)
    truth = truth_vector(sr400)
    position = random_states(model, 600)[0]
    matrices = inertia_matrices(model, base, base.projection @ truth, position)
    arm = pinocchio_model(model, truth[:80])
    data = arm.createData()
    coupling, follow = model.transmission.coupling, model.transmission.follow
    motors = np.diag([sr400.robot.truth.joints[name].motor_inertia for name in model.joint_names])
    for sample in range(5):
        tree = pin.crba(arm, data, model.tree_position(position[:, sample]))
        tree = np.triu(tree) + np.triu(tree, 1).T
        expected = follow.T @ tree @ follow + coupling.T @ motors @ coupling
        np.testing.assert_allclose(matrices[sample], expected, atol=1e-9 * np.abs(expected).max())
        assert np.linalg.eigvalsh(matrices[sample])[0] > 0


def test_friction_of_a_coupled_motor_counts_when_any_of_its_joints_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    from types import SimpleNamespace

    model = build_model(load_robot("sr400"))
    base = base_parameters(model)
    velocity = np.zeros((6, 10))
    velocity[3] = 1.0  # joint 5 moves, joint 6 does not
    part = SimpleNamespace(rest_velocity=0.1, segments=[SimpleNamespace(velocity=velocity)])
    monkeypatch.setattr("ident.assessment.excitation.excited_columns", lambda reduction: tuple(range(base.count)))
    found = excited_base_columns(None, base, [part])  # type: ignore[arg-type, list-item]
    rubbing = [base.names[i] for i in found if base.names[i].startswith("F")]
    assert rubbing == ["Fv5", "Fvm6", "Fs5", "Fsm6"]


def test_the_main_chain_of_the_sr400_leaves_the_rods_out() -> None:
    model = build_model(load_robot("sr400"))
    assert main_chain(model.joints, model.active) == (0, 1, 2, 3, 4, 5)


def test_an_excitation_s_constraints_know_the_passive_joints() -> None:
    """Values on the arm as it closes, derivatives by the joints with a motor."""
    from ident.excite.constraints.collision_geometry import arm_geometry
    from ident.excite.constraints.self_collision import SelfCollision, link_pairs
    from ident.excite.constraints.workspace import WorkspaceLimits
    from ident.excite.path import JointPath

    limits = "workspace: {tool: [0, 0, 0.1], radius: [0.2, 1.5], height: [-0.3, 1.6]}"
    text = load_robot("sr400").text.replace("workspace: {floor: -0.5}", limits)
    robot_file = parse_robot(text, where="sr400", folder=None)
    model = build_model(robot_file)
    assert model.link_names[model.tool_link] == "j6"
    geometry = arm_geometry(robot_file, model)
    pairs = link_pairs(model, geometry, robot_file.robot.workspace.ignore_pairs)
    motion = random_states(model, 3)
    for constraint in (
        WorkspaceLimits(model, geometry, robot_file.robot.workspace, obstacles_of(robot_file.robot)),
        SelfCollision(model, geometry, pairs),
    ):
        _, gradient = constraint.smooth_use(JointPath(np.arange(3.0), *motion), 20.0)
        assert len(gradient)
        for joint in range(model.dof):
            for sample in range(3):
                moved = []
                for step in (1e-6, -1e-6):
                    position = motion[0].copy()
                    position[joint, sample] += step
                    moved.append(constraint.smooth_use(JointPath(np.arange(3.0), position, *motion[1:]), 20.0)[0])
                difference = (moved[0] - moved[1]) / 2e-6
                np.testing.assert_allclose(gradient[:, 0, joint, sample], difference, atol=2e-5)
