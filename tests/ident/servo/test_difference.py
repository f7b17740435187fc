"""Two servo models side by side."""

from __future__ import annotations

import json

import numpy as np
import pytest
from servo_result import true_servo_result

import dynid
from daq.robot.loader import load_robot
from ident.servo.identify import verdict
from ident.servo.result import ServoParameter, with_values
from ident.servo.terms import INDEX


@pytest.fixture(scope="module")
def model() -> dynid.ServoModel:
    return dynid.ServoModel(true_servo_result(load_robot("so101")))


def test_draws_of_a_model_agree_with_it_and_another_friction_does_not(model):
    same = dynid.diff(model, model)
    assert same.agree
    assert np.nanmax(np.abs(same.parameters["z"])) == 0.0
    drawn = [dynid.diff(model, model.drawn(seed)) for seed in range(10)]
    assert all(difference.agree for difference in drawn)
    assert np.mean([np.nanmean(np.abs(difference.parameters["z"]) < 1.96) for difference in drawn]) > 0.9
    values = model.result.values.copy()
    values[2, INDEX["coulomb"]] *= 2.0
    other = dynid.diff(model, dynid.ServoModel(with_values(model.result, values)))
    assert not other.agree
    assert other.parameters.row("elbow_flex coulomb")["z"] > 4
    assert "differ significantly" in str(other)


def test_the_command_takes_servo_models_of_one_arm_only(model, tmp_path, run_dynid):
    model.save(tmp_path / "a")
    model.drawn(1).save(tmp_path / "b")
    status, output, error = run_dynid("diff", tmp_path / "a", tmp_path / "b", "--json")
    assert status == 0, error
    assert json.loads(output)["agree"]
    dynid.ServoModel(true_servo_result(load_robot("koch"))).save(tmp_path / "koch")
    status, _, error = run_dynid("diff", tmp_path / "a", tmp_path / "koch")
    assert status == 2
    assert "different robots" in error
    status, _, error = run_dynid("compare", tmp_path / "a", tmp_path / "b")
    assert status == 2
    assert "dynid diff" in error


def test_the_verdict_names_servos_that_saturate_and_joints_that_rest(model):
    shown = model.result.fit
    assert not verdict(model.result.joints, model.result.servo, shown, np.ones(6)).checks[:-1]
    pan, *others = model.result.servo
    limit = ServoParameter(value=2.94, unit="N·m", interval=(2.9, 3.0))
    limited = pan.model_copy(update={"parameters": pan.parameters | {"torque_limit": limit}})
    resting = others[-1].model_copy(update={"note": "does not move in these recordings"})
    checks = verdict(model.result.joints, [limited, *others[:-1], resting], shown, np.ones(6)).checks
    assert "saturate: shoulder_pan at 2.94 N·m" in checks[0]
    assert "gripper: never commanded" in checks[1]
