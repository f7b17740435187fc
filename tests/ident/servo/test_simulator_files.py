"""Files for simulators: they compile against the published fields, are read again, and move as the model does."""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from servo_result import true_servo_result

import dynid
from daq.recording.recording import Recording
from daq.robot.loader import RobotFile, load_robot
from daq.robot.schema import TruthServo
from ident.servo import arm_rollout
from ident.servo.identify import read_motions
from ident.servo.links import servo_links
from ident.servo.rollout.goals import profile_goals
from ident.servo.simulators.actuator_law import FAITHFUL, actuator_law
from ident.servo.simulators.isaaclab import PHYSICS_STEP, isaaclab_configuration, read_isaaclab
from ident.servo.simulators.mjcf import played_paths, servo_mjcf
from ident.servo.simulators.usd import read_usd, usd_installed
from ident.servo.terms import INDEX
from sim_drivers.synthetic.servo import record_servo, servo_commands
from studies.synthetic.altered_arms import with_servos

PERIOD = 0.02


@pytest.fixture(autouse=True)
def few_passes(monkeypatch):
    """Roll-outs of files and of the model are compared with each other: how far their paths settle does not matter."""
    monkeypatch.setattr(arm_rollout, "PASSES", 2)


@pytest.fixture(scope="module")
def file() -> RobotFile:
    return load_robot("so101")


@pytest.fixture(scope="module")
def run(file) -> Recording:
    time = np.arange(0.0, 3.1, PERIOD)
    return record_servo(file, time, servo_commands(file, time, 3), 0)


@pytest.fixture(scope="module")
def model(file) -> dynid.ServoModel:
    return dynid.ServoModel(true_servo_result(file))


@dataclass
class ActuatorBaseCfg:
    """Fields of Isaac Lab 2.3, `isaaclab/actuators/actuator_base_cfg.py`."""

    joint_names_expr: list[str]
    stiffness: dict[str, float] | float | None
    damping: dict[str, float] | float | None
    effort_limit: dict[str, float] | float | None = None
    velocity_limit: dict[str, float] | float | None = None
    effort_limit_sim: dict[str, float] | float | None = None
    velocity_limit_sim: dict[str, float] | float | None = None
    armature: dict[str, float] | float | None = None
    friction: dict[str, float] | float | None = None
    dynamic_friction: dict[str, float] | float | None = None
    viscous_friction: dict[str, float] | float | None = None


class ImplicitActuatorCfg(ActuatorBaseCfg):
    pass


class IdealPDActuatorCfg(ActuatorBaseCfg):
    pass


@dataclass
class DelayedPDActuatorCfg(IdealPDActuatorCfg):
    min_delay: int = 0
    max_delay: int = 0


@dataclass
class SceneEntityCfg:
    name: str
    joint_names: list[str]


@dataclass
class EventTermCfg:
    func: Any
    mode: str
    params: dict[str, Any] = field(default_factory=dict)


def randomize_actuator_gains(
    env,
    env_ids,
    asset_cfg,
    stiffness_distribution_params=None,
    damping_distribution_params=None,
    operation="abs",
    distribution="uniform",
):
    """Arguments of Isaac Lab 2.3, `isaaclab/envs/mdp/events.py`; so are those of the next."""


def randomize_joint_parameters(
    env,
    env_ids,
    asset_cfg,
    friction_distribution_params=None,
    armature_distribution_params=None,
    lower_limit_distribution_params=None,
    upper_limit_distribution_params=None,
    operation="abs",
    distribution="uniform",
):
    pass


