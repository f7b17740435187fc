"""Exports of an identified model, from Python and from the command line."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pinocchio as pin
import pytest

import dynid
from ident.result.schema import Result


@pytest.fixture(scope="module")
def model(result) -> dynid.Model:
    return result.model


@pytest.fixture(scope="module")
def saved(result, tmp_path_factory):
    folder = tmp_path_factory.mktemp("model")
    result.save(folder)
    return folder


def beside(model: dynid.Model, states: int = 1000) -> tuple[list[np.ndarray], dict[str, np.ndarray], np.ndarray]:
    """Random states, standard parameters of the joints (n,) by symbol, and the model's torques."""
    generator = np.random.default_rng(5)
    q, dq, ddq = (generator.uniform(-2, 2, (states, model.dof)) for _ in range(3))
    values = {entry.name: entry.value for entry in model.result.consistent.parameters}
    terms = {s: np.array([values[f"{s}{j + 1}"] for j in range(model.dof)]) for s in ("Ia", "Fv", "Fs", "Fo")}
    return [q, dq, ddq], terms, model.torque(q, dq, ddq)


def test_rnea_of_the_urdf_with_friction_and_motor_inertia_is_the_models_torque(model, tmp_path):
    outcome = model.export_urdf(tmp_path / "arm.urdf")
    assert outcome.readings[0].torque_error < 1e-9
    arm = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data = arm.createData()
    (q, dq, ddq), terms, expected = beside(model)
    torque = np.array([pin.rnea(arm, data, *sample) for sample in zip(q, dq, ddq, strict=True)])
    torque += terms["Ia"] * ddq + terms["Fv"] * dq + terms["Fs"] * np.sign(dq) + terms["Fo"]
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_the_pinocchio_model_has_the_motor_inertia_too(model):
    arm = model.to_pinocchio()
    data = arm.createData()
    (q, dq, ddq), terms, expected = beside(model, 50)
    torque = np.array([pin.rnea(arm, data, *sample) for sample in zip(q, dq, ddq, strict=True)])
    torque += arm.damping * dq + arm.friction * np.sign(dq) + terms["Fo"]
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert tuple(arm.names[1:]) == model.joint_names
    assert arm.effortLimit[0] == 150.0


def test_mj_inverse_of_the_mjcf_is_the_models_torque(model, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model.export_mjcf(tmp_path / "arm.xml")
    arm = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    arm.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    data = mujoco.MjData(arm)
    states, terms, expected = beside(model)
    found = np.empty_like(expected)
    for sample, (q, dq, ddq) in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(arm, data)
        found[sample] = data.qfrc_inverse + arm.dof_frictionloss * np.sign(dq)
    np.testing.assert_allclose(found + terms["Fo"], expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_array_equal(-arm.actuator_biasprm[:, 0], terms["Fo"])


def test_other_parameters_are_refused(result, saved, tmp_path):
    for kind in ("full", "essential"):
        model = dynid.load_model(saved, parameters=kind)
        for write in (model.export_urdf, model.export_mjcf, model.export_ros2_inertial):
            with pytest.raises(dynid.UsageError, match=f"the {kind} parameters are not those of bodies"):
                write(tmp_path / "arm")
        with pytest.raises(dynid.UsageError, match="not those of bodies"):
            model.to_pinocchio()


def test_friction_without_a_value_is_refused_unless_the_robot_file_knows_it(model, tmp_path):
    content = model.result.model_dump(mode="json")
    for entry in content["base_parameters"]:
        if entry["name"] == "Fs2":
            entry["value"] = None
    with pytest.raises(dynid.ModelError, match="did not identify Fs2 of shoulder_lift_joint"):
        dynid.Model(Result.model_validate(content)).export_urdf(tmp_path / "arm.urdf")
    for entry in content["consistent"]["parameters"]:
        entry["known"] = entry["name"] == "Fs2"
    dynid.Model(Result.model_validate(content)).export_ros2_inertial(tmp_path / "arm.yaml")


@pytest.fixture
def export(run_dynid):
    """Calls `dynid export`."""
    return partial(run_dynid, "export")


def test_the_command_writes_all_formats_and_says_what_simulation_is_worth(saved, tmp_path, export):
    pytest.importorskip("mujoco")
    targets = {"--urdf": "arm.urdf", "--mjcf": "arm.xml", "--ros2-inertial": "arm.yaml"}
    options = [word for option, name in targets.items() for word in (option, tmp_path / name)]
    status, out, _ = export(saved, *options, "--json")
    assert status == 0
    content = json.loads(out)
    assert [one["path"] for one in content["files"]] == [str(tmp_path / name) for name in targets.values()]
    urdf, mjcf, _ = content["files"]
    assert [reading["reader"].split()[0] for reading in urdf["readings"]] == ["Pinocchio", "MuJoCo"]
    assert [one["motion"] for one in mjcf["readings"][0]["simulations"]] == ["unpowered", "tracking"]
    assert content["simulation"]["grade"] in ("good", "usable", "poor")
    status, out, _ = export(saved, *options, "--force")
    assert status == 0
    assert "not in it: motor inertia" in out
    assert "for simulation: " in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "no file to write is named"),
        (["--into", "{folder}/other.urdf"], "no file to write is named"),
        (["--mjcf", "{folder}/a.xml", "--into", "{folder}/other.urdf"], "--into needs --urdf"),
        (["--mjcf", "{folder}/a", "--urdf", "{folder}/a"], "two outputs name the same file"),
        (["--urdf", "{folder}/mine.urdf"], "mine.urdf: exists"),
        (["--urdf", "{folder}"], "is a folder"),
        (["--urdf", "{folder}/no/arm.urdf"], "there is no such folder"),
        (["--urdf", "{folder}/a.urdf", "--into", "{folder}/none.urdf"], "none.urdf: no such file"),
        (["--urdf", "{folder}/a.urdf", "--into", "{folder}/mine.urdf"], "mine.urdf: is not a URDF"),
        (["--urdf", "{folder}/a.urdf", "--into", "{folder}/other.urdf"], "which is not a movable joint of the URDF"),
    ],
)
def test_bad_input_is_refused_in_a_line_and_nothing_is_written(saved, tmp_path, export, arguments, message):
    (tmp_path / "mine.urdf").write_text("mine")
    (tmp_path / "other.urdf").write_text(
        '<robot name="other"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/></joint></robot>'
    )
    status, _, err = export(saved, *(word.format(folder=tmp_path) for word in arguments))
    assert status == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.urdf", "other.urdf"]
    assert (tmp_path / "mine.urdf").read_text() == "mine"
