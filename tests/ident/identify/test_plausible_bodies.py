"""Bodies of the default model on random arms and public recordings: plausible, and fit to be simulated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from random_arms import built_arm, recorded

from daq.importers.choices import ImportChoices
from daq.importers.import_file import import_file
from daq.recording.recording import JOINTS_STREAM, Recording
from daq.robot.loader import RobotFile, load_robot, parse_robot
from drivers.core.errors import RobotFileError
from ident.assessment.arm_mass import arm_length, mass_of_size
from ident.estimators.feasible.armature import armature_vector
from ident.estimators.feasible.problem import COASTING, friction_rates
from ident.identify.checks.stated_values import stated_value_checks
from ident.identify.identification import Identification, IdentifyChoices, ModelChoices
from ident.identify.identify import identify
from ident.model.base_parameters import random_states
from ident.model.dynamics.inverse_dynamics import InverseDynamics
from ident.model.true_parameters import truth_vector
from ident.result.models.model import Model
from ident.signals.pipeline import PreprocessChoices
from ident.tasks.new_robot import new_robot_file
from sim_drivers.synthetic.measurement import simulate
from studies.synthetic.data_mistakes import with_values

pytestmark = pytest.mark.usefixtures("mistakes_not_sought", "stated_friction")

OF_BODIES = {
    "implausible-mass",
    "implausible-link",
    "implausible-centre",
    "known-contradicts-data",
    "simulation-failed",
}
CONTRADICTED = "known-contradicts-data"
QUICK = IdentifyChoices(search_delay=False, presliding=False, model=ModelChoices(friction="coulomb-viscous"))
TX40 = Path(__file__).parents[3] / "examples" / "tx40.yaml"
FILES = {"panda": "panda_gaz1.npz", "tx40": "tx40_t1.npz", "ur10": "ur10_unisa1.npz"}
ARMS = ((0, True), (1, False))
"""Seeds, and whether sensors are at the links and the wrist is light; `studies/checks/plausible_bodies.py` has more."""


@cache
def arm(seed: int, light: bool) -> RobotFile:
    return built_arm(seed, link_side=light, wrist=0.1 if light else 1.0)


@cache
def recording(seed: int, light: bool) -> Recording:
    return recorded(arm(seed, light), seed, duration=8.0)


@cache
def found(seed: int, light: bool) -> Identification:
    return identify([recording(seed, light)], [], QUICK)


def masses(identification: Identification) -> np.ndarray:
    assert identification.consistent is not None
    count = len(identification.model.joints)
    return identification.consistent.parameters.values[: 10 * count].reshape(count, 10)[:, 9]


def scaled(of: Recording, factor: float) -> Recording:
    return with_values(of, torque=factor * of.streams[JOINTS_STREAM].channels["torque"].values)


@pytest.mark.parametrize(("seed", "light"), ARMS)
def test_true_arms_have_plausible_bodies_that_simulate(seed: int, light: bool) -> None:
    """No check of bodies; a mass of the arm's size; no joint that friction stops at once; a motion that stays near."""
    identification = found(seed, light)
    consistent = identification.consistent
    assert consistent is not None
    assert not OF_BODIES & {check.name for check in identification.checks}
    size = mass_of_size(identification.model)
    true = truth_vector(arm(seed, light))[9 : 10 * identification.model.dof : 10]
    assert size is not None
    assert size.least < masses(identification).sum() < size.most
    assert masses(identification).sum() < 3.0 * true.sum()
    parameters = consistent.parameters
    assert parameters.apparent_mass is not None
    assert 0.2 < parameters.apparent_mass / true.sum() < 3.0  # whatever the wrist weighs
    inverse = InverseDynamics(identification.model, identification.base, parameters.base)
    inertia = np.diagonal(inverse.inertia(random_states(identification.model, 50)[0]), axis1=1, axis2=2)
    rates = friction_rates(identification.model, range(len(parameters.values)), parameters.values)
    assert np.all(inertia.min(axis=0) > 0.5 * COASTING * rates)
    assert np.all((armature_vector(identification.model, parameters.armatures) > 0) == light)
    result = identification.result
    run = result.delivered.runs[0]
    assert run.simulation is not None
    assert max(run.simulation.position_rmse) < 0.05
    assert run.open_loop is not None
    assert run.open_loop.ratio is not None
    assert run.open_loop.ratio < 1.0