def configuration(text: str, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """What the file defines, with the classes above in place of Isaac Lab's."""
    modules = {
        "isaaclab": {},
        "isaaclab.actuators": {
            one.__name__: one for one in (ImplicitActuatorCfg, IdealPDActuatorCfg, DelayedPDActuatorCfg)
        },
        "isaaclab.envs": {
            "mdp": SimpleNamespace(
                randomize_actuator_gains=randomize_actuator_gains, randomize_joint_parameters=randomize_joint_parameters
            )
        },
        "isaaclab.managers": {"EventTermCfg": EventTermCfg, "SceneEntityCfg": SceneEntityCfg},
    }
    for name, names in modules.items():
        module = ModuleType(name)
        vars(module).update(names)
        monkeypatch.setitem(sys.modules, name, module)
    defined: dict[str, Any] = {}
    exec(compile(text, "arm_cfg.py", "exec"), defined)
    return SimpleNamespace(**defined)


def test_an_isaac_lab_configuration_compiles_and_holds_the_law_in_its_own_fields(model, file, tmp_path, monkeypatch):
    path = tmp_path / "arm_cfg.py"
    model.export_isaaclab(path)
    defined = configuration(path.read_text(encoding="utf-8"), monkeypatch)
    names = list(file.robot.joint_names)
    grouped = [name for group in defined.ACTUATORS.values() for name in group.joint_names_expr]
    assert sorted(grouped) == sorted(names) == sorted(defined.IMPLICIT_ACTUATORS["servos"].joint_names_expr)
    truth = file.robot.truth.joints
    for group in defined.ACTUATORS.values():
        assert group.min_delay == group.max_delay == round(0.01 / PHYSICS_STEP)
        for name in group.joint_names_expr:
            assert group.stiffness[name] == truth[name].servo.stiffness
            assert group.effort_limit[name] == truth[name].servo.torque_limit
            assert group.armature[name] == truth[name].motor_inertia
            assert group.viscous_friction[name] + group.damping[name] == truth[name].viscous
            assert group.friction[name] >= group.dynamic_friction[name] >= truth[name].coulomb
    for term in defined.EVENTS.values():
        inspect.signature(term.func).bind(None, None, **term.params)
        assert term.params["asset_cfg"].joint_names[0] in names
        for key, ends in term.params.items():
            if key.endswith("_distribution_params"):
                assert 0 < ends[0] < 1 < ends[1]


def test_names_of_an_arm_are_no_code_and_match_themselves_alone(model, monkeypatch):
    result, links = model.result, servo_links(model._robot)
    names = ["true.*", 'a"b', *result.joints[2:]]
    renamed = [joint.model_copy(update={"joint": name}) for joint, name in zip(result.servo, names, strict=True)]
    hostile = {"robot": '"""\nraise SystemExit\n"""\\', "joints": names, "servo": renamed}
    text = isaaclab_configuration(result.model_copy(update=hostile), result.values, links, np.ones(6), 0.0)
    defined = configuration(text, monkeypatch)
    assert names == defined.JOINTS
    expressions = defined.IMPLICIT_ACTUATORS["servos"].joint_names_expr
    matched = [[name for name in names if re.fullmatch(expression, name)] for expression in expressions]
    assert matched == [[name] for name in names]
    stiffness = actuator_law(result.values, links, PHYSICS_STEP).stiffness
    np.testing.assert_allclose(read_isaaclab(text, "cfg").stiffness, stiffness, rtol=1e-6)


def test_the_file_shapes_commands_as_the_roll_out_does_and_draws_arms(model, run, tmp_path, monkeypatch):
    path = tmp_path / "arm_cfg.py"
    model.export_isaaclab(path)
    defined = configuration(path.read_text(encoding="utf-8"), monkeypatch)
    motion = read_motions(run, model._robot)[0]
    limit = np.array([defined.ACCELERATION_LIMIT[name] for name in defined.JOINTS])
    goals = profile_goals(motion.command[:400], motion.step, limit)[1:]
    profile = defined.CommandProfile(motion.command[0])
    shaped = [profile(row, 0.0, limit) for row in motion.command[1:400]]
    np.testing.assert_allclose(shaped, goals, atol=1e-12)
    arms = defined.drawn(4000, seed=1)["elbow_flex"]
    logarithms = np.log([arms["stiffness"], arms["armature"]])
    assert np.std(logarithms, axis=1) == pytest.approx([0.05, 0.05], rel=0.12)
    assert np.corrcoef(logarithms)[0, 1] == pytest.approx(0.5, abs=0.1)


def test_a_usd_stage_has_drives_in_degrees_and_bodies_where_the_arm_has_them(model, file, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdPhysics

    path = tmp_path / "arm.usda"
    model.export_usd(path)
    stage = Usd.Stage.Open(str(path))
    joint = stage.GetPrimAtPath("/so101/elbow_flex")
    drive = UsdPhysics.DriveAPI(joint, "angular")
    assert drive.GetStiffnessAttr().Get() == pytest.approx(12.0 * np.pi / 180, rel=1e-5)
    low, high = file.robot.joints[2].position
    revolute = UsdPhysics.RevoluteJoint(joint)
    assert np.radians([revolute.GetLowerLimitAttr().Get(), revolute.GetUpperLimitAttr().Get()]) == pytest.approx(
        [low, high]
    )
    # Both frames of a joint meet at the pose in which the encoders show 0.
    cache = UsdGeom.XformCache()
    for prim in stage.Traverse():
        if not prim.IsA(UsdPhysics.RevoluteJoint):
            continue
        sides = UsdPhysics.Joint(prim)
        ends = []
        for side in (0, 1):
            body = (sides.GetBody0Rel(), sides.GetBody1Rel())[side].GetTargets()[0]
            at = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(body))
            place = (sides.GetLocalPos0Attr(), sides.GetLocalPos1Attr())[side].Get()
            turn = (sides.GetLocalRot0Attr(), sides.GetLocalRot1Attr())[side].Get()
            rotation = (
                np.array(at.ExtractRotationMatrix()).T
                @ np.array([list(turn.Transform(axis)) for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]).T
            )
            ends.append((np.array(at.Transform(place)), rotation))
        np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-6)
        np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-6)
    masses = [
        UsdPhysics.MassAPI(prim).GetMassAttr().Get()
        for prim in stage.Traverse()
        if prim.HasAPI(UsdPhysics.MassAPI) and prim.GetName() != "base"
    ]
    assert sum(masses) == pytest.approx(sum(link.mass for link in file.robot.truth.links.values()), rel=1e-5)


