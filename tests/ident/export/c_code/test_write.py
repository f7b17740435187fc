"""The C code compiles without a warning and computes what the model does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compiled_arm import CompiledArm, compile_c, self_test
from friction_arm import arm_file
from loop_arms import four_bar_arm

from daq.robot.loader import load_robot
from drivers.core.errors import ModelError, UsageError
from ident.export.c_code.functions import left_out
from ident.export.c_code.names import identifier
from ident.export.c_code.reference import reference
from ident.export.c_code.write import write_c
from ident.model.base_parameters import base_parameters, random_states
from ident.model.dynamic_model import DynamicModel, build_model
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.joint_columns import combined
from ident.model.presliding import dry_friction, presliding_motions
from ident.model.true_parameters import true_model, truth_vector

pytestmark = pytest.mark.realtime

SHAPES = {"mass_matrix": "M", "regressor": "Y"}


def dynamics_of(model: DynamicModel) -> InverseDynamics:
    base = base_parameters(model)
    return InverseDynamics(model, base, np.random.default_rng(0).normal(size=base.count))


def true_dynamics(name: str) -> InverseDynamics:
    model, truth = build_model(load_robot(name)), truth_vector(load_robot(name))
    base = base_parameters(model)
    return InverseDynamics(model, base, base.projection @ truth, truth)


@pytest.fixture(scope="module")
def ur5e() -> InverseDynamics:
    return dynamics_of(build_model(load_robot("ur5e")))


def compared(dynamics: InverseDynamics, arm: CompiledArm, real: str, count: int) -> float:
    """Largest deviation of all functions, each relative to its largest value."""
    expected = reference(dynamics, "float" if real == "float" else "double", count=count, seed=7)
    inputs, joints = expected.inputs, dynamics.model.dof
    calls = {
        "torque": (("q", "dq", "ddq"), (joints,)),
        "gravity": (("q",), (joints,)),
        "coriolis": (("q", "dq"), (joints,)),
        "friction": (("dq",), (joints,)),
        "payload_torque": (("q", "dq", "ddq", "payload"), (joints,)),
        "mass_matrix": (("q",), (joints, joints)),
        "regressor": (("q", "dq", "ddq"), (joints, dynamics.base.count)),
    }
    if not np.array_equal(dynamics.coupling, np.eye(joints)):
        calls["motor_torque"] = (("tau",), (joints,))
    if "forward_dynamics" not in left_out(dynamics):
        calls["forward_dynamics"] = (("q", "dq", "tau"), (joints,))
    worst = 0.0
    for name, (arrays, shape) in calls.items():
        given = arm(name, [inputs[array] for array in arrays], shape)
        worst = max(worst, float(np.abs(given - expected.outputs[name]).max()) / expected.scales[name])
    return worst


@pytest.mark.parametrize("name", ["ur5e", "sr400"])
def test_compiled_functions_equal_the_model(name, tmp_path):
    dynamics = true_dynamics(name)
    source = write_c(dynamics, tmp_path / "arm").path
    assert compared(dynamics, CompiledArm(source, name), "double", 1000) < 1e-12
    done = self_test(source, name)
    assert done.returncode == 0, done.stdout
    tested = {line.split()[0] for line in done.stdout.splitlines()[:-1]}
    assert tested >= {"torque", "coriolis", "gravity", "friction", "mass_matrix", "forward_dynamics", "payload_torque"}


def test_forward_dynamics_is_not_a_number_where_no_inertia_is_positive(tmp_path):
    """The code is asked beyond what an export checked: a pivot that is not positive."""
    source = write_c(true_dynamics("up6"), tmp_path / "arm").path
    text = source.read_text()
    changed = tmp_path / "changed.c"
    changed.write_text(text.replace("return x > 0 ? 1.0 / x", "return x > 1e9 ? 1.0 / x"))
    accelerations = CompiledArm(changed, "up6")("forward_dynamics", [np.zeros((1, 6))] * 3, (6,))
    assert np.isnan(accelerations).any()


def test_single_precision(ur5e, tmp_path):
    source = write_c(ur5e, tmp_path / "arm", real="float").path
    assert compared(ur5e, CompiledArm(source, "ur5e", np.float32), "float", 200) < 1e-5
    assert " sin(" not in source.read_text()


@pytest.mark.parametrize("real", ["double", "float"])
def test_self_test_passes(real, tmp_path):
    dynamics = dynamics_of(build_model(load_robot("up6")))
    source = write_c(dynamics, tmp_path / "arm", real=real).path
    done = self_test(source, "up6")
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "up6: passed")


def test_self_test_fails_where_the_code_is_wrong(tmp_path):
    source = write_c(dynamics_of(build_model(load_robot("up6"))), tmp_path / "arm").path
    text = source.read_text()
    assert text.count("sin(q1)") > 1
    for name, old, new in (
        ("sign", "(x > 0) - (x < 0)", "(x > 0)"),
        ("angle", "sin(q1)", "sin(1.000000001 * q1)"),
        ("nan", "cos(q2)", "sqrt(-1.0 - q2 * q2)"),
    ):
        changed = tmp_path / f"{name}.c"
        changed.write_text(text.replace(old, new))
        done = self_test(changed, "up6")
        assert (done.returncode, done.stdout.splitlines()[-1]) == (1, "up6: FAILED"), name


def test_output_may_lie_over_an_input(ur5e, tmp_path):
    source = write_c(ur5e, tmp_path / "arm").path
    arm, state = CompiledArm(source, "ur5e"), reference(ur5e, "double", count=1)
    inputs = [state.inputs[name][0] for name in ("q", "dq", "ddq")]
    expected = arm("torque", [values[None] for values in inputs], (6,))[0]
    for target in range(3):
        np.testing.assert_array_equal(arm.in_place(inputs, target), expected)


@pytest.mark.parametrize("seed", [0, 3])
def test_random_arms_compile_without_a_warning(random_tree, seed, tmp_path):
    model = random_tree(seed, dof=4)
    source = write_c(dynamics_of(model), tmp_path / "arm").path
    done = self_test(source, f"tree_{seed}")
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", ["7*/ int main(void){} /*", "??/", "机器\u202e人", "int", 'a"\\\nb'])
def test_hostile_names(three_joint, name, tmp_path):
    model = build_model(three_joint)
    joints = tuple(replace(joint, name=f"{name}{index}") for index, joint in enumerate(model.joints))
    model = replace(model, name=name, joints=joints)
    source = write_c(dynamics_of(model), tmp_path / "arm").path
    assert self_test(source, identifier(name)).returncode == 0


def test_header_in_cpp(ur5e, tmp_path):
    write_c(ur5e, tmp_path / "arm")
    program = tmp_path / "main.cpp"
    program.write_text('#include "arm.h"\nint main() { ur5e_real q[UR5E_JOINTS] = {}; return q[0] > 0; }\n')
    compile_c(program, tmp_path / "main", compiler="c++")


def test_same_model_same_text(ur5e, tmp_path):
    write_c(ur5e, tmp_path / "arm")
    first = [(tmp_path / name).read_text() for name in ("arm.h", "arm.c")]
    write_c(ur5e, tmp_path / "arm", overwrite=True)
    assert [(tmp_path / name).read_text() for name in ("arm.h", "arm.c")] == first


def test_a_source_does_not_compile_with_the_header_of_another_export(three_joint, tmp_path):
    dynamics = dynamics_of(build_model(three_joint))
    write_c(dynamics, tmp_path / "arm")
    header = (tmp_path / "arm.h").read_text()
    assert "Torques of gravity, 0 0 -9.81 m/s^2 in the base frame." in header
    other = InverseDynamics(dynamics.model, dynamics.base, 2.0 * dynamics.parameters)
    source = write_c(other, tmp_path / "arm", overwrite=True).path
    (tmp_path / "arm.h").write_text(header)
    with pytest.raises(AssertionError, match=r"arm\.h and arm\.c were not written together: export them again"):
        compile_c(source, tmp_path / "arm.o", "-c")


def test_existing_files_stay(ur5e, tmp_path):
    (tmp_path / "arm.c").write_text("mine")
    with pytest.raises(UsageError, match="exists"):
        write_c(ur5e, tmp_path / "arm")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.c"]
    assert (tmp_path / "arm.c").read_text() == "mine"


def test_folder_that_is_not_there(ur5e):
    with pytest.raises(UsageError, match="no such folder"):
        write_c(ur5e, Path("no/such/folder/arm"))


def test_loops_solved_numerically_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ModelError, match="solved numerically"):
        write_c(dynamics_of(build_model(four_bar_arm())), tmp_path / "arm")
    assert not list(tmp_path.iterdir())


def test_parameters_beyond_single_precision_are_refused(tmp_path):
    model = build_model(load_robot("up6"))
    base = base_parameters(model)
    values = np.ones(base.count)
    values[base.names.index("Fv1")] = 1e39
    large = InverseDynamics(model, base, values)
    with pytest.raises(ModelError, match="does not fit into a C float"):
        write_c(large, tmp_path / "arm", real="float")
    assert not list(tmp_path.iterdir())


def test_further_friction_is_in_the_code(tmp_path):
    file = arm_file("\nfriction: {exponent: 0.6, stribeck: true, load: quadratic, joints: {j3: {load: linear}}}\n")
    model = true_model(file)
    base = base_parameters(model)
    dynamics = InverseDynamics(model, base, base.projection @ truth_vector(file, model))
    source = write_c(dynamics, tmp_path / "arm").path
    assert self_test(source, "three_joint").returncode == 0
    q, dq, _ = random_states(model, 5, seed=4)
    friction = CompiledArm(source, "three_joint")("friction", [q.T, dq.T], (3,))
    assert np.allclose(friction, dynamics.friction(dq, q).T, rtol=0, atol=1e-9)


def test_presliding_along_a_motion_is_what_the_model_adds(tmp_path: Path) -> None:
    """Kept from sample to sample, the states of C are those of the model, coupled motors included."""
    travels = {"Fs1": 1e-3, "Fs5": 3e-3, "Fs6": 2e-3}
    model = replace(true_dynamics("sr400").model, presliding=tuple(travels.items()))
    base = base_parameters(model)
    dynamics = InverseDynamics(model, base, base.projection @ truth_vector(load_robot("sr400")))
    path = write_c(dynamics, tmp_path / "arm").path
    assert self_test(path, "sr400").returncode == 0
    arm, rate, time = CompiledArm(path, "sr400"), 500.0, np.arange(200) / 500.0
    dq = 0.2 * np.sin(12.0 * time[:, None] + 0.3 + np.arange(6))
    q = np.cumsum(dq, axis=0) / rate
    states = np.array([[np.sign(velocity[0]) for velocity in dahl_motions(model, dq)]])
    added = []
    for position, velocity in zip(q, dq, strict=True):
        states = arm("presliding_state", [states, velocity[None], np.array([[1.0 / rate]])], states.shape[1:])
        added.append(arm("presliding_torque", [position[None], velocity[None], states], (6,))[0])
    dry = dry_friction(model, base, dynamics.parameters)
    expected = (dynamics.coupling.T @ dry.torque_change(travels, q.T, dq.T, rate)).T
    assert np.abs(expected).max() > 1.0
    assert np.allclose(added, expected, rtol=0, atol=1e-9)


def dahl_motions(model: DynamicModel, dq: np.ndarray) -> list[np.ndarray]:
    """Velocities (N,) of the motions that have a travel."""
    return [combined(motion, dq.T) for motion in presliding_motions(model)]