@pytest.mark.parametrize(("seed", "light"), ARMS)
def test_an_explicit_integrator_with_steps_of_1_ms_is_stable(seed: int, light: bool) -> None:
    """Semi-implicit Euler, friction explicit: released at rest, no joint gains more speed than gravity gives it."""
    identification = found(seed, light)
    model = Model(identification.result)
    q, dq = np.zeros(identification.model.dof), np.zeros(identification.model.dof)
    energy = []
    for _ in range(300):
        inertia = model.mass_matrix(q) + np.diag(model.armature)
        dq = dq - 1e-3 * np.linalg.solve(inertia, model.torque(q, dq, np.zeros_like(q)))
        q = q + 1e-3 * dq
        energy.append(0.5 * dq @ inertia @ dq)
    assert np.all(np.isfinite(energy))
    assert max(energy) < 2.0 * 9.81 * masses(identification).sum() * arm_length(identification.model)


def test_the_motor_behind_a_sensor_moves_in_simulation_and_in_no_torque() -> None:
    identification = found(0, True)
    content = yaml.safe_load(arm(0, True).text)
    for drive in content["drives"]:
        drive["armature"] = 0.7
    given = parse_robot(yaml.safe_dump(content), where="given", folder=None)
    stated = identify([recording(0, True)], [], QUICK, given)
    assumed, fixed = (Model(model.result) for model in (identification, stated))
    assert np.all(fixed.armature == 0.7)
    assert {one.source for one in fixed.result.consistent.armature} == {"robot file"}  # type: ignore[union-attr]
    assert {one.source for one in assumed.result.consistent.armature} == {"assumed"}  # type: ignore[union-attr]
    names = {check.name for check in stated.checks}
    assert "armature-assumed" not in names
    dof = identification.model.dof
    motion = np.full(dof, 0.3), np.full(dof, 0.4), np.full(dof, 2.0)
    np.testing.assert_allclose(fixed.torque(*motion), assumed.torque(*motion), rtol=1e-6)
    drive = fixed.torque(*motion) + fixed.armature * motion[2]
    moved = fixed.simulate(motion[0], motion[1], drive, 1e-3, step=1e-4)
    np.testing.assert_allclose((moved.velocity[-1] - motion[1]) / 1e-3, motion[2], rtol=0.05)


@pytest.mark.parametrize("factor", [30.0, 0.01])
def test_torques_of_another_unit_are_no_arm_of_this_size(factor: float) -> None:
    identification = identify([scaled(recording(1, False), factor)], [], QUICK)
    assert "implausible-mass" in {check.name for check in identification.checks}


def test_bodies_that_the_urdf_states_may_be_heavy_for_their_length(tmp_path: Path) -> None:
    """A gripper's fingers of 0.1 kg, 4 cm long, with their centres beyond; of 20 kg they are no fingers."""
    bodies = "".join(
        f'<link name="l{number}"><inertial><origin xyz="0 0 {centre}"/><mass value="{mass}"/>'
        '<inertia ixx="8e-5" ixy="0" ixz="0" iyy="7e-5" iyz="0" izz="2e-5"/></inertial></link>'
        f'<joint name="j{number}" type="revolute"><parent link="{parent}"/><child link="l{number}"/>'
        f'<origin xyz="0 0 {length}"/><axis xyz="{axis}"/><limit lower="-1" upper="1" effort="2" velocity="2"/></joint>'
        for number, parent, mass, centre, length, axis in (
            (1, "base", 0.1, 0.055, 0.01, "1 0 0"),
            (2, "l1", 0.11, 0.05, 0.03, "0 1 0"),
        )
    )
    (tmp_path / "fingers.urdf").write_text(f'<robot name="fingers"><link name="base"/>{bodies}</robot>')
    file = new_robot_file(tmp_path / "fingers.urdf", out=tmp_path / "fingers.yaml").path
    run = simulate(file, duration=10.0, seed=1, rate=100.0)
    assert not OF_BODIES & {check.name for check in identify([run], [], QUICK).checks}
    assert "implausible-mass" in {check.name for check in identify([scaled(run, 200.0)], [], QUICK).checks}


def stating(links: dict[str, object] | None = None, **known: object) -> RobotFile:
    """The arm whose file has known values, and bodies of links."""
    content = yaml.safe_load(arm(1, False).text) | {"known": known, "prior": {"links": links or {}}}
    return parse_robot(yaml.safe_dump(content), where="stating", folder=None)