def test_files_are_read_again_as_the_law_that_was_written(model, tmp_path):
    links, values = servo_links(model._robot), model.result.values
    model.export_isaaclab(tmp_path / "cfg.py")
    read = [read_isaaclab((tmp_path / "cfg.py").read_text(encoding="utf-8"), "cfg")]
    written = [actuator_law(values, links, PHYSICS_STEP)]
    if usd_installed():
        model.export_usd(tmp_path / "arm.usd")
        read.append(read_usd((tmp_path / "arm.usd").read_text(encoding="utf-8"), model.result.joints, "arm"))
        written.append(dataclasses.replace(actuator_law(values, links, 0.0), delay=np.zeros(6)))
    for one, other in zip(read, written, strict=True):
        for name, column in vars(one).items():
            np.testing.assert_allclose(column, getattr(other, name), rtol=1e-6, err_msg=name)
    with pytest.raises(dynid.ModelError, match="not a configuration"):
        read_isaaclab("JOINTS = [", "cfg")


def test_a_servo_that_a_drive_can_hold_is_replayed_within_the_gate(file, tmp_path):
    plain = TruthServo(stiffness=12.0, delay=0.01, torque_limit=2.94)
    simple = with_servos(file, **plain.model_dump())
    time = np.arange(0.0, 3.1, PERIOD)
    run = record_servo(simple, time, servo_commands(simple, time, 3), 0)
    model = dynid.ServoModel(true_servo_result(simple))
    replayed = model.export_isaaclab(tmp_path / "cfg.py", run)
    assert replayed.faithful, str(replayed)
    assert replayed.error < 5e-3
    # MuJoCo's friction gives way a little: the roll-out is nearer to the arm, and the file says so
    replayed = model.export_mjcf(tmp_path / "arm.xml", run)
    if replayed is not None:
        assert replayed.error < file.robot.truth.noise.encoder_resolution
        assert replayed.faithful or "is due to the time stepping" in str(replayed)


def test_a_joint_sticks_in_mujoco_while_its_drive_does_not_overcome_friction(model, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    model.export_mjcf(tmp_path / "arm.xml")
    arm = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(arm)
    pan = arm.joint("shoulder_pan").dofadr[0]  # gravity does not load it
    goal = arm.dof_frictionloss[pan] / arm.actuator_gainprm[0, 0]
    reached = []
    for share in (0.8, 1.5):
        data.ctrl[0] = share * goal
        mujoco.mj_step(arm, data, 1000)
        reached.append(abs(data.qpos[0]) / goal)
    assert reached[0] < 0.01 < 0.5 <= reached[1]


def test_a_delay_begins_with_the_commands_before_it(model, run):
    pytest.importorskip("mujoco")
    motion, links = read_motions(run, model._robot)[0].between(0, 20), servo_links(model._robot)
    assert model.result.values[0, INDEX["delay"]] > 0
    resting = dataclasses.replace(motion, command=np.full_like(motion.command, 0.5), position=motion.position * 0 + 0.5)
    path = played_paths(servo_mjcf(model._robot, links, model.result.values), links, [resting])[0]
    np.testing.assert_allclose(path[:, 0], 0.5, atol=1e-3)  # gravity does not load it


def test_ranges_of_a_type_are_wider_than_those_of_one_arm_and_unseen_parameters_stay(model):
    one, several = model.ranges(), model.ranges(unit_spread=0.2)
    for own, other in zip(one["joints"], several["joints"], strict=True):
        for name, parameter in own["parameters"].items():
            if parameter["logarithm"]:
                assert other["parameters"][name]["low"] < parameter["low"] < parameter["high"]
    stiffness = [model.drawn(seed, unit_spread=0.2).result.values[:, INDEX["stiffness"]] for seed in range(60)]
    assert np.std(np.log(stiffness)) == pytest.approx(np.hypot(0.2, 0.05), rel=0.15)
    with pytest.raises(dynid.UsageError, match="unit to unit"):
        model.ranges(unit_spread=-1.0)


def test_the_command_writes_all_formats_with_their_replay(model, run, tmp_path, run_dynid):
    model.save(tmp_path / "model")
    dynid.write_recording(tmp_path / "run.h5", run)
    target = ["--isaaclab", tmp_path / "cfg.py", "--ranges", tmp_path / "ranges.json", "--unit-spread", "0.1"]
    arguments = ["export", tmp_path / "model", *target, "--replay", tmp_path / "run.h5"]
    status, output, error = run_dynid(*arguments, "--json")
    assert status == 0, error
    files = json.loads(output)["files"]
    replay = files[0]["replay"]
    assert replay["error"] < 0.7 * replay["identified_error"]
    assert replay["faithful"] == (replay["error"] <= FAITHFUL * replay["model_error"])
    assert list(replay["left_out"]) == ["friction that follows the load"]
    assert 0 < replay["left_out"]["friction that follows the load"] < replay["identified_error"]
    assert json.loads(Path(files[1]["path"]).read_text(encoding="utf-8"))["unit_spread"] == 0.1
    target = ["--usd", tmp_path / "arm.xyz"]
    status, _, error = run_dynid("export", tmp_path / "model", *target)
    assert status == 2
    assert ".usda" in error


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda servo: servo[0].update(joint="x'; import os #"), "one entry a joint, in their order"),
        (lambda servo: servo.reverse(), "one entry a joint, in their order"),
        (lambda servo: servo[0]["parameters"]["stiffness"].update(value=-1.0), "stiffness -1 of .* is not within"),
        (lambda servo: servo[0]["parameters"]["stiffness"].update(interval=[2.0, 1.0]), "its interval is empty"),
    ],
)
def test_a_result_that_no_identification_writes_is_refused(model, tmp_path, change, words):
    content = json.loads(model.to_json())
    change(content["servo"])
    (tmp_path / "result.json").write_text(json.dumps(content))
    with pytest.raises(dynid.ResultFileError, match=words):
        dynid.load_servo_model(tmp_path)


def test_a_joint_without_stiffness_has_no_range_to_scale_it_by(model, tmp_path):
    content = json.loads(model.to_json())
    content["servo"][0]["parameters"]["stiffness"]["value"] = 0.0
    (tmp_path / "result.json").write_text(json.dumps(content))
    written = tmp_path / "c.py"
    dynid.load_servo_model(tmp_path).export_isaaclab(written)
    assert "nan" not in written.read_text()


def test_commands_that_nobody_recorded_are_rolled_out(model, run, tmp_path, run_dynid):
    channels = run.streams["joints"].channels
    time, command = run.streams["joints"].time, channels["target_position"].values
    simulated = model.simulate(time, command, start=run.position[0])
    np.testing.assert_allclose(simulated.position, model.predict(run).position, atol=1e-9)
    with pytest.raises(dynid.DataError, match="expected"):
        model.simulate(time, command[:, :2])
    model.save(tmp_path / "model")
    times = np.arange(0.0, 4.01, 0.5)
    rows = [[0.1 * np.sin(np.pi * moment / 4) ** 4, 0.0, 0.5, 0.0, 0.0, 0.0] for moment in times]
    motion = tmp_path / "motion.yaml"
    motion.write_text(json.dumps({"robot": "so101", "kind": "samples", "time": times.tolist(), "position": rows}))
    out = tmp_path / "rolled.h5"
    status, _, error = run_dynid("predict", tmp_path / "model", motion, "-o", out)
    assert status == 0, error
    rolled = dynid.read_recording(out)
    assert 0.05 < np.ptp(rolled.position[:, 0]) < 0.1