def test_what_the_file_says_against_the_data_is_named() -> None:
    """A viscous friction of a thousandth of the true one; a first moment may have either sign."""
    names = [parameter.name for parameter in found(1, False).model.parameters]
    truth = dict(zip(names, truth_vector(arm(1, False)).tolist(), strict=True))
    given = stating(Fv3=truth["Fv3"] / 1000.0, MX2=truth["MX2"])
    said = [one.text for one in identify([recording(1, False)], [], QUICK, given).checks if one.name == CONTRADICTED]
    assert len(said) == 1
    assert "known.Fv3" in said[0]
    assert "known.MX2" not in said[0]


def test_what_no_data_fit_is_refused_with_what_they_say() -> None:
    """A total mass of a tenth of that which the torques show."""
    given = stating(total_mass=0.1 * float(masses(found(1, False)).sum()))
    with pytest.raises(RobotFileError, match=r"no data agree with known.total_mass = .* \(the data say about .* kg\)"):
        identify([recording(1, False)], [], QUICK, given)


def test_what_the_file_states_is_plausible_or_named() -> None:
    """True values of every kind raise nothing; what is off by a factor of 1,000 is named, whatever the data show."""
    one, truth = found(1, False), truth_vector(arm(1, False))
    true = dict(zip([parameter.name for parameter in one.model.parameters], truth.tolist(), strict=True))
    true["total_mass"] = float(truth[9 : 10 * one.model.dof : 10].sum())

    def said(links: dict[str, object] | None = None, **known: object) -> str:
        checks = stated_value_checks(one.model, stating(links, **known), one.base, one.estimate, ())
        return " ".join(check.text for check in checks)

    keys = ("total_mass", "M1", "M4", "MY1", "YY1", "Ia2", "Fv3", "Fs1", "Fo2")
    centre = [true[f"M{axis}1"] / true["M1"] for axis in "XYZ"]
    assert not said({"j1": {"mass": true["M1"], "com": centre}}, **{key: true[key] for key in keys})
    assert not said(**{key: {"max": 1e3 * abs(true[key]), "min": -1e3 * abs(true[key])} for key in keys})
    large = said({"j1": {"mass": 1e3 * true["M1"], "com": [0, 1e3, 0]}}, **{key: 1e3 * true[key] for key in keys})
    least = said(**{key: {"min": 1e3 * abs(true[key])} for key in keys})
    small = said(**{key: {"min": 0.0, "max": 1e-3 * true[key]} for key in ("total_mass", "M1", "M4")})
    assert all(
        f"known.{key} =" in large and f"known.{key} is at least {1e3 * abs(true[key]):.4g}" in least for key in keys
    )
    assert all(f"prior.links.j1.{key} =" in large for key in ("mass", "com"))
    assert all(f"known.{key} is at most {1e-3 * true[key]:.4g}" in small for key in ("total_mass", "M1", "M4"))
    heavy = identify([recording(1, False)], [], QUICK, stating(M1=1e3 * true["M1"]))
    result = heavy.result
    assert "the robot file states: known.M1 =" in result.verdict.headline
    assert result.verdict.purposes["simulation"].grade != "good"


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "heaviest"), [("panda", 18.0), ("ur10", 28.9)])
def test_public_recordings_have_plausible_bodies(data_dir: Path, name: str, heaviest: float) -> None:
    """None raises a check of bodies, and none weighs more than the arm's data sheet says with its base."""
    if name == "tx40":
        robot_file = parse_robot(TX40.read_text(encoding="utf-8"), where=name, folder=data_dir)
        choices = replace(QUICK, preprocess=PreprocessChoices(stop=7.45))
    else:
        sensor = ", inertia: false" if name == "panda" else ""
        joints = load_robot(data_dir / f"{name}.urdf").robot.joint_names
        limits = "\n".join(f"  - {{name: {joint}, position: [-6.3, 6.3], velocity: 6}}" for joint in joints)
        drives = "\n".join(f"  - {{joint: {joint}, signal: torque{sensor}}}" for joint in joints)
        text = f"name: {name}\nmodel: {{urdf: {name}.urdf, mounting: free}}\njoints:\n{limits}\ndrives:\n{drives}\n"
        robot_file, choices = parse_robot(text, where=name, folder=data_dir), QUICK
    recorded_run = import_file(data_dir / FILES[name], robot_file, ImportChoices())
    identification = identify([recorded_run], [], choices)
    assert not OF_BODIES & {check.name for check in identification.checks}
    assert masses(identification).sum() < heaviest
    consistent = identification.consistent
    assert consistent is not None
    assert consistent.validation.relative_error < 1.1 * identification.validation.relative_error
